"""Delay of the sweeps behind the images of a drive, by boxes that both detectors found."""

from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float64

from sightline.joining.alignment_by_boxes import centre_deviations, mutual_pairs
from sightline.joining.scene import Scene

MIN_LATE_M: Final = 0.4
"""Advance from which sweeps count as late. Image boxes partly follow the sweep, so it is about 40 %
of the way driven meanwhile; within 0.3 m in 15 sound frames."""

_DEVIATIONS: Final = 3.0  # by which the advance must exceed 0
_HEIGHT_DEVIATION: Final = 0.07  # of the log ratio of heights of sound pairs
_HEIGHT_DEVIATION_PX: Final = 2.0
_SHIFT_PX: Final = 12.0  # usual shift by a rotation, which each frame may have as well
_BORDER_PX: Final = 2.0
_CUT: Final = 100.0  # factor of the deviation at the image's border


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
    shifts of each frame eliminated.

    Returns:
        The distance; None: no frame has a box that both detectors found.
    """
    information, weighted = 0.0, 0.0
    for scene in scenes:
        equations = _normal_equations(scene)
        if equations is not None:
            matrix, right = equations
            shifts = np.linalg.solve(matrix[:2, :2], np.column_stack((matrix[:2, 2], right[:2])))
            information += float(matrix[2, 2] - matrix[2, :2] @ shifts[:, 0])
            weighted += float(right[2] - matrix[2, :2] @ shifts[:, 1])
    if information <= 0:
        return None
    return Advance(weighted / information, information**-0.5)


def _normal_equations(
    scene: Scene,
) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"]] | None:
    """Normal equations of a frame's shift right and down [px] and advance [m]; None: no pair."""
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
    terms = np.concatenate(
        (
            np.column_stack((one, zero, by_metre[:, 0])),
            np.column_stack((zero, one, by_metre[:, 1])),
            np.column_stack((zero, zero, 1 / depth)),
        )
    )
    heights = (other[:, 3] - other[:, 1]) / np.maximum(sizes[:, 1], 1.0)
    shifts = (other[:, :2] + other[:, 2:]) / 2 - middle
    measured = np.concatenate((shifts[:, 0], shifts[:, 1], np.log(np.maximum(heights, 1e-3))))
    centre = centre_deviations(own)
    of_height = np.hypot(_HEIGHT_DEVIATION, _HEIGHT_DEVIATION_PX / np.maximum(sizes[:, 1], 1.0))
    deviations = np.concatenate((centre[:, 0], centre[:, 1], of_height))
    cut = np.concatenate((is_cut[:, 0], is_cut[:, 1], is_cut[:, 1]))
    sureness = np.minimum(scene.sweep.scores[rows], scene.image.scores[columns])
    weights = np.tile(sureness, 3) / (deviations * np.where(cut, _CUT, 1.0)) ** 2
    prior = np.diag([_SHIFT_PX**-2.0, _SHIFT_PX**-2.0, 0.0])
    return terms.T @ (weights[:, None] * terms) + prior, terms.T @ (weights * measured)
