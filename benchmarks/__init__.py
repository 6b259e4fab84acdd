"""Benchmarks, one script a claim. Each prints a table, then its record as one line of JSON."""
