"""Initialisation of SSD's own layers."""

from torch import nn


def start_small(conv: nn.Conv2d) -> nn.Conv2d:
    """Initialise weights by Glorot and Bengio 2010 (Xavier), and biases by 0."""
    nn.init.xavier_uniform_(conv.weight)
    if conv.bias is not None:
        nn.init.zeros_(conv.bias)
    return conv
