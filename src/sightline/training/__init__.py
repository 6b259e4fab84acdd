"""Trains any task and knows none: batches of data, the loop, checkpoints, weights, the commands."""
