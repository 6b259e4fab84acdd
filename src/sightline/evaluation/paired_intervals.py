"""Limit of the intervals of paired differences."""

from typing import Final

FEWEST_FRAMES: Final = 10
"""Fewest frames for the interval of a paired difference. Resamples of n frames are draws from n
numbers: of two frames a quarter of them repeats one frame, and Efron's percentiles are the two
differences themselves. From 10 frames on an end is rarely a single frame's difference."""


def note_without_interval(num_frames: int, what: str) -> str:
    """Explain a missing interval.

    Args:
        num_frames: Number of frames, below `FEWEST_FRAMES`.
        what: Name of the frames, plural.
    """
    return (
        f"No interval: {num_frames} of {FEWEST_FRAMES} {what} that resampling needs at least; "
        "compare the methods on more of them."
    )
