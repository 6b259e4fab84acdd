"""Doubts about result files without labels: boxes, angles and scores in another convention."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final, Literal

import numpy as np
from jaxtyping import Bool, Float64

from sightline.data.checks.alpha_checks import remarks_on_alphas
from sightline.data.checks.image_fits import OTHER_IMAGE, ImageFit, fit_image
from sightline.data.checks.label_checks import (
    MIN_LARGEST_M,
    gives_box3d,
    in_degrees,
    is_empty_box2d,
    is_inside_out,
    order_of_sizes,
    scale_of_sizes,
)
from sightline.data.checks.label_fit import MIN_MEDIAN_IOU
from sightline.data.checks.result_boxes import (
    BOX2D_CONVENTIONS,
    MIN_RESULTS,
    ROTATION_CONVENTION,
    ROTATIONS,
    SCORED_CLASSES,
    Boxes,
    ScoredBoxes,
    best_reading,
    image_ious,
    is_clearly_better,
    join_boxes,
    matches_better,
    scored_boxes,
)
from sightline.data.formats.kitti_boxes import box_corners, project_box
from sightline.data.formats.kitti_labels import NO_LOCATION, KittiObjects

_IMAGE_FROM_CAMERA: Final = np.array(
    [[721.5, 0, 609.6, 0], [0, 721.5, 172.9, 0], [0, 0, 1, 0]], dtype=np.float64
)
"""Camera of most of KITTI's drives; those of the others differ by up to 2 % and 13 px."""
_IMAGE_SIZE: Final = (376, 1242)
"""Largest height and width [px] of KITTI's images."""
_MAX_FOCAL_CHANGE: Final = 0.04
_MAX_CENTRE_CHANGE_PX: Final = 15.0
"""Largest change of the focal length and of the centre that may be those of another drive."""
_IMAGE_HEIGHT_PX: Final = 370  # boxes that end lower are cut
_OUTSIDE_SHARE: Final = 0.1
"""Share of the image's size by which boxes may exceed it, as those of labels do."""
_MAX_PROJECTED: Final = 500
"""Maximum number of projected boxes, spread evenly."""
_ROTATION_IOU: Final = 0.03
"""Difference of IoU from which a box shows its rotation."""
_ROTATIONS: Final = {
    "negated": "negated",
    "the LiDAR frame's yaw": "the LiDAR frame's yaw",
    "a quarter turn too large": "a quarter turn off",
}
"""Names in `ROTATIONS`, with their description where half turns look alike."""
_MIN_HALF_SIZE: Final = 20
"""Minimum number of boxes that all lie in the upper left quarter only if the image is of half the
size."""
_MIN_NARROW: Final = 1000
_NARROW_SHARE: Final = 0.7
"""Minimum number of boxes that all end within this share of the width only in a smaller image."""
_CENTRE_SHARES: Final = (0.42, 0.75)
"""Median of (end of the 2D box - bottom of the 3D box) over the 2D box's height. Of 3,000 draws of
KITTI's labels in 10 frames or more, bottoms are at 0.28 at most, and centres taken for them at 0.51
to 0.70."""
_MIN_FOR_HEIGHT: Final = 50
_MIN_FRAMES_FOR_HEIGHT: Final = 30
_MIN_MEDIAN_Y_M: Final = 1.2
"""Minimum median of y; a few frames may be of a rising road. Of 3,000 draws of KITTI's labels in
30 frames, bottoms are at 1.48 m or more below the camera, and centres at 1.09 m or less."""
_MIN_HALF_VIEW: Final = math.radians(20)
"""Least half of a camera's view, for results with few 2D boxes."""
_MAX_AWAY_M: Final = 600.0
"""Distance along an axis at which no camera shows a road user."""
_MAX_SIZE_M: Final = 60.0
"""Size beyond every road user, trams of several cars included."""
_PERCENT: Final = 100.0
_SOUND_CORRELATION: Final = 0.1
"""Rank correlation of scores and heights of 2D boxes that shows sound scores, even if all are
negative. The shipped detectors have 0.03 to 0.5 on 90 real frames."""
_REVERSED_CORRELATION: Final = 0.3
"""Rank correlation of reversed scores, negated; sound ones have 0.12 at most, with 72 cyclists."""
_MIN_FOR_RANK: Final = 50
_MIN_FOR_AGREEMENT: Final = 50


