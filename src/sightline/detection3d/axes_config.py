"""Settings of how proposals are asked about from several axes, in use alone."""

import math
from dataclasses import dataclass

_MOST_AXES = 16


@dataclass(frozen=True, kw_only=True)
class AxesConfig:
    """Of which classes the compact second stage refines proposals from several axes, and how."""

    class_names: tuple[str, ...] = ("Pedestrian",)
    """Of the detector's classes."""
    number: int = 2
    """Axes of each proposal, evenly spread over half a turn from its own one on."""
    passes: int = 1
    """After so many of the second stage's passes the surest box of each proposal goes on alone."""
    least_gain: float = 0.015
    """By so much of it the score from another axis must exceed that from the proposal's own."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if not self.class_names or len(set(self.class_names)) < len(self.class_names):
            raise ValueError(
                f"axes.class_names must hold one or more different ones, got {self.class_names}"
            )
        if not 2 <= self.number <= _MOST_AXES:
            raise ValueError(f"axes.number must be from 2 to {_MOST_AXES}, got {self.number}")
        if self.passes < 1:
            raise ValueError(f"axes.passes must be at least 1, got {self.passes}")
        if not 0 <= self.least_gain < math.inf:
            raise ValueError(
                f"axes.least_gain must be finite and not negative, got {self.least_gain}"
            )
