"""Readers and writers of files in KITTI's formats, and data sets."""
