"""Fit of the distances of image boxes on labelled frames."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np
import torch
from jaxtyping import Float64

from sightline.geometry.boxes2d import Boxes2D
from sightline.joining.lifting import scene_columns
from sightline.joining.models import CLASSES
from sightline.joining.ranges import RANGE_COLUMNS
from sightline.joining.scene import make_scene
from sightline.structures.labels import ObjectLabels
from sightline.structures.level import level_sample
from sightline.structures.predictions import Detections2D
from sightline.structures.sample import CameraLidarSample

_COPIES: Final = 12  # of each label's box, all but the first inexact as a detector's
_SPREAD: Final = 0.045  # of their edges, as a share of the size
_LEAST_HEIGHT_PX: Final = 16.0
_MAX_TRUNCATION: Final = 0.35
_MAX_OCCLUSION: Final = 2
_NEAREST_M: Final = 2.0
_USUAL_ERROR: Final = 0.06  # of the log of the distance, beyond which a box counts less
_PENALTY: Final = 0.1
_ROUNDS: Final = 20
_SEED: Final = 0


def fit_ranges(samples: Iterable[CameraLidarSample]) -> dict[str, tuple[float, ...]]:
    """Fit the weights of `range_columns` of each class to the log of the distance, robustly.

    Deterministic: Huber's loss with a small penalty, by reweighted least squares.

    Args:
        samples: Frames with labels and calibration; neither image nor sweep is used.

    Raises:
        ValueError: A frame has no labels, or there is no object of a class.
    """
    rng = np.random.default_rng(_SEED)
    columns: dict[str, list[Float64[np.ndarray, "rows 18"]]] = {name: [] for name in CLASSES}
    targets: dict[str, list[Float64[np.ndarray, " rows"]]] = {name: [] for name in CLASSES}
    for sample in samples:
        level = level_sample(replace(sample, image=None, points=None))
        if level.objects is None:
            raise ValueError(f"sample {sample.sample_id} has no labels; give labelled frames")
        for name in CLASSES:
            chosen = _chosen(level.objects, name, level)
            found, depths = _inexact(level.objects, chosen, name, level, rng)
            rows = scene_columns(make_scene(level, found, None), range(len(depths)))
            columns[name].append(rows)
            targets[name].append(np.log(depths) - rows[:, RANGE_COLUMNS.index("z")])
    weights = {}
    for name in CLASSES:
        rows, target = np.concatenate(columns[name]), np.concatenate(targets[name])
        if not len(rows):
            raise ValueError(f"there is no object of class {name} in view; give more frames")
        weights[name] = tuple(round(float(each), 6) for each in robust_fit(rows, target))
    return weights


def robust_fit(
    rows: Float64[np.ndarray, "rows columns"], target: Float64[np.ndarray, " rows"]
) -> Float64[np.ndarray, " columns"]:
    """Fit a linear function by Huber's loss."""
    counts, found = np.ones(len(rows)), np.zeros(rows.shape[1])
    for _ in range(_ROUNDS):
        weighted = rows.T * counts
        penalised = weighted @ rows + _PENALTY * np.eye(rows.shape[1])
        found = np.linalg.solve(penalised, weighted @ target)
        counts = 1 / np.maximum(np.abs(target - rows @ found) / _USUAL_ERROR, 1.0)
    return found


def _depths(objects: ObjectLabels, level: CameraLidarSample) -> Float64[np.ndarray, " num_objects"]:
    """Depths of the centres of the bottoms [m]."""
    boxes = objects.boxes3d.tensor.double().numpy()
    bottoms = boxes[:, :3] - np.array([[0.0, 0.0, 0.5]]) * boxes[:, 5:6]
    ahead = level.calibration.camera_from_lidar.numpy()[2]
    return np.asarray(bottoms @ ahead[:3] + ahead[3])


def _chosen(objects: ObjectLabels, name: str, level: CameraLidarSample) -> list[int]:
    """Indices of the objects of a class that a detector would find."""
    corners = objects.boxes2d.tensor.double().numpy()
    kept = np.array([each == name for each in objects.class_names], dtype=bool)
    kept &= (objects.truncation <= _MAX_TRUNCATION).numpy() & objects.has_box3d.numpy()
    kept &= (objects.occlusion <= _MAX_OCCLUSION).numpy()
    kept &= corners[:, 3] - corners[:, 1] >= _LEAST_HEIGHT_PX
    kept &= _depths(objects, level) >= _NEAREST_M
    return [int(each) for each in np.flatnonzero(kept)]


def _inexact(
    objects: ObjectLabels,
    chosen: list[int],
    name: str,
    level: CameraLidarSample,
    rng: np.random.Generator,
) -> tuple[Detections2D, Float64[np.ndarray, " num_boxes"]]:
    """Copies of the labels' boxes with moved edges, and the depths of their objects."""
    corners = objects.boxes2d.tensor.double().numpy()[np.repeat(chosen, _COPIES).astype(int)]
    sizes = np.tile(corners[:, 2:] - corners[:, :2], 2)
    moved = corners + _SPREAD * sizes * rng.standard_normal(corners.shape)
    moved[::_COPIES] = corners[::_COPIES]
    height, width = level.image_size
    moved = np.clip(moved, 0.0, [width - 1, height - 1, width - 1, height - 1])
    moved[:, 2:] = np.maximum(moved[:, 2:], moved[:, :2] + 1.0)
    found = Detections2D(
        class_names=(name,) * len(moved),
        boxes=Boxes2D(torch.from_numpy(moved)),
        scores=torch.ones(len(moved), dtype=torch.float64),
    )
    return found, np.repeat(_depths(objects, level)[chosen], _COPIES)
