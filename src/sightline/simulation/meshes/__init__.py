"""Procedural geometry of the simulated streets, generated without any asset files."""
