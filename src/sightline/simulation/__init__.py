"""Simulated streets, as a camera and a LiDAR see them, with exact labels."""
