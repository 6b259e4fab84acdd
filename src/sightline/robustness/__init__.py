"""The robustness bench: breaks sensors under any task and tells what it costs; knows no task."""