def doubts_about_results(frames: Sequence[KittiObjects]) -> Iterator[str]:
    """Yield sentences on results for KITTI's benchmark that are probably of another convention.

    Args:
        frames: Results of all frames, of KITTI's camera; at least one.
    """
    scored = [scored_boxes(each) for each in frames]
    boxes = join_boxes(scored)
    yield from remarks_on_repeats(sum(each.num_repeated() for each in scored), len(boxes.names))
    yield from remarks_on_impossible([count_impossible(each) for each in frames], len(boxes.names))
    sizes = (*_remarks_on_sizes(boxes),)
    yield from sizes
    num_degrees = sum(int(in_degrees(each).sum()) for each in frames)
    if num_degrees:
        yield (
            f"{num_degrees:,} results have angles beyond two pi, probably degrees: KITTI's files "
            "have radians, from -pi to pi."
        )
    in_image = (*remarks_on_boxes2d(boxes),) or (
        *_remarks_on_projection(boxes, has_sound_sizes=not sizes),
    )
    yield from in_image or remarks_on_far_boxes2d(boxes)
    behind = (*remarks_on_depths(boxes),)
    locations = behind or (() if in_image else (*_remarks_on_bottoms(boxes, len(frames)),))
    yield from locations
    if not num_degrees:
        in_space = in_image or locations or sizes
        angles = () if in_space else (*_remarks_on_rotations(boxes),)
        angles = angles or (() if behind else (*remarks_on_alphas(boxes),))
        yield from angles or (() if in_space else _remarks_on_agreement(boxes))
    yield from remarks_on_scores(scored)
    yield from _remarks_on_rank(boxes)


def count_impossible(objects: KittiObjects) -> Counter[str]:
    """Count the results of scored classes with values that no road user has, by a description."""
    has_3d = gives_box3d(objects) & (objects.locations != NO_LOCATION).all(axis=1)
    sizes = objects.dimensions_hwl
    is_scored = np.isin([name.capitalize() for name in objects.class_names], SCORED_CLASSES)
    masks = {
        f"a 3D box with a size of 0 or less: write the sizes, or {NO_LOCATION:g} for x, y and z "
        "where there is no 3D box": has_3d & (sizes <= 0).any(axis=1),
        f"a 3D box with no size above {MIN_LARGEST_M:g} m": has_3d
        & (sizes > 0).all(axis=1)
        & (sizes < MIN_LARGEST_M).all(axis=1),
        f"a 3D box with a size above {_MAX_SIZE_M:g} m": has_3d & (sizes > _MAX_SIZE_M).any(axis=1),
        f"a 3D box more than {_MAX_AWAY_M:g} m away": has_3d
        & (np.abs(objects.locations) > _MAX_AWAY_M).any(axis=1),
    }
    return Counter({fault: int((mask & is_scored).sum()) for fault, mask in masks.items()})


def remarks_on_impossible(counts: Sequence[Counter[str]], total: int) -> Iterator[str]:
    """Yield a sentence on each kind of impossible values.

    Args:
        counts: Results of `count_impossible`, of each frame.
        total: Number of results.
    """
    for fault, number in sum(counts, Counter[str]()).items():
        verb = "has" if number == 1 else "have"
        yield (
            f"{number:,} of {total:,} results of scored classes {verb} {fault}; such a box matches "
            "no object."
        )


