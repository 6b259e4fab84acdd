"""Corruptions of cameras and LiDARs for training and testing: kinds, suites, data sets on disk."""
