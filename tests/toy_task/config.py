"""Settings of the network."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FinderConfig:
    """Two stages: features of cells, and how likely an object's middle lies in each."""

    channels: int = 4
    """Of the features."""
    cell_px: int = 4
    """Height and width of a cell."""
