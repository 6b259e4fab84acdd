"""All tasks together: over a data set, in one line a frame, in pictures. Knows tasks by registry."""
