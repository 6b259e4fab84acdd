"""Jobs over many frames: output folders, workers, progress."""
