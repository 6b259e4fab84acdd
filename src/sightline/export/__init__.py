"""Task-independent export of PyTorch modules to files and engines that run without PyTorch."""