def remarks_on_far_boxes2d(boxes: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence on 2D boxes that end far beyond KITTI's images."""
    height, width = _IMAGE_SIZE
    low, high = (-8 * width, -8 * height), (8 * width, 8 * height)
    is_far = ((boxes.boxes2d[:, :2] < low) | (boxes.boxes2d[:, 2:] > high)).any(axis=1)
    number = int(np.count_nonzero(is_far))
    if number:
        largest = float(np.abs(boxes.boxes2d[is_far]).max())
        verb = "end" if number > 1 else "ends"
        yield (
            f"{number:,} of {len(boxes.boxes2d):,} 2D boxes of results {verb} far beyond "
            f"KITTI's images of at most {width} x {height} px, at up to {largest:g} px."
        )


def remarks_on_repeats(repeated: int, total: int) -> Iterator[str]:
    """Yield a sentence on results that occur twice in their frame."""
    if repeated:
        yield (
            f"{repeated:,} of {total:,} results of scored classes are there twice in their frame: "
            "each but one counts as a false one."
        )


def remarks_on_boxes2d(boxes: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence on placeholders for 2D boxes, or on boxes in shares of the image."""
    boxes = boxes.select(~_is_beside_image(boxes))
    num_empty = int(is_empty_box2d(boxes.boxes2d).sum())
    if num_empty > len(boxes.boxes2d) / 2:
        yield (
            f"{num_empty:,} of {len(boxes.boxes2d):,} 2D boxes of results are placeholders such as "
            "0 0 0 0: KITTI's evaluation ignores results lower than 25 px in the image, also from "
            "above and in 3D; write the projections of the 3D boxes."
        )
    elif len(boxes.boxes2d) and boxes.boxes2d.max() <= 1:
        yield (
            "all 2D boxes of results lie within the first pixel and are probably shares of the "
            "image: KITTI's are in pixels."
        )


def _is_beside_image(boxes: ScoredBoxes) -> Bool[np.ndarray, " num_boxes"]:
    """Mask of the boxes without a 2D box in a direction in which none has one.

    A search all around finds objects beside and behind the camera, too.
    """
    x, _, z = np.nan_to_num(boxes.locations).T
    direction = np.arctan2(x, z)
    is_drawn = boxes.has_3d & ~is_empty_box2d(boxes.boxes2d)
    if not is_drawn.any():
        return np.zeros(len(is_drawn), dtype=np.bool_)
    half_view = max(float(np.abs(direction[is_drawn]).max()), _MIN_HALF_VIEW)
    is_beside = np.abs(direction) > half_view
    return np.asarray(boxes.has_3d & ~is_drawn & is_beside)


def remarks_on_corners(boxes: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence on 2D boxes whose maxima are below their minima."""
    num_inverted = int(is_inside_out(boxes.boxes2d).sum())
    if num_inverted:
        yield (
            f"{num_inverted:,} of {len(boxes.names):,} results of scored classes have 2D boxes "
            "that end before they begin and overlap nothing: KITTI's are x_min, y_min, x_max, "
            "y_max, not x, y, width, height."
        )


def remarks_on_depths(boxes: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence on 3D boxes that mostly lie behind the camera."""
    boxes = boxes.select(~_is_beside_image(boxes))
    depths = boxes.locations[np.isfinite(boxes.locations).all(axis=1), 2]
    behind = int((depths < 0).sum())
    if len(depths) >= MIN_RESULTS and behind > len(depths) / 2:
        yield (
            f"{behind:,} of {len(depths):,} 3D boxes of results lie behind the camera: x, y, z of "
            "KITTI's files are in the camera's frame (right, down, forward), not in the LiDAR's."
        )


def remarks_on_scores(frames: Sequence[ScoredBoxes]) -> Iterator[str]:
    """Yield sentences on scores that are all equal, or probably percent."""
    scores = np.concatenate([each.scores for each in frames])
    if len(scores) < MIN_RESULTS:
        return
    low, high = float(scores.min()), float(scores.max())
    if low == high:
        yield (
            f"all {len(scores):,} scores of results are {low:g}: nothing ranks them, and the "
            "average precision is of a single threshold; write each detection's own score."
        )
    elif low >= 0 and 1 < high <= _PERCENT:
        narrow = sum(0 < float(each.scores.max(initial=0)) <= 1 for each in frames)
        yield (
            f"scores of results reach {high:g} and are probably percent: KITTI's evaluation "
            "ranks by any scale that all frames share, Sightline's own scores are 0 to 1"
            + (f"; in {narrow:,} of {len(frames):,} frames none is above 1." if narrow else ".")
        )


def _remarks_on_sizes(boxes: ScoredBoxes) -> Iterator[str]:
    has_sizes = np.isfinite(boxes.sizes_hwl).all(axis=1)
    if np.count_nonzero(has_sizes) < MIN_RESULTS:
        return
    order = order_of_sizes(boxes.sizes_hwl[has_sizes], boxes.names[has_sizes])
    if order is not None:
        yield (
            f"sizes of results are probably in the order {order}: KITTI's files have height, "
            "width, length."
        )
        return
    scales: dict[str, list[str]] = {}
    for name in SCORED_CLASSES:
        sizes = boxes.sizes_hwl[has_sizes & (boxes.names == name)]
        if len(sizes) >= MIN_RESULTS:
            scale = scale_of_sizes(np.median(sizes, axis=0), name)
            scales.setdefault(scale or "", []).append(name)
    yield from (remark_on_scale(names, scale) for scale, names in scales.items() if scale)


def remark_on_scale(
    names: Sequence[str], scale: str, kind: Literal["results", "labels"] = "results"
) -> str:
    """Sentence on classes whose sizes have another scale; see `scale_of_sizes`."""
    return (
        f"sizes of {', '.join(names)} in the {kind} are probably {scale}: KITTI's are whole "
        "height, width, length in metres."
    )


def _remarks_on_projection(boxes: ScoredBoxes, *, has_sound_sizes: bool) -> Iterator[str]:
    """Yield a sentence on 2D boxes that are not where KITTI's images or the 3D boxes are."""
    ending = "KITTI's are x_min, y_min, x_max, y_max in pixels of the image as it was delivered."
    projected, boxes2d = _projected(boxes)
    ious = image_ious(projected, boxes2d)
    readings = {name: convert(boxes2d) for name, convert in BOX2D_CONVENTIONS.items()}
    fit = fit_image(projected, boxes2d) if has_sound_sizes else None
    if fit is not None and _is_other_image(fit, boxes):
        name = f"{OTHER_IMAGE} ({fit.describe()}), or x, y, z are of another camera"
        readings[name] = fit.to_expected(boxes2d)
    others = {name: image_ious(projected, each) for name, each in readings.items()}
    best = best_reading(ious, others)
    if best is not None:
        better, worse = (
            int(matches_better(*pair).sum())
            for pair in ((others[best], ious), (ious, others[best]))
        )
        yield (
            f"2D boxes of results are probably {best}: read so {better:,} of {len(ious):,} "
            f"agree with their 3D boxes, which {worse:,} do as they are written; {ending}"
        )
        return
    yield from remarks_on_corners(boxes)
    is_inverted = is_inside_out(boxes.boxes2d)
    if is_inverted.sum() <= len(is_inverted) * _OUTSIDE_SHARE:  # else all are of another order
        yield from _remarks_on_bounds(boxes.boxes2d[~is_inverted], ending)


def _is_other_image(fit: ImageFit, boxes: ScoredBoxes) -> bool:
    """Check if a fit is of another image, not of another drive's camera or of moved 3D boxes."""
    height, width = _IMAGE_SIZE
    centre = np.array((width, height)) / 2
    moved_px = np.abs(fit.scales * centre + fit.shifts_px - centre)
    is_scaled = np.abs(fit.scales - 1) > _MAX_FOCAL_CHANGE
    if is_scaled[0]:
        return True
    if not (is_scaled[1] or (moved_px > _MAX_CENTRE_CHANGE_PX).any()):
        return False
    half_height = np.array((0, 0.5, 0)) * boxes.sizes_hwl[:, :1]
    projected, boxes2d = _projected(boxes)
    fitted = _mean_overlap_in_y(projected, fit.to_expected(boxes2d))
    return all(
        fitted > _mean_overlap_in_y(_projected(replace(boxes, locations=locations))[0], boxes2d)
        for locations in (boxes.locations + half_height, boxes.locations - half_height)
    )


def _mean_overlap_in_y(projected: Boxes, boxes2d: Boxes) -> float:
    same_x = np.array((0.0, np.nan, 1.0, np.nan))
    ious = image_ious(*(np.where(np.isnan(same_x), each, same_x) for each in (projected, boxes2d)))
    return float(ious.mean())


def _remarks_on_bounds(boxes2d: Boxes, ending: str) -> Iterator[str]:
    """Yield a sentence on 2D boxes beyond KITTI's images, or all in a part of them."""
    total, outside = len(boxes2d), _num_outside(boxes2d)
    height, width = _IMAGE_SIZE
    quarter = (width / 2 + 1, height / 2 + 1)
    if outside >= MIN_RESULTS and outside > total * _OUTSIDE_SHARE:
        inside = [
            name
            for name, convert in BOX2D_CONVENTIONS.items()
            if not _num_outside(convert(boxes2d))
        ]
        likely = f" (read as {' or '.join(inside)} all are inside)" if inside else ""
        yield (
            f"{outside:,} of {total:,} 2D boxes of results end beyond KITTI's images of at most "
            f"{width} x {height} px{likely}; {ending}"
        )
    elif total >= _MIN_HALF_SIZE and (boxes2d[:, 2:] <= quarter).all():
        yield (
            f"all {total:,} 2D boxes of results lie in the upper left quarter and are probably "
            f"pixels of an image of half the size, or less; {ending}"
        )
    elif total >= _MIN_NARROW and (right := boxes2d[:, 2].max()) < _NARROW_SHARE * width:
        yield (
            f"all {total:,} 2D boxes of results end {right:.0f} px from the left or before, in "
            f"images of about {width} px, and are probably pixels of a smaller image; {ending}"
        )


def _num_outside(boxes2d: Boxes) -> int:
    height, width = _IMAGE_SIZE
    margin = 1 + _OUTSIDE_SHARE
    low, high = -_OUTSIDE_SHARE * width, (width * margin, height * margin)
    return int(((boxes2d < low).any(axis=1) | (boxes2d[:, 2:] > high).any(axis=1)).sum())


def _remarks_on_rotations(boxes: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence on 3D boxes that fit their 2D boxes better when they are turned."""
    projected, boxes2d = _projected(boxes)
    ious = image_ious(projected, boxes2d)
    found = []
    for name in _ROTATIONS:
        convert = ROTATIONS[name]
        turned = replace(boxes, rotations_y=convert(boxes.rotations_y))
        other = image_ious(_projected(turned)[0], boxes2d)
        better = int(((other > ious + _ROTATION_IOU) & (other > 0.5)).sum())
        worse = int(((ious > other + _ROTATION_IOU) & (ious > 0.5)).sum())
        if is_clearly_better(better, worse, better + worse) and better >= 2 * MIN_RESULTS:
            found.append((float(other.mean()), better, worse, name))
    if found:
        _, better, worse, name = max(found)
        yield (
            f"rotation_y of results is probably {_ROTATIONS[name]}: of {better + worse:,} boxes "
            f"that show it, {better:,} fit their 2D boxes better if read so; {ROTATION_CONVENTION}"
        )


def _remarks_on_agreement(boxes: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence on 2D boxes that are not where the projected 3D boxes are."""
    projected, boxes2d = _projected(boxes)
    is_seen = np.isfinite(projected).all(axis=1)
    ious = image_ious(projected[is_seen], boxes2d[is_seen])
    if len(ious) >= _MIN_FOR_AGREEMENT and np.median(ious) < MIN_MEDIAN_IOU:
        yield (
            f"2D boxes of results do not fit their projected 3D boxes: the median IoU of "
            f"{len(ious):,} is {100 * np.median(ious):.0f} %, expected at least "
            f"{100 * MIN_MEDIAN_IOU:.0f} %; look at x_min, y_min, x_max, y_max, at the image's "
            "size, and at location, sizes and rotation_y."
        )


def _projected(boxes: ScoredBoxes) -> tuple[Boxes, Boxes]:
    """Project the 3D boxes ahead of the camera; the second array is of their 2D boxes."""
    locations = np.nan_to_num(boxes.locations)
    is_near = (np.abs(locations) <= _MAX_AWAY_M).all(axis=1)
    ahead = np.flatnonzero(boxes.has_3d & is_near & (locations[:, 2] > 1))
    chosen = ahead[:: max(len(ahead) // _MAX_PROJECTED, 1)]
    bounds = [
        project_box(
            box_corners(
                boxes.locations[index],
                boxes.sizes_hwl[index],
                float(boxes.rotations_y[index]),
            ),
            _IMAGE_FROM_CAMERA,
            _IMAGE_SIZE,
        ).box
        for index in chosen.tolist()
    ]
    projected: Float64[np.ndarray, "num_boxes 4"] = np.array(bounds).reshape(-1, 4)
    return projected, boxes.boxes2d[chosen]


def _remarks_on_bottoms(boxes: ScoredBoxes, num_frames: int) -> Iterator[str]:
    """Yield a sentence if the locations are those of centres, by the 2D boxes or the road."""
    boxes2d, locations = boxes.boxes2d, boxes.locations
    ahead = np.isfinite(locations).all(axis=1) & (locations[:, 2] > 1)
    y, z = locations[ahead, 1], locations[ahead, 2]
    ends, heights = boxes2d[ahead, 3], boxes2d[ahead, 3] - boxes2d[ahead, 1]
    uncut = (ends < _IMAGE_HEIGHT_PX) & (heights > 1)
    focal_px, horizon_px = _IMAGE_FROM_CAMERA[1, 1:3]
    shares = (ends - horizon_px - focal_px * y / z)[uncut] / heights[uncut]
    low, high = _CENTRE_SHARES
    by_boxes = len(shares) >= 2 * MIN_RESULTS and low < np.median(shares) < high
    enough = len(y) >= _MIN_FOR_HEIGHT and num_frames >= _MIN_FRAMES_FOR_HEIGHT
    by_road = enough and 0 < np.median(y) < _MIN_MEDIAN_Y_M
    if by_boxes or by_road:
        yield (
            f"3D boxes of results stand {np.median(y):.2f} m below the camera (median), where "
            "KITTI's road is 1.65 m below it: their y is probably that of the centre, KITTI's is "
            "that of the bottom."
            if by_road
            else "3D boxes of results end half an object above their 2D boxes: their y is probably "
            "that of the centre, KITTI's is that of the bottom."
        )


def _remarks_on_rank(boxes: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence on scores that are probably negated, by the heights of the 2D boxes.

    Large objects are the easier ones, so scores rise with the height.
    """
    heights = boxes.boxes2d[:, 3] - boxes.boxes2d[:, 1]
    scores = boxes.scores
    if len(scores) < MIN_RESULTS or np.ptp(scores) == 0 or np.ptp(heights) == 0:
        return
    ranks = [
        np.unique(each, return_inverse=True)[1].astype(np.float64) for each in (scores, heights)
    ]
    correlation = float(np.corrcoef(ranks[0], ranks[1])[0, 1])
    ending = "KITTI's evaluation ranks the highest score first: give better detections higher ones."
    if float(scores.max()) < 0 and correlation < _SOUND_CORRELATION:
        yield (
            f"all {len(scores):,} scores of results are negative, and negated unless they are "
            f"logarithms of probabilities; {ending}"
        )
    elif correlation < -_REVERSED_CORRELATION and len(scores) >= _MIN_FOR_RANK:
        yield (
            f"scores of results fall with the height of their 2D boxes (rank correlation "
            f"{correlation:.2f}) and are probably reversed; {ending}"
        )
