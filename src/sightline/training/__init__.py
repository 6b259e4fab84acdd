"""Trains any task, knows none: data in batches, the loop, checkpoints, weights, the commands."""
