"""Doubts about result files without labels: boxes, places and scores of another convention."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from sightline.data.box_readings import FEWEST_RESULTS
from sightline.data.kitti_labels import KittiObjects
from sightline.data.label_checks import in_degrees, order_of_sizes
from sightline.data.result_angles import remarks_on_alphas
from sightline.data.result_image_boxes import remarks_on_image_boxes, remarks_on_rotations
from sightline.data.scored_boxes import ScoredBoxes, joined, scored_boxes

_FOCAL_PX: Final = 721.5  # of KITTI's camera; its drives differ by up to 2 %
_HORIZON_PX: Final = 172.9  # row of the principal point
_IMAGE_HEIGHT_PX: Final = 370  # boxes that end lower are cut
_CENTRE_SHARES: Final = (0.42, 0.75)
"""Median of (end of the 2D box - bottom of the 3D box) over the 2D box's height. Of 3,000 draws of
KITTI's labels in 10 frames or more, bottoms are at 0.28 at most, and centres taken for them at 0.51
to 0.70."""
_FEWEST_FOR_HEIGHT: Final = 50
_LOWEST_CENTRE_M: Final = 1.2
"""Median of y. Of 3,000 draws of KITTI's labels in 30 frames, bottoms are at 1.48 m or more below
the camera, and centres at 1.09 m or less."""
_PERCENT: Final = 100.0
_LEAST_CORRELATION: Final = 0.1
"""Rank correlation of scores and heights of 2D boxes that shows sound scores, even if all are
negative. The shipped detectors have 0.03 to 0.5 on 90 real frames."""
_REVERSED_CORRELATION: Final = 0.3
"""Rank correlation of reversed scores, negated; sound ones have 0.12 at most, with 72 cyclists."""
_FEWEST_FOR_RANK: Final = 50


def doubts_about_results(frames: Sequence[KittiObjects]) -> Iterator[str]:
    """Yield sentences on results for KITTI's benchmark that are probably of another convention.

    Args:
        frames: Results of all frames, of KITTI's camera; at least one.
    """
    scored = [scored_boxes(each) for each in frames]
    boxes = joined(scored)
    yield from remarks_on_repeats(sum(each.num_repeated() for each in scored), len(boxes.names))
    yield from _remarks_on_sizes(boxes)
    turned = sum(int(in_degrees(each).sum()) for each in frames)
    if turned:
        yield (
            f"{turned:,} results have angles beyond two pi, probably degrees: KITTI's files have "
            "radians, from -pi to pi."
        )
    in_image = (*remarks_on_boxes2d(boxes),) or (*remarks_on_image_boxes(boxes),)
    yield from in_image
    behind = (*remarks_on_depths(boxes),)
    places = behind or (() if in_image else (*_remarks_on_bottoms(boxes),))
    yield from places
    if not turned:
        doubts = () if in_image or places else (*remarks_on_rotations(boxes),)
        yield from doubts or (() if behind else remarks_on_alphas(boxes))
    yield from remarks_on_scores(scored)
    yield from remarks_on_rank(boxes)


def remarks_on_repeats(repeated: int, total: int) -> Iterator[str]:
    """Yield a sentence on results that are twice in their frame."""
    if repeated:
        yield (
            f"{repeated:,} of {total:,} results of scored classes are there twice in their frame: "
            "each but one counts as a false one."
        )


def remarks_on_boxes2d(boxes: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence on 2D boxes in shares of the image."""
    if len(boxes.boxes2d) and boxes.boxes2d.max() <= 1:
        yield (
            "all 2D boxes of results lie within the first pixel and are probably shares of the "
            "image: KITTI's are in pixels."
        )


