"""Pictures of frames, predictions and metrics."""
