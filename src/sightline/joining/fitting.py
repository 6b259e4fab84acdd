"""Fit of the models that score joined objects, on labelled frames with sound and faulty sensors."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float64
from scipy.optimize import minimize

from sightline.geometry.user_warning import warn_user
from sightline.joining.config import JoinConfig
from sightline.joining.evidence import gather_evidence, image_iou
from sightline.joining.join import image_kind, liftable, match
from sightline.joining.lifting import lift
from sightline.joining.models import CLASSES, COLUMNS, JoinModels, LogisticModel, identity_maps
from sightline.joining.scene import Scene, make_scene
from sightline.ops.rotated_iou import pairwise_iou_3d
from sightline.structures.labels import LOOK_ALIKES, ObjectLabels
from sightline.structures.level import level_sample
from sightline.structures.predictions import Detections2D, Detections3D
from sightline.structures.sample import CameraLidarSample

_PENALTY: Final = 10.0  # of squared weights of standardised evidence, against the sum over boxes
_HIDDEN_SHARE: Final = 0.5  # of a box within an ignored area, above which it is left out
_LOOK_ALIKE_IOU: Final = 0.3


class Grades(NamedTuple):
    """IoU below which a box is wrong, and above which it is right; linear between."""

    wrong: float
    right: float

    def __call__(self, iou: Float64[np.ndarray, " num_boxes"]) -> Float64[np.ndarray, " num_boxes"]:
        """Share of fit by the IoU."""
        return np.asarray(np.clip((iou - self.wrong) / (self.right - self.wrong), 0.0, 1.0))


GRADES_3D: Final = {
    "Car": Grades(0.3, 0.75),
    "Pedestrian": Grades(0.15, 0.6),
    "Cyclist": Grades(0.15, 0.6),
}
GRADES_2D: Final = {
    "Car": Grades(0.5, 0.8),
    "Pedestrian": Grades(0.3, 0.65),
    "Cyclist": Grades(0.3, 0.65),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class FitFrame:
    """Labelled frame as the detectors got it, with their detections."""

    sample: CameraLidarSample
    """Frame with labels; its sensors may be faulty or missing."""
    found2d: Detections2D | None
    found3d: Detections3D | None


class _Rows(NamedTuple):
    """Evidence and targets of boxes of one class and kind."""

    evidence: Float64[np.ndarray, "num_boxes columns"]
    target: Float64[np.ndarray, " num_boxes"]


def fit_models(
    frames: Iterable[FitFrame],
    provenance: Mapping[str, Any],
    fallback: JoinModels | None = None,
) -> JoinModels:
    """Fit the models of all kinds of boxes and all classes, their scores not yet calibrated.

    The target of a box is its share of fit: 0 below one IoU with every label of its class, 1 above
    another, linear between. It is the probability that the box is right if the demanded IoU is
    drawn evenly between both, so a score is a probability. Boxes on look-alikes or in DontCare
    areas are left out. Deterministic: the loss is convex and starts from zero.

    Args:
        frames: Labelled frames with their detections.
        provenance: Origin of the models.
        fallback: Models for classes and kinds of which no box fits a label, with a warning.

    Raises:
        ValueError: A frame has no labels, no box fits a label, or without a fallback none of a
            class and kind.
    """
    rows: dict[tuple[str, str], list[_Rows]] = {}
    for frame in frames:
        for key, each in _rows_of(frame).items():
            rows.setdefault(key, []).append(each)
    fitted = {
        (kind, name): fit_logistic(
            np.concatenate([part.evidence for part in parts]),
            np.concatenate([part.target for part in parts]),
        )
        for (kind, name), parts in rows.items()
        if any(part.target.any() if fallback else part.target.size for part in parts)
    }
    unfitted = {
        name: kinds
        for name in CLASSES
        if (kinds := [kind for kind in COLUMNS if (kind, name) not in fitted])
    }
    if unfitted:
        names = ", ".join(
            name if len(kinds) == len(COLUMNS) else f"{name} ({', '.join(kinds)})"
            for name, kinds in unfitted.items()
        )
        remedy = "give more frames, with 3D labels of these objects"
        if fallback is None or not fitted:
            raise ValueError(f"no box of {names} fits a label, so no scores are fitted; {remedy}")
        warn_user(
            f"no box of {names} fits a label, so scores stay those of the shipped models; {remedy}",
        )
    models = {
        kind: {name: fitted.get((kind, name)) or getattr(fallback, kind)[name] for name in CLASSES}
        for kind in COLUMNS
    }
    return JoinModels(**models, calibrators=identity_maps(), provenance=provenance)


def fit_logistic(
    evidence: Float64[np.ndarray, "num_boxes columns"], target: Float64[np.ndarray, " num_boxes"]
) -> LogisticModel:
    """Fit a logistic regression by cross-entropy with a penalty on weights.

    Args:
        evidence: Evidence; columns are standardised for the fit.
        target: Shares in [0, 1].
    """
    mean, scale = evidence.mean(axis=0), evidence.std(axis=0)
    scale = np.where(scale > 1e-9, scale, 1.0)
    rows = np.column_stack(((evidence - mean) / scale, np.ones(len(evidence))))

    def loss(given: Float64[np.ndarray, " values"]) -> tuple[float, Float64[np.ndarray, " values"]]:
        logits, weights = rows @ given, np.append(given[:-1], 0.0)
        value = np.logaddexp(0.0, logits).sum() - target @ logits + _PENALTY * weights @ weights / 2
        residual = 1 / (1 + np.exp(-np.clip(logits, -50, 50))) - target
        return float(value), rows.T @ residual + _PENALTY * weights

    found = minimize(loss, np.zeros(rows.shape[1]), jac=True, method="L-BFGS-B", tol=1e-10)
    weights = found.x[:-1] / scale
    return LogisticModel(
        weights=tuple(round(float(each), 6) for each in weights),
        bias=round(float(found.x[-1] - weights @ mean), 6),
    )


def _rows_of(frame: FitFrame) -> dict[tuple[str, str], _Rows]:
    """Evidence and targets of a frame's boxes by kind and class."""
    labels = level_sample(frame.sample).objects
    if labels is None:
        raise ValueError(
            f"sample {frame.sample.sample_id} has no labels, so scores cannot be fitted; give "
            "labelled frames"
        )
    scene = make_scene(frame.sample, frame.found2d, frame.found3d)
    evidence = gather_evidence(scene)
    config = JoinConfig()
    kind, seen = image_kind(scene, evidence, config)
    partner = match(evidence, scene.sweep.scores, scene.image.scores, config)
    alone = liftable(scene, partner, config)
    lifted = list(lift(scene, alone).values())
    boxes3d = np.array([each.box for each in lifted]).reshape(-1, 7)
    lifted_rows = np.array([each.evidence for each in lifted]).reshape(-1, len(COLUMNS["lifted"]))
    rows: dict[tuple[str, str], _Rows] = {}
    for name in CLASSES:
        is_swept = is_class(scene.sweep.names, name) & ~np.isnan(scene.sweep.in_image).any(axis=1)
        is_seen = is_class(scene.image.names, name)
        is_lifted = is_seen[alone] if alone else np.zeros(0, dtype=bool)
        rows |= {
            ("sweep", name): _graded_3d(
                evidence.sweep, scene.boxes3d, scene.sweep.in_image, is_swept, labels, name
            ),
            (kind, name): _graded_2d(seen, scene, is_seen, labels, name),
            ("lifted", name): _graded_3d(
                lifted_rows, boxes3d, scene.image.in_image[alone], is_lifted, labels, name
            ),
        }
    return rows


