"""Drives recorded elsewhere, made into recordings: ROS bags, MCAP, nuScenes."""
