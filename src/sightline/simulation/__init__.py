"""Scenes made, not recorded: the embedded data set."""
