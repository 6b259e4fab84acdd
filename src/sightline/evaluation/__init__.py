"""Evaluation by the official rules of each benchmark."""
