"""All tasks together: run on a data set, written as one line per frame, drawn in pictures."""
