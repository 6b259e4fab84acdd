"""Settings for refining proposals from several axes; used at inference only."""

import math
from dataclasses import dataclass

_MOST_AXES = 16


@dataclass(frozen=True, kw_only=True)
class HeadingHypothesesConfig:
    """Classes, axes and passes for refinement from several axes by the compact second stage."""

    class_names: tuple[str, ...] = ("Pedestrian",)
    """Names among the detector's classes."""
    number: int = 2
    """Number of axes of each proposal, evenly spread over half a turn, its own axis first."""
    passes: int = 1
    """Number of second-stage passes after which only each proposal's best-scored box goes on."""
    least_gain: float = 0.015
    """Share by which the score from another axis must exceed that from the proposal's own axis."""

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
