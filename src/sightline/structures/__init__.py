"""Data structures of the project: frozen dataclasses that check themselves."""
