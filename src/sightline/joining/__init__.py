"""Detections of image and sweep joined to one list of objects; boxes lifted without LiDAR."""
