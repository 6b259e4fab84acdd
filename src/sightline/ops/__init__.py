"""Tensor algorithms: pure functions, each with a slow reference in tests/reference."""
