"""Simulated streets with camera images, LiDAR sweeps and labels in KITTI's format."""
