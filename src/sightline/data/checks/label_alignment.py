"""Clouds and labels in different places or conventions, found in many frames together."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from jaxtyping import Float32, Float64, Int64

from sightline.data.checks.label_fit import (
    LIDAR_FRAMES,
    MAX_FILLED_RANGE_M,
    count_empty_boxes,
    heights_in_column,
    visible_objects,
)
from sightline.data.formats.kitti_calibration import CalibrationMatrices
from sightline.data.formats.kitti_labels import KittiObjects
from sightline.data.layouts.kitti_trees import ObjectFrame
from sightline.files.problem import Problem
from sightline.geometry.cloud_checks import hollow_doubt

_MAX_FRAMES: Final = 30  # spread over all; they have about a hundred objects
_MIN_OBJECTS: Final = 10
_MAX_OBJECTS_PER_FRAME: Final = 20
_MIN_POINTS_PER_OBJECT: Final = 20  # after the best change; fewer are moved by chance
_MAX_DISTANCE_M: Final = 40.0
_ROAD_HEIGHT_M: Final = 0.2  # bottom part of a box, which contains the road
_SPACE_ABOVE_M: Final = 1.0  # empty space above a box
_PENALTY: Final = 2.0
"""Weight of points above a box. Without it, correct clouds fill boxes best when raised by 0.3 m,
since some road gets into the boxes; with 2, the best shift of five random frames of KITTI's 90 is
-0.1 to 0.3 m."""
_MARGIN_M: Final = 0.15  # around a box: the sides of exact boxes split the points on them
_MIN_OTHER_SHARE: Final = 0.8  # of the best score, above which another change is named, too
_MIN_MEAN_SCORE: Final = 0.68
"""Smallest mean score of an object after the change for a named fault, 1 at most.

