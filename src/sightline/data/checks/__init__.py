"""Checks of data sets, labels and results: faults that would stop a job or spoil its results."""
