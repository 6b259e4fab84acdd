"""Settings of the network."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FinderConfig:
    """Settings of two stages: features of cells, and the likelihood of an object in each."""

    channels: int = 4
    """Number of feature channels."""
    cell_px: int = 4
    """Height and width of a cell."""
