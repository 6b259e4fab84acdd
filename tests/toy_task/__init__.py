"""Minimal complete task: finds image cells that contain objects.

Nothing outside this folder refers to it, except for a line of the registry, added by its test.
"""
