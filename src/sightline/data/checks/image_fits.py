"""Scale and shift of 2D boxes in pixels of another image: a resized, letterboxed or cropped one."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.data.checks.result_boxes import MATCH_IOU, MIN_RESULTS, Boxes, image_ious

OTHER_IMAGE: Final = "pixels of another image, resized or cut"
_MAX_PAIRS: Final = 1000
"""Maximum number of pairs that a scale and shift is compared with, spread evenly."""
_MAX_TRIALS: Final = 200
"""Maximum number of tried pairs, those with the largest boxes."""
_MAX_SCALE: Final = 10.0
_MIN_IOUS: Final = (MATCH_IOU, 0.7, 0.8, 0.8)
"""Overlaps of the pairs for one fit after the other: of those with low ones many are of two objects
and pull scales towards 0."""
_EQUAL_SCALE: Final = 0.01
"""Largest difference of a scale from 1 by the noise of boxes."""
_EQUAL_AXES: Final = 0.05
"""Largest share by which the scale of y differs from that of x by the noise of boxes."""
_MIN_SHIFT_PX: Final = 2.0


@dataclass(frozen=True, slots=True)
class ImageFit:
    """Scale and shift from pixels of the expected image to those in which boxes are written."""

    scales: Float64[np.ndarray, "2"]
    """Factors of x and y."""
    shifts_px: Float64[np.ndarray, "2"]

    def to_expected(self, boxes: Boxes) -> Boxes:
        """Convert boxes as they are written to pixels of the expected image."""
        return np.asarray((boxes - np.tile(self.shifts_px, 2)) / np.tile(self.scales, 2))

    def describe(self) -> str:
        """Describe the change, as "x times 0.515, y times 0.515 plus 223 px"."""
        parts = []
        for axis, scale, shift in zip("xy", self.scales, self.shifts_px, strict=True):
            times = f" times {scale:.3g}" if scale != 1 else ""
            sign = "plus" if shift > 0 else "minus"
            moved = f" {sign} {abs(shift):.0f} px" if abs(shift) >= _MIN_SHIFT_PX else ""
            parts.append(f"{axis}{times}{moved}" if times or moved else "")
        return ", ".join(part for part in parts if part)


def fit_image(expected: Boxes, written: Boxes) -> ImageFit | None:
    """Fit one scale and shift per axis to pairs of boxes, of which most may be of two objects.

    Each pair determines a scale and a shift; those that overlap most other pairs are taken, and
    fitted to the pairs that overlap.

    Args:
        expected: Boxes in pixels of the expected image.
        written: Boxes in pixels of another image, paired with them.

    Returns:
        The fit; None: too few pairs agree on any, or the boxes are of the expected image.
    """
    sizes = np.concatenate([each[:, 2:] - each[:, :2] for each in (expected, written)], axis=1)
    kept = np.flatnonzero((sizes > 1).all(axis=1))
    kept = kept[:: -(-len(kept) // _MAX_PAIRS) or 1]
    expected, written, sizes = expected[kept], written[kept], sizes[kept]
    order = np.argsort(-sizes.min(axis=1), kind="stable")[:_MAX_TRIALS]
    best, most = None, MIN_RESULTS - 1
    for index in order.tolist():
        trial = _fit_boxes(expected[index : index + 1], written[index : index + 1])
        if ((trial.scales < 1 / _MAX_SCALE) | (trial.scales > _MAX_SCALE)).any():
            continue
        number = int((image_ious(trial.to_expected(written), expected) >= MATCH_IOU).sum())
        if number > most:
            best, most = trial, number
    if best is None:
        return None
    for min_iou in _MIN_IOUS:
        is_fitting = image_ious(best.to_expected(written), expected) >= min_iou
        if np.count_nonzero(is_fitting) < MIN_RESULTS:
            break
        best = _fit_boxes(expected[is_fitting], written[is_fitting])
    return best if best.describe() else None


def _fit_boxes(expected: Boxes, written: Boxes) -> ImageFit:
    """Fit scales and shifts to the sides of boxes, at least one of them with an extent."""
    sides = np.stack([expected[:, :2], expected[:, 2:]]).reshape(-1, 2)
    others = np.stack([written[:, :2], written[:, 2:]]).reshape(-1, 2)
    centred = sides - sides.mean(axis=0)
    scales = (centred * others).sum(axis=0) / (centred**2).sum(axis=0)
    if abs(scales[1] - scales[0]) < _EQUAL_AXES * scales[0]:
        scales[1] = scales[0]  # boxes spread over more pixels in x
    scales = np.where(np.abs(scales - 1) < _EQUAL_SCALE, 1.0, scales)
    return ImageFit(scales, np.median(others - scales * sides, axis=0))
