"""Data sets of samples in KITTI's layouts and as recordings."""
