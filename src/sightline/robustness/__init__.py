"""Robustness bench: corrupts sensors for any task and measures the loss; independent of tasks."""
