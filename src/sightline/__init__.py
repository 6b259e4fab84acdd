"""Sightline: camera-LiDAR perception that keeps seeing when a sensor fails."""
