"""All tasks together: over a data set, as one line a frame, in pictures."""
