"""What goes wrong with cameras and LiDARs, to train and to test on: kinds, suites, whole trees."""
