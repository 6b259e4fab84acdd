"""Delay of the sweeps behind the images of a drive, by boxes that both detectors found."""

from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float64

from sightline.joining.alignment_by_boxes import centre_deviations, mutual_pairs
from sightline.joining.scene import Scene

MIN_LATE_M: Final = 0.3
"""Advance from which sweeps count as late. Image boxes partly follow the sweep, so it is about 40 %
of the way driven meanwhile or less; within 0.2 m in 15 sound frames."""

_DEVIATIONS: Final = 3.0  # by which the advance must exceed 0
_HEIGHT_DEVIATION: Final = 0.07  # of the log ratio of heights of sound pairs
_HEIGHT_DEVIATION_PX: Final = 2.0
_SHIFT_PX: Final = 12.0  # usual shift by a rotation, which each frame may have as well
_BORDER_PX: Final = 2.0
_CUT: Final = 100.0  # factor of the deviation at the image's border
_USUAL_DEVIATIONS: Final = 2.0  # residual of a pair up to which it counts fully
_ROUNDS: Final = 12  # of reweighting; more change less than 1 cm


class Advance(NamedTuple):
    """Common distance by which a drive's sweeps show objects too far ahead."""

    metres: float
    deviation: float
    """Standard error [m]."""

    @property
    def is_late(self) -> bool:
        """Test whether the sweeps are late behind the images by more than the noise."""
        return self.metres > max(MIN_LATE_M, _DEVIATIONS * self.deviation)


def measure_advance(scenes: Iterable[Scene]) -> Advance | None:
    """Measure how much nearer the objects are in the images than in the sweeps.

    A nearer object is larger and farther from the image's centre; a shift of all boxes of a frame,
    as by a rotation, does not count. One distance for all frames: weighted least squares, with the
    shifts of each frame eliminated. Wrong pairs count little: the weight of a pair falls with the
    square of its largest residual, and is found anew in rounds.

    Returns:
        The distance; None: no frame has a box that both detectors found.
    """
    frames = [frame for scene in scenes if (frame := _equations(scene)) is not None]
    if not frames:
        return None
    sureness = [frame.sureness for frame in frames]
    for _ in range(_ROUNDS):
        parts = [_normal_equations(*each) for each in zip(frames, sureness, strict=True)]
        reduced = np.array([_without_shifts(*part) for part in parts]).sum(axis=0)
        if reduced[0] <= 0:
            return None
        advance = Advance(float(reduced[1] / reduced[0]), float(reduced[0] ** -0.5))
        sureness = [
            frame.sureness
            / np.maximum(_residuals(frame, *part, advance) / _USUAL_DEVIATIONS, 1) ** 2
            for frame, part in zip(frames, parts, strict=True)
        ]
    return advance


class _Frame(NamedTuple):
    """Equations of a frame's pairs of boxes: right, down, and log ratio of heights of each."""

    terms: Float64[np.ndarray, "3 num_pairs 3"]
    """Factors of the frame's shift right and down [px], and of the advance [m]."""
    measured: Float64[np.ndarray, "3 num_pairs"]
    deviations: Float64[np.ndarray, "3 num_pairs"]
    sureness: Float64[np.ndarray, " num_pairs"]
    """Lower score of both boxes."""


def _equations(scene: Scene) -> _Frame | None:
    """Equations of a frame; None: no pair."""
    rows, columns = mutual_pairs(scene)
    if len(rows) == 0:
        return None
    own, other = scene.sweep.in_image[rows], scene.image.in_image[columns]
    ahead = scene.camera_from_level[2]
    depth = scene.boxes3d[rows, :3] @ ahead[:3] + ahead[3]
    middle, sizes = (own[:, :2] + own[:, 2:]) / 2, own[:, 2:] - own[:, :2]
    by_metre = (middle - scene.image_from_camera[:2, 2]) / depth[:, None]
    limits = np.array(scene.image_size[::-1]) - 1 - _BORDER_PX
    low, high = np.minimum(own, other)[:, :2], np.maximum(own, other)[:, 2:]
    is_cut = np.logical_or(low <= _BORDER_PX, high >= limits)
    one, zero = np.ones(len(rows)), np.zeros(len(rows))
    heights = (other[:, 3] - other[:, 1]) / np.maximum(sizes[:, 1], 1.0)
    shifts = (other[:, :2] + other[:, 2:]) / 2 - middle
    centre = centre_deviations(own)
    of_height = np.hypot(_HEIGHT_DEVIATION, _HEIGHT_DEVIATION_PX / np.maximum(sizes[:, 1], 1.0))
    deviations = np.stack((centre[:, 0], centre[:, 1], of_height))
    cut = np.stack((is_cut[:, 0], is_cut[:, 1], is_cut[:, 1]))
    return _Frame(
        terms=np.stack(
            (
                np.column_stack((one, zero, by_metre[:, 0])),
                np.column_stack((zero, one, by_metre[:, 1])),
                np.column_stack((zero, zero, 1 / depth)),
            )
        ),
        measured=np.stack((shifts[:, 0], shifts[:, 1], np.log(np.maximum(heights, 1e-3)))),
        deviations=deviations * np.where(cut, _CUT, 1.0),
        sureness=np.minimum(scene.sweep.scores[rows], scene.image.scores[columns]),
    )


def _normal_equations(
    frame: _Frame, sureness: Float64[np.ndarray, " num_pairs"]
) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"]]:
    """Normal equations of a frame's shift right and down [px] and advance [m]."""
    terms, weights = frame.terms.reshape(-1, 3), (sureness / frame.deviations**2).ravel()
    prior = np.diag([_SHIFT_PX**-2.0, _SHIFT_PX**-2.0, 0.0])
    return terms.T @ (weights[:, None] * terms) + prior, terms.T @ (
        weights * frame.measured.ravel()
    )


def _without_shifts(
    matrix: Float64[np.ndarray, "3 3"], right: Float64[np.ndarray, "3"]
) -> tuple[float, float]:
    """Eliminate the shifts: the advance's factor and right side."""
    shifts = np.linalg.solve(matrix[:2, :2], np.column_stack((matrix[:2, 2], right[:2])))
    factor, value = matrix[2, 2] - matrix[2, :2] @ shifts[:, 0], matrix[2, :2] @ shifts[:, 1]
    return float(factor), float(right[2] - value)


def _residuals(
    frame: _Frame,
    matrix: Float64[np.ndarray, "3 3"],
    right: Float64[np.ndarray, "3"],
    advance: Advance,
) -> Float64[np.ndarray, " num_pairs"]:
    """Largest residual of each pair, in deviations."""
    shifts = np.linalg.solve(matrix[:2, :2], right[:2] - matrix[:2, 2] * advance.metres)
    predicted = frame.terms @ np.append(shifts, advance.metres)
    return np.asarray((np.abs(frame.measured - predicted) / frame.deviations).max(axis=0))
