"""Task-independent inference: loading networks, running them on data sets, pictures, the demo."""
