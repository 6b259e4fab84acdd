"""Judgement of every frame's calibration as it is read."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float64

from sightline.files.problem import Problem
from sightline.geometry.user_warning import warn_user

Size = tuple[int, int] | None
"""Height, width [px] of an image; None: unknown."""


class CalibrationJudge:
    """Judge that warns of implausible calibrations; equal ones are judged once.

    The checks of `sightline.open_dataset` see three frames only. This one sees each frame that is
    read, at the cost of a look-up for calibrations that it knows.
    """

    def __init__(self) -> None:
        """Start without a known calibration."""
        self._known: set[int] = set()

    def skip(self, matrix: Float64[np.ndarray, "rows columns"], size: Size) -> None:
        """Take a calibration as known, since an earlier check has judged it."""
        self._known.add(hash((size, matrix.tobytes())))

    def judge(
        self,
        matrix: Float64[np.ndarray, "rows columns"],
        size: Size,
        find: Callable[[], Sequence[Problem]],
    ) -> None:
        """Warn of the problems of a calibration, unless it is known.

        Args:
            matrix: All numbers of the calibration that are judged.
            size: Height, width [px] of the image.
            find: Function that finds the problems.
        """
        if hash((size, matrix.tobytes())) in self._known:
            return
        self.skip(matrix, size)
        for problem in find():
            warn_user(f"{problem}; see all by: sightline check")