def remarks_on_depths(boxes: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence on 3D boxes that mostly lie behind the camera."""
    depths = boxes.locations[np.isfinite(boxes.locations).all(axis=1), 2]
    behind = int((depths < 0).sum())
    if len(depths) >= FEWEST_RESULTS and behind > len(depths) / 2:
        yield (
            f"{behind:,} of {len(depths):,} 3D boxes of results lie behind the camera: x, y, z of "
            "KITTI's files are in the camera's frame (right, down, forward), not in the LiDAR's."
        )


def remarks_on_scores(frames: Sequence[ScoredBoxes]) -> Iterator[str]:
    """Yield sentences on scores that are all equal, or probably percent."""
    scores = np.concatenate([each.scores for each in frames])
    if len(scores) < FEWEST_RESULTS:
        return
    least, largest = float(scores.min()), float(scores.max())
    if least == largest:
        yield (
            f"all {len(scores):,} scores of results are {least:g}: nothing ranks them, and the "
            "average precision is of a single threshold; write each detection's own score."
        )
    elif least >= 0 and 1 < largest <= _PERCENT:
        narrow = sum(0 < float(each.scores.max(initial=0)) <= 1 for each in frames)
        yield (
            f"scores of results reach {largest:g} and are probably percent: KITTI's evaluation "
            "ranks by any scale that all frames share, Sightline's own scores are 0 to 1"
            + (f"; in {narrow:,} of {len(frames):,} frames none is above 1." if narrow else ".")
        )


def remarks_on_rank(boxes: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence on scores that are probably negated, by the heights of the 2D boxes.

    Large objects are the easier ones, so scores rise with the height.
    """
    heights = boxes.boxes2d[:, 3] - boxes.boxes2d[:, 1]
    scores = boxes.scores
    if len(scores) < FEWEST_RESULTS or np.ptp(scores) == 0 or np.ptp(heights) == 0:
        return
    ranks = [
        np.unique(each, return_inverse=True)[1].astype(np.float64) for each in (scores, heights)
    ]
    correlation = float(np.corrcoef(ranks[0], ranks[1])[0, 1])
    ending = "the highest score ranks first in KITTI's evaluation: give the surest the highest one."
    if float(scores.max()) < 0 and correlation < _LEAST_CORRELATION:
        yield (
            f"all {len(scores):,} scores of results are negative, and negated unless they are "
            f"logarithms of probabilities; {ending}"
        )
    elif correlation < -_REVERSED_CORRELATION and len(scores) >= _FEWEST_FOR_RANK:
        yield (
            f"scores of results fall with the height of their 2D boxes (rank correlation "
            f"{correlation:.2f}) and are probably reversed; {ending}"
        )


def _remarks_on_sizes(boxes: ScoredBoxes) -> Iterator[str]:
    has_sizes = np.isfinite(boxes.sizes_hwl).all(axis=1)
    if np.count_nonzero(has_sizes) < FEWEST_RESULTS:
        return
    order = order_of_sizes(boxes.sizes_hwl[has_sizes], boxes.names[has_sizes])
    if order is not None:
        yield (
            f"sizes of results are probably in the order {order}: KITTI's files have height, "
            "width, length."
        )


def _remarks_on_bottoms(boxes: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence if the locations are those of centres, by the 2D boxes or the road."""
    boxes2d, locations = boxes.boxes2d, boxes.locations
    ahead = np.isfinite(locations).all(axis=1) & (locations[:, 2] > 1)
    y, z = locations[ahead, 1], locations[ahead, 2]
    ends, heights = boxes2d[ahead, 3], boxes2d[ahead, 3] - boxes2d[ahead, 1]
    whole = (ends < _IMAGE_HEIGHT_PX) & (heights > 1)
    shares = (ends - _HORIZON_PX - _FOCAL_PX * y / z)[whole] / heights[whole]
    least, most = _CENTRE_SHARES
    by_boxes = len(shares) >= 2 * FEWEST_RESULTS and least < np.median(shares) < most
    by_road = len(y) >= _FEWEST_FOR_HEIGHT and 0 < np.median(y) < _LOWEST_CENTRE_M
    if by_boxes or by_road:
        yield (
            f"3D boxes of results stand {np.median(y):.2f} m below the camera (median), where "
            "KITTI's road is 1.65 m below it: their y is probably that of the centre, KITTI's is "
            "that of the bottom."
            if by_road
            else "3D boxes of results end half an object above their 2D boxes: their y is probably "
            "that of the centre, KITTI's is that of the bottom."
        )
