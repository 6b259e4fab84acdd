"""From PyTorch modules to files and engines that run without PyTorch; knows no task."""
