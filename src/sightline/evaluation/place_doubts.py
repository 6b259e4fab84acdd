"""Doubts about places and directions of results' 3D boxes, compared with those of labels."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.data.checks.result_boxes import (
    MIN_RESULTS,
    ROTATION_CONVENTION,
    ROTATIONS,
    ScoredBoxes,
    angle_between,
    image_ious,
    is_clearly_better,
    matches_better,
)
from sightline.evaluation.box_pairs import (
    ground_distances_m,
    nearest_results,
    same_class,
    space_ious,
)
from sightline.evaluation.kitti_object_rules import CLASSES

Frames = Sequence[tuple[ScoredBoxes, ScoredBoxes]]
"""Results and labels of frames."""

MIN_MATCHES: Final = 10
"""Minimum number of matched labels for a doubt that `MIN_RESULTS` could raise by chance."""
_HEIGHT_TOLERANCE: Final = 0.15
"""Largest deviation of the rise of box centres from half the height, in heights."""
_MAX_ANGLE_RAD: Final = 0.35
"""Largest difference of the directions of two boxes that face the same way."""
_MAX_OFFSET_M: Final = 2.5
"""Largest distance of a result that may be of a labelled object in another origin; y with the other
sign is off by twice the height of the camera."""
_MIN_OFFSET_M: Final = 0.2
"""Smallest constant offset along an axis of the camera; sound detectors have 0.1 at most."""
_MIN_SPREADS: Final = 1.5
"""Ratio of a constant offset to the spread of the single ones."""
_MIN_ERRORS: Final = 4.0
"""Ratio of half a height to the standard error of the median rise of box centres: boxes of an image
alone, a metre off, rise by half a height by chance."""
_SPREAD_OF_MAD: Final = 1.48
"""Standard deviation of normal errors over their median absolute deviation."""
_DIRECTIONS: Final = (("right", "left"), ("lower", "higher"), ("further", "nearer"))
"""Where a box lies by the sign of x, y, z in the camera's frame."""


def remarks_on_centres(frames: Frames) -> Iterator[str]:
    """Yield a sentence on 3D boxes whose y is that of the centre."""
    names, rises = _rises(frames)
    groups = {"": rises} | {f" of {name}": rises[names == name] for name in CLASSES}
    for of_class, group in groups.items():
        rise = float(np.median(group)) if len(group) >= MIN_RESULTS else 0.0
        if abs(abs(rise) - 0.5) < _HEIGHT_TOLERANCE and _MIN_ERRORS * _error_of(group) < 0.5:
            higher, lower = ("results", "labels") if rise > 0 else ("labels", "results")
            yield (
                f"3D boxes{of_class} of {higher} lie {abs(rise):.2f} of their height above those "
                f"of {lower}: their y is probably that of the centre, KITTI's is that of the "
                f"bottom; or half the height was added twice to {lower}."
            )
            return


def rise_evenly(frames: Frames) -> bool:
    """Check if boxes lie off by one share of their height, not by an angle as of a tilted LiDAR."""
    _, rises = _rises(frames)
    return _spread_of(rises) < _HEIGHT_TOLERANCE


def _spread_of(values: Float64[np.ndarray, " num"]) -> float:
    """Compute the standard deviation of normal values by their deviations from the median."""
    return _SPREAD_OF_MAD * float(np.median(np.abs(values - np.median(values))))


def _error_of(values: Float64[np.ndarray, " num"]) -> float:
    """Compute the standard error of the median of normal values, by their deviations from it."""
    return math.sqrt(math.pi / 2 / len(values)) * _spread_of(values)


def _rises(frames: Frames) -> tuple[np.ndarray, Float64[np.ndarray, " pairs"]]:
    """Compute how far results lie above their labels, in heights, beside their classes."""
    pairs = [
        (
            labels.names[label],
            (labels.locations[label, 1] - results.locations[result, 1])
            / labels.sizes_hwl[label, 0],
        )
        for results, labels in frames
        for label, result in nearest_results(results, labels)
    ]
    return np.array([name for name, _ in pairs]), np.array([rise for _, rise in pairs], float)


