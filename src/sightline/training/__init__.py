"""Task-independent training: batches of data, the loop, checkpoints, weights, the commands."""
