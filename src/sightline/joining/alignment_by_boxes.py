"""Rotation of the LiDAR against the camera by boxes that both detectors found."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from sightline.joining.evidence import gather_evidence
from sightline.joining.scene import Scene, make_scene
from sightline.structures.lidar_turn import LidarTurn, undo_turn
from sightline.structures.predictions import Detections2D, Detections3D
from sightline.structures.sample import CameraLidarSample

MIN_DEVIATIONS: Final = 1.5
"""Shift, in standard deviations, from which a frame counts as misaligned."""

_MIN_IOU: Final = 0.2  # of a pair
_MIN_SCORE: Final = 0.2
_BORDER_PX: Final = 2.0
_DEVIATION_PX: Final = 1.5  # of the distance of both centres of a sound pair, at least
_DEVIATION_SHARE: Final = 0.06  # the same, as a share of the box's size
_USUAL_PX: Final = 12.0  # shift by one degree in KITTI's image: expected where there is one
_PASSES: Final = 2  # after the first, more pairs overlap
_CLEARLY: Final = 1.05  # factor by which boxes must agree more without an angle to drop it


class DetectedFrame(NamedTuple):
    """Frame and what both detectors found in it; None: one cannot run."""

    sample: CameraLidarSample
    found2d: Detections2D | None
    found3d: Detections3D | None


class _Shift(NamedTuple):
    """Shift of the projected boxes from the image's [px]."""

    pixels: Float64[np.ndarray, "2"]
    deviations: float
    """Its length, in standard deviations."""


def turn_by_boxes(
    sample: CameraLidarSample, found2d: Detections2D | None, found3d: Detections3D | None
) -> LidarTurn:
    """Measure yaw and pitch by the common shift of projected boxes from boxes in the image.

    A rotation shifts all boxes by the same number of pixels, near and far. Less sure than edges of
    several frames (`measure_alignment`), so it is for frames of unknown mount.

    Returns:
        The rotation; 0 without an image, or if the shift is within the usual distance of sound
        pairs.
    """
    turn = LidarTurn()
    for number in range(_PASSES):
        scene = make_scene(undo_turn(sample, turn), found2d, found3d)
        shift = _shift(scene) if scene.has_camera else None
        if shift is None or (number == 0 and shift.deviations < MIN_DEVIATIONS):
            break
        focal = np.diag(scene.image_from_camera)[:2]
        right_deg, down_deg = np.degrees(np.arctan(shift.pixels / focal)).tolist()
        turn = LidarTurn(yaw_deg=turn.yaw_deg - right_deg, pitch_deg=turn.pitch_deg + down_deg)
    return turn


def confirm_turn(turn: LidarTurn, frames: Sequence[DetectedFrame]) -> LidarTurn:
    """Keep the angles of a measured rotation with which both detectors' boxes overlap most.

    Edges can mislead: rings of sparse sweeps end below the true edges, all by the same angle. So
    where no pair of boxes overlaps, as without one of the detectors, only the yaw is kept, which
    follows from upright edges.

    Args:
        turn: Rotation measured otherwise, such as by edges.
        frames: Frames of the recording, as calibrated.

    Returns:
        The rotation, with angles set to 0 that clearly make the boxes disagree or that no box
        confirms.
    """
    angles = turn.to_json()
    choices = [
        replace(turn, **{name: 0.0 for name, keep in zip(angles, kept, strict=True) if not keep})
        for kept in product(*((True, False) if angle else (True,) for angle in angles.values()))
    ]
    overlaps = [sum(_overlap(frame, choice) for frame in frames) for choice in choices]
    best = int(np.argmax(overlaps))
    if overlaps[best] == 0:
        return LidarTurn(yaw_deg=turn.yaw_deg)
    return choices[best] if overlaps[best] > _CLEARLY * overlaps[0] else turn


def _overlap(frame: DetectedFrame, turn: LidarTurn) -> float:
    """Sum the IoUs of the pairs of boxes in a frame whose rotation is undone."""
    scene = make_scene(undo_turn(frame.sample, turn), frame.found2d, frame.found3d)
    return float(gather_evidence(scene).iou[mutual_pairs(scene)].sum())


def mutual_pairs(
    scene: Scene,
) -> tuple[Int64[np.ndarray, " num_pairs"], Int64[np.ndarray, " num_pairs"]]:
    """Indices of the boxes of the sweep and of the image that overlap each other most."""
    evidence, sweep, image = gather_evidence(scene), scene.sweep, scene.image
    sure = (sweep.scores[:, None] > _MIN_SCORE) & (image.scores[None] > _MIN_SCORE)
    iou = np.where(evidence.same_class & sure & (evidence.iou > _MIN_IOU), evidence.iou, 0.0)
    if iou.size == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    rows = np.flatnonzero(iou.max(axis=1) > 0)
    columns = iou[rows].argmax(axis=1)
    is_mutual = iou[:, columns].argmax(axis=0) == rows
    return rows[is_mutual], columns[is_mutual]


def centre_deviations(
    boxes: Float64[np.ndarray, "num_boxes 4"],
) -> Float64[np.ndarray, "num_boxes 2"]:
    """Standard deviations of the distance of both centres of sound pairs [px]."""
    return np.asarray(np.hypot(_DEVIATION_PX, _DEVIATION_SHARE * (boxes[:, 2:] - boxes[:, :2])))


def _shift(scene: Scene) -> _Shift | None:
    """Mean shift of the pairs, weighted by sureness and size; None: there are none."""
    sweep, image = scene.sweep, scene.image
    rows, columns = mutual_pairs(scene)
    if len(rows) == 0:
        return None
    own, other = sweep.in_image[rows], image.in_image[columns]
    shifts = (own[:, :2] + own[:, 2:] - other[:, :2] - other[:, 2:]) / 2
    deviations = centre_deviations(own)
    weights = np.minimum(sweep.scores[rows], image.scores[columns])[:, None] / deviations**2
    edges = np.stack((own, other))
    is_cut = (edges[:, :, 0] <= _BORDER_PX) | (
        edges[:, :, 2] >= scene.image_size[1] - 1 - _BORDER_PX
    )
    weights[:, 0] *= ~is_cut.any(axis=0)
    total = weights.sum(axis=0)
    mean = (weights * shifts).sum(axis=0) / np.maximum(total, 1e-9)
    shrunk = mean * _USUAL_PX**2 / (_USUAL_PX**2 + 1 / np.maximum(total, 1e-9))
    return _Shift(shrunk, math.hypot(*(mean * np.sqrt(total))))
