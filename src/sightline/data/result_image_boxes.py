"""Doubts about 2D boxes of results for KITTI's benchmark: by its cameras and by their 3D boxes."""

from collections.abc import Iterator
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.data.box_readings import (
    FEWEST_RESULTS,
    READINGS,
    Boxes,
    fits_better,
    image_ious,
    is_clear,
)
from sightline.data.kitti_boxes import box_corners, project_box
from sightline.data.scored_boxes import ScoredBoxes

_IMAGE_FROM_CAMERA: Final = np.array(
    [[721.5, 0, 609.6, 0], [0, 721.5, 172.9, 0], [0, 0, 1, 0]], dtype=np.float64
)
"""Camera of most of KITTI's drives; those of the others differ by up to 2 % and 13 px."""
_IMAGE_SIZE: Final = (376, 1242)
"""Largest height and width [px] of KITTI's images."""
_OUTSIDE_SHARE: Final = 0.1
"""Share of the image's size by which boxes may exceed it, as of labels."""
_MOST: Final = 500
"""Number of boxes to project, spread evenly."""
_TELLING_IOU: Final = 0.03
"""Difference of IoU from which a box tells the sign of its rotation."""
_FEWEST_OF_HALF: Final = 20
"""Fewest boxes that all lie in the upper left quarter only if the image is of half the size."""


def remarks_on_image_boxes(boxes: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence on 2D boxes that are not where KITTI's images or the 3D boxes are."""
    ending = "KITTI's are x_min, y_min, x_max, y_max in pixels of the image as it was delivered."
    projected, given = _projected(boxes)
    ious = image_ious(projected, given)
    for name, convert in READINGS.items():
        other = image_ious(projected, convert(given))
        better, worse = int(fits_better(other, ious).sum()), int(fits_better(ious, other).sum())
        if is_clear(better, worse, len(ious)):
            yield (
                f"2D boxes of results are probably {name}: read so {better:,} of {len(ious):,} "
                f"agree with their 3D boxes, which {worse:,} do as they are written; {ending}"
            )
            return
    yield from _remarks_on_bounds(boxes.boxes2d, ending)


def _remarks_on_bounds(boxes2d: Boxes, ending: str) -> Iterator[str]:
    """Yield a sentence on 2D boxes beyond KITTI's images, or all in a quarter of them."""
    total, outside = len(boxes2d), _num_outside(boxes2d)
    height, width = _IMAGE_SIZE
    quarter = (width / 2 + 1, height / 2 + 1)
    if outside >= FEWEST_RESULTS and outside > total * _OUTSIDE_SHARE:
        inside = [name for name, convert in READINGS.items() if not _num_outside(convert(boxes2d))]
        likely = f" (read as {' or '.join(inside)} all are inside)" if inside else ""
        yield (
            f"{outside:,} of {total:,} 2D boxes of results end beyond KITTI's images of at most "
            f"{width} x {height} px{likely}; {ending}"
        )
    elif total >= _FEWEST_OF_HALF and (boxes2d[:, 2:] <= quarter).all():
        yield (
            f"all {total:,} 2D boxes of results lie in the upper left quarter and are probably "
            f"pixels of an image of half the size; {ending}"
        )


def remarks_on_rotations(boxes: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence on 3D boxes that fit their 2D boxes when they are turned the other way."""
    projected, given = _projected(boxes)
    mirrored, _ = _projected(boxes, rotation_sign=-1)
    ious, other = image_ious(projected, given), image_ious(mirrored, given)
    better = int(((other > ious + _TELLING_IOU) & (other > 0.5)).sum())
    worse = int(((ious > other + _TELLING_IOU) & (ious > 0.5)).sum())
    if is_clear(better, worse, better + worse) and better >= 2 * FEWEST_RESULTS:
        yield (
            f"rotation_y of results is probably negated: of {better + worse:,} boxes that tell, "
            f"{better:,} fit their 2D boxes better when turned the other way; KITTI's is positive "
            "from z to x, clockwise from above."
        )


def _num_outside(boxes2d: Boxes) -> int:
    height, width = _IMAGE_SIZE
    margin = 1 + _OUTSIDE_SHARE
    low, high = -_OUTSIDE_SHARE * width, (width * margin, height * margin)
    return int(((boxes2d < low).any(axis=1) | (boxes2d[:, 2:] > high).any(axis=1)).sum())


def _projected(boxes: ScoredBoxes, *, rotation_sign: int = 1) -> tuple[Boxes, Boxes]:
    """Project the 3D boxes ahead of the camera; the second array is of their 2D boxes."""
    ahead = np.flatnonzero(boxes.has_3d & (np.nan_to_num(boxes.locations[:, 2]) > 1))
    chosen = ahead[:: max(len(ahead) // _MOST, 1)]
    made = [
        project_box(
            box_corners(
                boxes.locations[index],
                boxes.sizes_hwl[index],
                rotation_sign * float(boxes.rotations_y[index]),
            ),
            _IMAGE_FROM_CAMERA,
            _IMAGE_SIZE,
        ).box
        for index in chosen.tolist()
    ]
    projected: Float64[np.ndarray, "num_boxes 4"] = np.array(made).reshape(-1, 4)
    return projected, boxes.boxes2d[chosen]
