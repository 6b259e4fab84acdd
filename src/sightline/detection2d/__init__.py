"""Detection of cars, pedestrians and cyclists in the image, by camera and LiDAR together."""
