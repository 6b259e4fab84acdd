"""Procedural geometry of the simulated streets: everything is made here from numbers."""