def is_class(names: tuple[str, ...], name: str) -> Bool[np.ndarray, " num_boxes"]:
    """Mask of the boxes of a class."""
    return np.array([each == name for each in names], dtype=bool)


def _graded_3d(
    evidence: Float64[np.ndarray, "num_boxes columns"],
    boxes: Float64[np.ndarray, "num_boxes 7"],
    in_image: Float64[np.ndarray, "num_boxes 4"],
    chosen: Bool[np.ndarray, " num_boxes"],
    labels: ObjectLabels,
    name: str,
) -> _Rows:
    grades, has_box = GRADES_3D[name], labels.has_box3d.numpy()
    given = torch.from_numpy(boxes[chosen])
    own, similar = (
        pairwise_iou_3d(
            given, labels.boxes3d.tensor[torch.from_numpy(mask & has_box)].double()
        ).numpy().max(axis=1, initial=0.0)
        for mask in label_masks(labels, name)
    )  # fmt: skip
    is_left_out = (similar > _LOOK_ALIKE_IOU) & (own < grades.wrong)
    is_left_out |= is_hidden(in_image[chosen], labels, ("DontCare",)) & (own < grades.wrong)
    return _graded(evidence[chosen], own, is_left_out, grades)


def _graded_2d(
    evidence: Float64[np.ndarray, "num_boxes columns"],
    scene: Scene,
    chosen: Bool[np.ndarray, " num_boxes"],
    labels: ObjectLabels,
    name: str,
) -> _Rows:
    grades, boxes = GRADES_2D[name], scene.image.in_image[chosen]
    mask = label_masks(labels, name)[0]
    own = image_iou(boxes, labels.boxes2d.tensor.numpy()[mask]).max(axis=1, initial=0.0)
    similar = tuple(each for each, like in LOOK_ALIKES.items() if like == name)
    is_left_out = is_hidden(boxes, labels, ("DontCare", *similar)) & (own < grades.wrong)
    return _graded(evidence[chosen], own, is_left_out, grades)


def _graded(
    evidence: Float64[np.ndarray, "num_boxes columns"],
    iou: Float64[np.ndarray, " num_boxes"],
    is_left_out: Bool[np.ndarray, " num_boxes"],
    grades: Grades,
) -> _Rows:
    return _Rows(evidence[~is_left_out], grades(iou[~is_left_out]))


def label_masks(
    labels: ObjectLabels, name: str
) -> tuple[Bool[np.ndarray, " num_objects"], Bool[np.ndarray, " num_objects"]]:
    """Masks of the labels of a class, and of its look-alikes."""
    is_own = is_class(labels.class_names, name)
    return is_own, np.array([LOOK_ALIKES.get(each) == name for each in labels.class_names], bool)


def is_hidden(
    boxes: Float64[np.ndarray, "num_boxes 4"], labels: ObjectLabels, names: tuple[str, ...]
) -> Bool[np.ndarray, " num_boxes"]:
    """Mask of the boxes that lie mostly within one label of these classes."""
    areas = labels.boxes2d.tensor.numpy()[[name in names for name in labels.class_names]]
    lower = np.maximum(boxes[:, None, :2], areas[None, :, :2])
    upper = np.minimum(boxes[:, None, 2:], areas[None, :, 2:])
    shared = np.clip(upper - lower, 0.0, None).prod(axis=2)
    size = np.maximum((boxes[:, 2:] - boxes[:, :2]).prod(axis=1), 1.0)
    return np.asarray((shared / size[:, None]).max(axis=1, initial=0.0) > _HIDDEN_SHARE)
