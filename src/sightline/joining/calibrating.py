"""Fit of the maps that calibrate the scores of joined objects."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float64
from scipy.optimize import minimize

from sightline.joining.config import JoinConfig
from sightline.joining.evidence import image_iou
from sightline.joining.fitting import (
    GRADES_2D,
    GRADES_3D,
    FitFrame,
    Grades,
    is_class,
    is_hidden,
    label_masks,
)
from sightline.joining.join import join_detections
from sightline.joining.models import CLASSES, JoinModels, ScoreMap
from sightline.joining.refining import Refine
from sightline.joining.scene import make_scene
from sightline.ops.rotated_iou import pairwise_iou_3d
from sightline.structures.labels import ObjectLabels
from sightline.structures.level import level_sample
from sightline.structures.objects import Objects

_MIN_SCORE: Final = 0.05  # most boxes have less, and would decide alone
_PENALTY: Final = 1.0  # on the distance to the identity, against the sum over objects
_LEAST_SLOPE: Final = 0.05
_SAME_IOU: Final = 0.3  # with a look-alike, above which a 3D box is left out


class _Rows(NamedTuple):
    """Scores of objects of one class, and their shares of fit."""

    scores: Float64[np.ndarray, " num_objects"]
    target: Float64[np.ndarray, " num_objects"]


def calibrate_models(
    models: JoinModels,
    frames: Iterable[FitFrame],
    refine: Refine | None = None,
    fallback: JoinModels | None = None,
) -> JoinModels:
    """Fit the calibrators to joined objects of labelled frames.

    The target is the share of fit as in `fit_models`, but each label counts once, for the surest
    object that fits it: repeated objects are wrong. Deterministic.

    Args:
        models: The models of scores.
        frames: Labelled frames with their detections.
        refine: Second stage of the sweep detector; see `join_detections`.
        fallback: Models with the calibrators for classes and kinds of which no object fits a label.
    """
    rows: dict[tuple[str, str], list[_Rows]] = {}
    for frame in frames:
        for key, each in _rows_of(frame, models, refine).items():
            rows.setdefault(key, []).append(each)
    maps = {kind: dict(of_kind) for kind, of_kind in (fallback or models).calibrators.items()}
    for (kind, name), parts in rows.items():
        scores, target = map(np.concatenate, zip(*parts, strict=True))
        if fallback is None or target.any():
            maps[kind][name] = fit_map(scores, target)
    return replace(models, calibrators=maps)


def fit_map(
    scores: Float64[np.ndarray, " num_objects"], target: Float64[np.ndarray, " num_objects"]
) -> ScoreMap:
    """Fit a map by cross-entropy, with a penalty on its distance to the identity."""
    kept = scores >= _MIN_SCORE
    limited, target = np.clip(scores[kept], 1e-9, 1 - 1e-9), target[kept]
    columns = np.stack((np.log(limited), -np.log1p(-limited), np.ones(len(limited))), axis=1)
    identity = np.array([1.0, 1.0, 0.0])

    def loss(given: Float64[np.ndarray, "3"]) -> tuple[float, Float64[np.ndarray, "3"]]:
        logits, away = columns @ given, given - identity
        value = np.logaddexp(0.0, logits).sum() - target @ logits + _PENALTY * away @ away / 2
        residual = 1 / (1 + np.exp(-np.clip(logits, -50, 50))) - target
        return float(value), columns.T @ residual + _PENALTY * away

    bounds = [(_LEAST_SLOPE, None), (_LEAST_SLOPE, None), (None, None)]
    found = minimize(loss, identity, jac=True, method="L-BFGS-B", bounds=bounds, tol=1e-10)
    low, high, bias = (round(float(each), 4) for each in found.x)
    return ScoreMap(low=low, high=high, bias=bias)


def _rows_of(
    frame: FitFrame, models: JoinModels, refine: Refine | None
) -> dict[tuple[str, str], _Rows]:
    """Scores and targets of a frame's objects, by kind and class."""
    labels = level_sample(frame.sample).objects
    assert labels is not None, "the models were fitted to the frame"
    config = JoinConfig(calibrate=False)
    objects = join_detections(frame.sample, frame.found2d, frame.found3d, models, config, refine)
    kind = "image" if make_scene(frame.sample, None, None).has_lidar else "alone"
    boxes3d = objects.boxes3d
    if frame.sample.level_from_lidar is not None:
        boxes3d = boxes3d.to_level(frame.sample.level_from_lidar)
    rows = {}
    for name in CLASSES:
        of_class = is_class(objects.class_names, name)
        in_image = of_class & objects.has_box2d.numpy()
        rows[kind, name] = _in_image(objects, in_image, labels, name)
        in_space = in_image & objects.has_box3d.numpy()
        rows[f"{kind}_3d", name] = _in_space(
            objects, boxes3d.tensor.double()[torch.from_numpy(in_space)], in_space, labels, name
        )
    return rows


def _in_image(
    objects: Objects, chosen: Bool[np.ndarray, " num_objects"], labels: ObjectLabels, name: str
) -> _Rows:
    boxes, scores = objects.boxes2d.tensor.numpy()[chosen], objects.scores.numpy()[chosen]
    own, similar = label_masks(labels, name)
    truth = labels.boxes2d.tensor.double().numpy()
    iou = _first_iou(image_iou(boxes, truth[own]), scores, GRADES_2D[name])
    like = tuple({each for each, is_one in zip(labels.class_names, similar, strict=True) if is_one})
    hidden = is_hidden(boxes, labels, ("DontCare", *like))
    return _targets(scores, iou, hidden, GRADES_2D[name])


def _in_space(
    objects: Objects,
    boxes: Float64[torch.Tensor, "num_chosen 7"],
    chosen: Bool[np.ndarray, " num_objects"],
    labels: ObjectLabels,
    name: str,
) -> _Rows:
    scores, has_box = objects.scores3d.numpy()[chosen], labels.has_box3d.numpy()
    own, similar = (
        pairwise_iou_3d(
            boxes, labels.boxes3d.tensor[torch.from_numpy(mask & has_box)].double()
        ).numpy()
        for mask in label_masks(labels, name)
    )  # fmt: skip
    iou = _first_iou(own, scores, GRADES_3D[name])
    in_image = objects.boxes2d.tensor.numpy()[chosen]
    hidden = is_hidden(in_image, labels, ("DontCare",))
    hidden |= similar.max(axis=1, initial=0.0) > _SAME_IOU
    return _targets(scores, iou, hidden, GRADES_3D[name])


def _first_iou(
    iou: Float64[np.ndarray, "num_boxes num_labels"],
    scores: Float64[np.ndarray, " num_boxes"],
    grades: Grades,
) -> Float64[np.ndarray, " num_boxes"]:
    """IoU of each box with its best label that no surer box has taken."""
    best = np.zeros(len(scores))
    free = np.ones(iou.shape[1], dtype=bool)
    for row in np.argsort(-scores, kind="stable") if iou.shape[1] else ():
        label = int(np.where(free, iou[row], -1.0).argmax())
        if free[label] and iou[row, label] > grades.wrong:
            best[row], free[label] = iou[row, label], False
    return best


def _targets(
    scores: Float64[np.ndarray, " num_boxes"],
    iou: Float64[np.ndarray, " num_boxes"],
    is_left_out: Bool[np.ndarray, " num_boxes"],
    grades: Grades,
) -> _Rows:
    """Targets without the boxes that fit nothing and are left out."""
    kept = (iou > 0) | ~is_left_out
    return _Rows(scores[kept], grades(iou[kept]))
