"""Changes of samples for training: scenes, sweeps, cameras, faults."""
