"""Runs any task, knows none: networks loaded, data sets answered, frames drawn, the demo."""
