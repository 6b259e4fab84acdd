"""Yaw between camera and LiDAR, and mirrored clouds, by the labels of many frames."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float32, Float64, Int64

from sightline.data.calibration_text import CalibrationMatrices
from sightline.data.kitti_labels import KittiObjects
from sightline.data.label_fit import chosen_objects, is_in_box
from sightline.data.object_tree import ObjectFrame
from sightline.files.problem import Problem

_MOST_FRAMES: Final = 30  # spread over all; they have some hundred objects
_FEWEST_OBJECTS: Final = 10
_MOST_OBJECTS: Final = 20  # of a frame
_FEWEST_POINTS: Final = 20  # of an object, at its best; chance moves fewer
_WITHIN_M: Final = 40.0
_YAWS_DEG: Final = np.arange(-12, 13) / 2
_STRAIGHT: Final = 12
"""Place of 0 among these."""
_LEAST_YAW_DEG: Final = 1.0
"""Smallest yaw to report; five random frames of KITTI's 90 have 0.5 or less (2,000 draws)."""
_STRAIGHT_SHARE: Final = 0.9
"""Largest ratio of points in boxes without and with a turn; the same five have 0.957 or more."""
_MIRRORED_RATIO: Final = 1.5
"""Smallest ratio of points in boxes with and without mirroring; see docs/log.md."""
_ROAD_M: Final = 0.2  # of a box's height, which holds the road
_MARGIN_M: Final = 0.15  # around a box, whose sides cut the points of exact labels in halves


@dataclass(frozen=True, kw_only=True, slots=True)
class LabelledSweep:
    """Labels of a frame, with its cloud and calibration."""

    objects: KittiObjects
    matrices: CalibrationMatrices
    points: Float32[np.ndarray, "num_points 4"]


def check_label_yaw(
    frames: Sequence[ObjectFrame], read: Callable[[ObjectFrame], LabelledSweep | None]
) -> list[Problem]:
    """Find clouds that fill the 3D boxes of labels better when they are turned, or mirrored.

    Counts the points in the boxes of objects within 40 m that are at most partly hidden, with the
    cloud turned by up to 6 degrees about the LiDAR's z axis, and mirrored (y negated). Fewer than
    ten objects of twenty points or more give too little evidence.

    Args:
        frames: Frames of one rig.
        read: Reader of a frame; None: it lacks a part, or is unreadable.
    """
    labelled = [frame for frame in frames if frame.objects and frame.points and frame.calibration]
    labelled = labelled[:: max(len(labelled) // _MOST_FRAMES, 1)][:_MOST_FRAMES]
    sweeps = [sweep for frame in labelled if (sweep := read(frame)) is not None]
    counts = np.concatenate([np.zeros((0, len(_YAWS_DEG) + 1)), *map(_count_points, sweeps)])
    most = counts.max(axis=1, initial=0)
    is_dense = most >= _FEWEST_POINTS
    if np.count_nonzero(is_dense) < _FEWEST_OBJECTS:
        return []
    scores = (counts[is_dense] / most[is_dense, None]).sum(axis=0)
    doubt = _doubt(scores)
    if doubt is None:
        return []
    first = labelled[0]
    assert first.calibration is not None, "it was chosen for it"
    problem = f"and those of {len(sweeps) - 1} more frames {doubt[0]}"
    return [Problem(path=first.calibration, problem=problem, remedy=doubt[1])]


def _doubt(scores: Float64[np.ndarray, " num_turns"]) -> tuple[str, str] | None:
    """Problem, as the rest of a sentence on calibrations, and remedy."""
    turned, mirrored = scores[:-1], float(scores[-1])
    straight, best = float(turned[_STRAIGHT]), int(turned.argmax())
    if mirrored >= _MIRRORED_RATIO * float(turned[best]):
        return (
            "seem to be of mirrored clouds: with y negated the 3D boxes of the labels hold "
            f"{mirrored / max(straight, 1e-9):.3g} times as many points",
            "write clouds with y to the left: negate y",
        )
    yaw_deg = float(_YAWS_DEG[best])
    if abs(yaw_deg) < _LEAST_YAW_DEG or straight >= _STRAIGHT_SHARE * float(turned[best]):
        return None
    is_limit = best in (0, len(_YAWS_DEG) - 1)
    further = "; no larger yaw is tried: it may be more, or a wrong scale or offset instead"
    return (
        f"seem to be off by {yaw_deg:+.1f} degrees of yaw (counter-clockwise about the LiDAR's z "
        "axis): with clouds turned so the 3D boxes of the labels hold "
        f"{turned[best] / max(straight, 1e-9):.3g} times as many points",
        "correct the rotation from LiDAR to camera (Tr_velo_to_cam and R0_rect; of a recording "
        f"camera_from_lidar){further if is_limit else ''}",
    )


def _count_points(sweep: LabelledSweep) -> Int64[np.ndarray, "num_objects num_turns"]:
    """Points in each object's box, for each yaw, and last for the mirrored cloud."""
    objects, xyz = sweep.objects, sweep.points[:, :3].astype(np.float64)
    camera_from_lidar = sweep.matrices.camera_from_lidar
    lidar_from_camera = np.linalg.inv(camera_from_lidar)
    ranges_m = np.hypot(xyz[:, 0], xyz[:, 1])
    counts = []
    for index in chosen_objects(objects, within_m=_WITHIN_M)[:_MOST_OBJECTS]:
        centre = lidar_from_camera[:3, :3] @ objects.locations[index] + lidar_from_camera[:3, 3]
        reach_m = float(np.linalg.norm(objects.dimensions_hwl[index]))
        # Turned about z, a point keeps its distance from it.
        near = xyz[np.abs(ranges_m - np.hypot(*centre[:2])) < reach_m]
        turned = [
            is_in_box(
                objects,
                index,
                near @ turn.T + camera_from_lidar[:3, 3],
                above_m=_ROAD_M,
                margin_m=_MARGIN_M,
            )
            for turn in _turns(camera_from_lidar)
        ]
        counts.append([int(np.count_nonzero(each)) for each in turned])
    return np.array(counts, dtype=np.int64).reshape(-1, len(_YAWS_DEG) + 1)


def _turns(camera_from_lidar: Float64[np.ndarray, "4 4"]) -> list[Float64[np.ndarray, "3 3"]]:
    """Rotations from LiDAR to camera after a turn by each yaw, and after mirroring."""
    radians = np.radians(_YAWS_DEG)
    rotations = [
        np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        for cos, sin in zip(np.cos(radians), np.sin(radians), strict=True)
    ]
    return [camera_from_lidar[:3, :3] @ each for each in (*rotations, np.diag([1.0, -1.0, 1.0]))]
