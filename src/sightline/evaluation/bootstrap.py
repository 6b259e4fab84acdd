"""Resampled frames for bootstrap intervals (Efron 1979): minimum number, draws and percentiles."""

from collections.abc import Iterator
from typing import Final

import numpy as np
from jaxtyping import Int64

MIN_FRAMES: Final = 10
"""Minimum number of frames for an interval. Resamples of n frames are draws from n numbers: of two
frames a quarter of them repeats one frame, and the percentiles are the scores of the two frames
themselves. From 10 frames on an end is rarely the score of a single frame."""
PERCENTILES: Final = (2.5, 97.5)
"""Ends of the 95 % interval."""


def draw_frames(
    valid_per_frame: Int64[np.ndarray, " num_frames"], num_resamples: int, seed: int
) -> Iterator[Int64[np.ndarray, " num_frames"]]:
    """Yield the weights of the frames in each resample; resamples without any object are left out.

    Frames are drawn with replacement, as many as there are. A seed gives the same draws for every
    class, metric and difficulty, and for every submission of the same frames. Fewer than
    `MIN_FRAMES` frames give no resample.
    """
    generator = np.random.default_rng(seed)
    num_frames = len(valid_per_frame)
    for _ in range(num_resamples if num_frames >= MIN_FRAMES else 0):
        drawn = generator.integers(num_frames, size=num_frames)
        weights = np.bincount(drawn, minlength=num_frames)
        if (weights @ valid_per_frame) > 0:
            yield weights


def note_without_interval(num_frames: int, noun: str) -> str:
    """Explain a missing interval.

    Args:
        num_frames: Number of frames, below `MIN_FRAMES`.
        noun: Name of the frames, plural.
    """
    return (
        f"No interval: resampling needs at least {MIN_FRAMES} {noun}, got {num_frames}; evaluate "
        "more of them."
    )
