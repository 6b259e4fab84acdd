"""Simulated streets, as a camera and a LiDAR see them, with labels as KITTI's."""