def remarks_on_offsets(frames: Frames) -> Iterator[str]:
    """Yield a sentence on 3D boxes that all lie off by one vector, and match if they are moved."""
    offsets_m = np.concatenate([np.empty((0, 3)), *(_offsets_m(*frame) for frame in frames)])
    if len(offsets_m) < MIN_MATCHES:
        return
    offset_m = np.median(offsets_m, axis=0)
    spread_m = _SPREAD_OF_MAD * np.median(np.abs(offsets_m - offset_m), axis=0)
    is_off = np.abs(offset_m) > np.maximum(_MIN_OFFSET_M, _MIN_SPREADS * spread_m)
    if not is_off.any() or (np.abs(offset_m) > _MAX_OFFSET_M).any():
        return
    shift_m = np.where(is_off, offset_m, 0.0)
    written, moved = (
        np.concatenate([_best_ious(results, labels, each) for results, labels in frames])
        for each in (np.zeros(3), shift_m)
    )
    better = int(matches_better(moved, written).sum())
    worse = int(matches_better(written, moved).sum())
    if better >= MIN_MATCHES and is_clearly_better(better, worse, len(offsets_m)):
        described = " and ".join(
            f"{abs(shift):.2f} m {names[int(shift < 0)]}"
            for shift, names in zip(shift_m.tolist(), _DIRECTIONS, strict=True)
            if shift
        )
        yield (
            f"3D boxes of results lie {described} than those of labels (median of "
            f"{len(offsets_m):,}): moved back they match {better:,} labelled objects clearly "
            f"better in 3D, and {worse:,} worse; look at the origin and the calibration of both: "
            "KITTI's x, y, z are in the frame of camera 0."
        )


def _offsets_m(results: ScoredBoxes, labels: ScoredBoxes) -> Float64[np.ndarray, "num_pairs 3"]:
    """Compute the offsets from labels to a result nearby, one that overlaps in the image first."""
    if not len(results.names) or not len(labels.names):
        return np.empty((0, 3))
    distances_m = ground_distances_m(results, labels)
    overlaps = image_ious(labels.boxes2d[:, None], results.boxes2d[None])
    costs = np.where(distances_m < _MAX_OFFSET_M, distances_m - _MAX_OFFSET_M * overlaps, np.inf)
    paired = np.flatnonzero(np.isfinite(costs).any(axis=1))
    nearest = costs[paired].argmin(axis=1)
    return np.asarray(results.locations[nearest] - labels.locations[paired])


def _best_ious(
    results: ScoredBoxes, labels: ScoredBoxes, shift_m: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, " num_labels"]:
    """Compute each label's largest IoU in space with a result of its class that is moved back."""
    moved = replace(results, locations=results.locations - shift_m)
    possible = labels.has_3d[:, None] & moved.has_3d & same_class(moved, labels)
    return np.asarray(space_ious(moved, labels, possible).max(axis=1, initial=0))


def remarks_on_rotations(frames: Frames) -> Iterator[str]:
    """Yield a sentence on 3D boxes at labels that face another way."""
    pairs = [
        (results.rotations_y[result], labels.rotations_y[label])
        for results, labels in frames
        for label, result in nearest_results(results, labels)
    ]
    angles, expected = np.array(pairs).reshape(-1, 2).T
    written = angle_between(angles, expected, period=np.pi)
    found = []
    for name, convert in ROTATIONS.items():
        turned = angle_between(convert(angles), expected, period=np.pi)
        better = int(((turned < _MAX_ANGLE_RAD) & (written > 2 * _MAX_ANGLE_RAD)).sum())
        worse = int(((written < _MAX_ANGLE_RAD) & (turned > 2 * _MAX_ANGLE_RAD)).sum())
        if better >= MIN_MATCHES and is_clearly_better(better, worse, better + worse):
            facing = angle_between(convert(angles), expected) < _MAX_ANGLE_RAD
            along = int((turned < _MAX_ANGLE_RAD).sum())
            found.append((along, int(facing.sum()), name))
    if found:
        along, _, name = max(found, key=lambda each: each[:2])
        yield (
            f"rotation_y of results is probably {name}: of {len(angles):,} results at a "
            f"labelled object {along:,} lie along it if read so, "
            f"{int((written < _MAX_ANGLE_RAD).sum()):,} as they are written; "
            f"{ROTATION_CONVENTION} Or labels are at fault."
        )
        return
    reversed_ = int((angle_between(angles, expected) > np.pi - _MAX_ANGLE_RAD).sum())
    if reversed_ >= MIN_MATCHES and reversed_ > 0.8 * len(angles):
        yield (
            f"{reversed_:,} of {len(angles):,} results at a labelled object face the opposite "
            f"way: rotation_y is half a turn off, or negated; {ROTATION_CONVENTION}"
        )
