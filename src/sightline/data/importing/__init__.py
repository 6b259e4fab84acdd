"""Import of other recordings of drives: ROS bags, MCAP, nuScenes."""
