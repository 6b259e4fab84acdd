"""Meshes of buildings, plants and objects beside a street."""