Sound frames have 0.70 or more (dozens of KITTI's 90, 14 simulated ones with 32 beams), and faulty
ones 0.73 or more after the change that undoes the fault; clouds or labels of the next frame have
0.34 to 0.65 after the best one.
"""
_BETTER: Final = 1.2  # ratio of an object's scores in two clouds
_SHIFTED_SHARE: Final = 0.75
"""Smallest share of all objects that must fit a neighbouring frame better for labels to be shifted;
labels of unrelated frames do so in a fifth of the cases."""
_DEGREES: Final = tuple(number / 2 for number in range(-12, 13))
_METRES: Final = tuple(number / 5 for number in range(-10, 11))
_FOOT_M: Final = 0.3048
_NO_FRONT: Final = "boxes do not tell front from rear, look at some by sightline show"
_EXTRINSICS: Final = (
    "correct the transform from LiDAR to camera (Tr_velo_to_cam and R0_rect; in a recording "
    "camera_from_lidar) or the clouds"
)


_SAME_FRAMES: Final = (
    "give labels and clouds of the same frames and moments, in the frames and units of "
    "docs/recordings.md; look at some by sightline show"
)


@dataclass(frozen=True, kw_only=True, slots=True)
class LabelledSweep:
    """Labels of a frame, with its cloud and calibration."""

    objects: KittiObjects
    matrices: CalibrationMatrices
    points: Float32[np.ndarray, "num_points 4"]


@dataclass(frozen=True, kw_only=True, slots=True)
class _Kind:
    """Kind of change to clouds, or to labels, that may move points into the boxes of the labels."""

    fault: str
    """Description of the fault, to be formatted with the amount of the change."""
    change: Callable[[float], Float64[np.ndarray, "4 4"]]
    amounts: tuple[float, ...]
    min_amount: float
    """Smallest amount to report."""
    max_score_ratio: float
    """Largest ratio of the scores without and with the change.

    Sound frames have 0.91 or more where the amount counts: 1,000 draws of five of KITTI's 90, 300
    of six of each of three simulated sets (64, 32 and 16 beams, hilly ones too); mirrored and in
    feet 1.7 or more.
    """
    remedy: str = _EXTRINSICS
    relabel: Callable[[KittiObjects, CalibrationMatrices], KittiObjects] = lambda objects, _: (
        objects
    )
    """Change to the labels."""
    subject: str = "clouds"
    """Changed files."""


def _rotation(axis: int, degrees: float) -> Float64[np.ndarray, "4 4"]:
    turned, (one, other) = np.eye(4), ((1, 2), (2, 0), (0, 1))[axis]
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turned[[one, one, other, other], [one, other, one, other]] = cos, -sin, sin, cos
    return turned


def _translation(axis: int, metres: float) -> Float64[np.ndarray, "4 4"]:
    moved = np.eye(4)
    moved[axis, 3] = metres
    return moved


def _scaling(*factors: float) -> Float64[np.ndarray, "4 4"]:
    return np.diag([*np.broadcast_to(factors, 3), 1.0])


def _lowered(objects: KittiObjects, _: CalibrationMatrices, *, heights: float) -> KittiObjects:
    """Lower objects by a number of their heights."""
    locations = objects.locations.copy()
    locations[:, 1] += heights * objects.dimensions_hwl[:, 0]
    return replace(objects, locations=locations)


def _turned(
    objects: KittiObjects, _: CalibrationMatrices, *, sign: float, offset: float
) -> KittiObjects:
    """Multiply rotation_y by a sign, and add an offset."""
    return replace(objects, rotation_y=sign * objects.rotation_y + offset)


_KINDS: Final = (
    *(
        _Kind(
            fault=f"off by {{:+.1f}} degrees of {name}",
            change=partial(_rotation, axis),
            amounts=_DEGREES,
            min_amount=min_amount,
            max_score_ratio=max_score_ratio,
        )
        for axis, name, min_amount, max_score_ratio in (
            (0, "roll (about the LiDAR's x axis)", 3.0, 0.85),
            (1, "pitch (positive lowers the front)", 1.5, 0.85),
            (2, "yaw (counter-clockwise about the LiDAR's z axis)", 1.0, 0.9),
        )
    ),
    *(
        _Kind(
            fault=f"off by {{:+.1f}} m along the LiDAR's {name}",
            change=partial(_translation, axis),
            amounts=_METRES,
            min_amount=min_amount,
            max_score_ratio=max_score_ratio,
        )
        for axis, name, min_amount, max_score_ratio in (
            (0, "x axis (forward)", 1.0, 0.85),
            (1, "y axis (left)", 0.5, 0.85),
            (2, "z axis (up)", 0.4, 0.85),
        )
    ),
    _Kind(
        fault="those of clouds not in metres (factor {:.4g})",
        change=_scaling,
        amounts=(_FOOT_M, 1 / _FOOT_M),
        min_amount=0.0,
        max_score_ratio=0.7,
        remedy="write clouds in metres; a foot is 0.3048 m",
    ),
    _Kind(
        fault="those of mirrored clouds",
        change=lambda y: _scaling(1.0, y, 1.0),
        amounts=(-1.0,),
        min_amount=0.0,
        max_score_ratio=0.7,
        remedy="write clouds with y to the left: negate y",
    ),
    _Kind(
        fault="turned by {:+.0f} degrees about the LiDAR's z axis",
        change=partial(_rotation, 2),
        amounts=(-90.0, 90.0, 180.0),
        min_amount=0.0,
        max_score_ratio=0.7,
    ),
    *(
        _Kind(
            fault=fault,
            change=lambda _: np.eye(4),
            amounts=(1.0,),
            min_amount=0.0,
            max_score_ratio=max_score_ratio,
            remedy=remedy,
            relabel=relabel,
            subject="labels",
        )
        for fault, max_score_ratio, relabel, remedy in (
            (
                "written with the y of the box's centre",
                0.85,
                partial(_lowered, heights=0.5),
                "write the bottom's y: add half the height",
            ),
            (
                "written half of their height too low",
                0.85,
                partial(_lowered, heights=-0.5),
                "write the bottom's y: half the height was added to it",
            ),
            (
                "written with a negated rotation_y",
                0.96,  # boxes along the road stay as they are; sound frames have 0.99 or more
                partial(_turned, sign=-1.0, offset=0.0),
                f"negate rotation_y: it is positive from z to x, clockwise from above; {_NO_FRONT}",
            ),
            (
                "written with the LiDAR frame's yaw for rotation_y",
                0.85,
                partial(_turned, sign=-1.0, offset=-np.pi / 2),
                f"write rotation_y = -yaw - pi/2; {_NO_FRONT}",
            ),
            (
                "written with a rotation_y that is a quarter turn off",
                0.85,
                partial(_turned, sign=1.0, offset=np.pi / 2),
                f"add or subtract pi/2: rotation_y is 0 to the right (x), -pi/2 ahead (z); "
                f"{_NO_FRONT}",
            ),
            *(
                (
                    f"written in another frame: {name}",
                    0.7,
                    read,
                    "write the centre of each box's bottom in the camera's frame (x right, y down, "
                    "z forward), and rotation_y about y",
                )
                for name, read in LIDAR_FRAMES.items()
            ),
        )
    ),
)
_CHANGES: Final = (
    np.eye(4)[None],
    *(np.array([kind.change(amount) for amount in kind.amounts]) for kind in _KINDS),
)
_NUM_CHANGES: Final = sum(map(len, _CHANGES))


def check_label_alignment(
    frames: Sequence[ObjectFrame], read: Callable[[ObjectFrame], LabelledSweep | None]
) -> list[Problem]:
    """Find clouds that fit the 3D boxes of labels better after one change to all of them.

    The changes are turns by up to 6 degrees about each axis of the LiDAR, quarter and half turns
    about z, moves by up to 2 m along each axis, feet for metres and back, and mirroring (y
    negated); of the labels centres for bottoms, rotation_y negated, a quarter turn off or of the
    LiDAR's frame, and places in that frame. Each is scored by the points in the boxes less twice
    those in the metre above, for objects within 40 m that are at most partly hidden. Fewer than ten
    objects of twenty points or more give too little evidence, unless most boxes of ten near objects
    are empty. Where no change fills most boxes, the fault is reported without a cause, unless
    clouds of the neighbouring frames fill them.

    Args:
        frames: Frames of one rig, in order.
        read: Reader of a frame; None: it lacks a part, or is unreadable.
    """
    complete = [frame for frame in frames if frame.objects and frame.points and frame.calibration]
    places = range(len(complete))[:: max(len(complete) // _MAX_FRAMES, 1)][:_MAX_FRAMES]
    labelled = [complete[place] for place in places]
    read_places = [(place, sweep) for place in places if (sweep := read(complete[place]))]
    sweeps = [sweep for _, sweep in read_places]
    counts = np.concatenate([np.zeros((0, _NUM_CHANGES, 2)), *map(_count_points, sweeps)])
    max_counts = counts[:, :, 0].max(axis=1, initial=0)
    shifted = _find_shift(complete, read_places, read) if _are_mostly_empty(counts) else None
    if shifted is not None:
        return [shifted]
    is_dense = max_counts >= _MIN_POINTS_PER_OBJECT
    if np.count_nonzero(is_dense) < _MIN_OBJECTS:
        return _check_emptiness(labelled, sweeps)
    doubt = _doubt(counts[is_dense], max_counts[is_dense])
    if doubt is None:
        return []
    problem, remedy, is_of_labels = doubt
    path = labelled[0].objects if is_of_labels else labelled[0].calibration
    assert path is not None, "frames without labels or a calibration are left out"
    problem = f"and those of {len(sweeps) - 1} more frames {problem}"
    found = Problem(path=path, problem=problem, remedy=remedy)
    shifted = _find_shift(complete, read_places, read)  # a small one resembles moved clouds
    return [found] if shifted is None else [shifted, found]


def _check_emptiness(
    frames: Sequence[ObjectFrame], sweeps: Sequence[LabelledSweep]
) -> list[Problem]:
    """Find labels of which most near boxes are empty after every change."""
    counts = [
        count_empty_boxes(each.objects, each.matrices, each.points)
        for each in sweeps
        if len(each.points) and hollow_doubt(each.points) is None  # such clouds are told themselves
    ]
    num_empty, num_near = np.array(counts, dtype=int).reshape(-1, 2).sum(axis=0).tolist()
    if num_near < _MIN_OBJECTS or 2 * num_empty < num_near:
        return []
    path = frames[0].objects
    assert path is not None, "frames without labels are left out"
    others = f"and those of {len(sweeps) - 1} more frames do" if len(sweeps) > 1 else "does"
    problem = (
        f"{others} not fit the clouds: of {num_near} objects "
        f"within {MAX_FILLED_RANGE_M:.0f} m, at most partly hidden, {num_empty} have no point in "
        "their 3D box, and no single turn, move or change of convention mends it"
    )
    return [Problem(path=path, problem=problem, remedy=_SAME_FRAMES)]


def _doubt(
    counts: Float64[np.ndarray, "num_objects num_changes 2"],
    max_counts: Float64[np.ndarray, " num_objects"],
) -> tuple[str, str, bool] | None:
    """Problem, in words that continue a sentence about files, and remedy; else None.

    The third value is whether the files are labels; else they are calibrations.
    """
    scores = ((counts @ (1.0, -_PENALTY)) / max_counts[:, None]).sum(axis=0)
    unchanged_score, totals = float(scores[0]), counts.sum(axis=0).astype(int)
    causes: list[tuple[float, int, _Kind, float]] = []
    start = 1
    for kind in _KINDS:
        best = start + int(scores[start : start + len(kind.amounts)].argmax())
        amount = kind.amounts[best - start]
        start += len(kind.amounts)
        if abs(amount) >= kind.min_amount and unchanged_score < kind.max_score_ratio * scores[best]:
            causes.append((float(scores[best]), best, kind, amount))
    causes.sort(key=lambda cause: -cause[0])
    if not causes:
        return None
    if causes[0][0] < _MIN_MEAN_SCORE * len(counts):
        return (
            f"do not fit the labels: their 3D boxes hold {totals[0, 0]} points and {totals[0, 1]} "
            "in the metre above, and no single turn, move or change of convention mends it",
            _SAME_FRAMES,
            False,
        )
    score, best, kind, amount = causes[0]
    others = [
        each.fault.format(other)
        for near, _, each, other in causes[1:]
        if near > _MIN_OTHER_SHARE * score
    ]
    is_limit = abs(amount) == max(kind.amounts) == -min(kind.amounts)
    return (
        f"are probably {kind.fault.format(amount)}: after this change to the {kind.subject}, the "
        f"3D boxes of the labels hold {totals[best, 0]} points and {totals[best, 1]} in the metre "
        f"above; before {totals[0, 0]} and {totals[0, 1]}",
        kind.remedy
        + (f"; other possible faults: {', or '.join(others)}" if others else "")
        + ("; this is the largest amount tried, the fault may be larger" if is_limit else ""),
        kind.subject == "labels",
    )


def _are_mostly_empty(counts: Float64[np.ndarray, "num_objects num_changes 2"]) -> bool:
    """Whether most boxes of labels have few points in them, or as many in the metre above."""
    scores = counts[:, 0] @ (1.0, -_PENALTY)
    return len(counts) >= _MIN_OBJECTS and bool(np.median(scores) < _MIN_POINTS_PER_OBJECT)


def _find_shift(
    frames: Sequence[ObjectFrame],
    sweeps: Sequence[tuple[int, LabelledSweep]],
    read: Callable[[ObjectFrame], LabelledSweep | None],
) -> Problem | None:
    """Find labels that fit the clouds of the previous or the next frame much better than their own.

    Args:
        frames: All frames, in order.
        sweeps: Some of their sweeps, with their places.
        read: Reader of a frame.
    """
    found = []
    for step, name in ((-1, "previous"), (1, "next")):
        pairs = [
            (sweep, neighbour)
            for place, sweep in sweeps
            if 0 <= place + step < len(frames)
            and (neighbour := read(frames[place + step])) is not None
        ]
        own = [_count_points(sweep, unchanged_only=True) for sweep, _ in pairs]
        other = [
            _count_points(replace(sweep, points=neighbour.points), unchanged_only=True)
            for sweep, neighbour in pairs
        ]
        scores, moved_scores = (
            np.concatenate([np.zeros((0, 1, 2)), *each])[:, 0] @ (1.0, -_PENALTY)
            for each in (own, other)
        )
        is_better = moved_scores > np.maximum(_BETTER * scores, _MIN_POINTS_PER_OBJECT)
        found.append((int(is_better.sum()), len(scores), len(pairs), name))
    num_better, num_objects, num_frames, name = max(found)
    if num_objects < _MIN_OBJECTS or num_better < _SHIFTED_SHARE * num_objects:
        return None
    first = frames[sweeps[0][0]].objects
    assert first is not None, "frames without labels are left out"
    return Problem(
        path=first,
        problem=f"and those of {num_frames - 1} more frames fit the clouds of the {name} frame "
        f"better than their own: {num_better} of {num_objects} objects have more points there",
        remedy="give labels, clouds and images of a frame one name: labels or clouds are probably "
        "shifted by one frame",
    )


def _count_points(
    sweep: LabelledSweep, *, unchanged_only: bool = False
) -> Int64[np.ndarray, "num_objects num_changes 2"]:
    """Points in each object's box and in the metre above it, for each change."""
    objects, xyz = sweep.objects, sweep.points[:, :3].astype(np.float64)
    camera_from_lidar = sweep.matrices.camera_from_lidar
    lidar_from_camera = np.linalg.inv(camera_from_lidar)
    relabelled = [objects, *(kind.relabel(objects, sweep.matrices) for kind in _KINDS)]
    all_changes = list(zip(_CHANGES, relabelled, strict=True))[: 1 if unchanged_only else None]
    counts = []
    for index in visible_objects(objects, within_m=_MAX_DISTANCE_M)[:_MAX_OBJECTS_PER_FRAME]:
        height = objects.dimensions_hwl[index, 0]
        reach_m = float(np.linalg.norm(objects.dimensions_hwl[index])) + _SPACE_ABOVE_M
        place = np.full(3, np.nan)
        for changes, boxes in all_changes:
            if (boxes.locations[index] != place).any():  # distances to all points take long
                place = boxes.locations[index]
                centre = lidar_from_camera @ np.append(place, 1.0)
                away_m = np.linalg.norm(xyz - centre[:3], axis=1)
            # Positions that a change moves to the object, and their distances from it.
            sources = np.linalg.solve(changes, centre)[:, :3]
            far_m = np.linalg.norm(sources - centre[:3], axis=1).max()
            scale = min(np.abs(changes[0, 0, 0]), 1.0)
            near = xyz[away_m < far_m + reach_m / scale]
            for change in camera_from_lidar @ changes:
                moved = near @ change[:3, :3].T + change[:3, 3]
                heights = heights_in_column(boxes, index, moved, margin_m=_MARGIN_M)
                is_over = heights > height
                counts.append(
                    (
                        np.count_nonzero((heights >= _ROAD_HEIGHT_M) & ~is_over),
                        np.count_nonzero(is_over & (heights <= height + _SPACE_ABOVE_M)),
                    )
                )
    return np.array(counts, dtype=np.int64).reshape(-1, 1 if unchanged_only else _NUM_CHANGES, 2)
