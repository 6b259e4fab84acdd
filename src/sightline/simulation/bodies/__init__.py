"""Meshes of road users."""
