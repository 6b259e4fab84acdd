"""One list of objects from the detections of both detectors, in stages that can be switched off."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final, Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.joining.config import JoinConfig
from sightline.joining.evidence import ALONE_COLUMNS, Evidence, gather_evidence, image_iou
from sightline.joining.lifting import Lifted, lift
from sightline.joining.models import JoinModels, LogisticModel
from sightline.joining.refining import Refine, add_refined
from sightline.joining.scene import Scene, count_all_returns, make_scene, with_sweep_boxes
from sightline.structures.level import mounted_detections
from sightline.structures.objects import Objects, Origin
from sightline.structures.predictions import Detections2D, Detections3D
from sightline.structures.sample import CameraLidarSample

_FROM_RETURNS: Final = ("measured", "refined")  # origins of 3D boxes
_SHARE_IF_LATE: Final = 0.1  # of a sweep's score: its projected boxes seldom fit


def join_detections(
    sample: CameraLidarSample,
    found2d: Detections2D | None,
    found3d: Detections3D | None,
    models: JoinModels,
    config: JoinConfig | None = None,
    refine: Refine | None = None,
) -> Objects:
    """Join the detections of a frame to objects, by descending score.

    Matched boxes have one class; a box matches at most one other. In the image, the score of the
    image box and a share of the 3D box's combine as those of independent observers (noisy or), as
    the model of image boxes knows the 3D detector's already. Equal inputs give equal objects.

    Args:
        sample: The frame, for its calibration, returns and which sensors there are.
        found2d: Detections in the image; None: the detector did not run.
        found3d: Detections in the sweep, in the LiDAR's own frame; None likewise.
        models: Models fitted with the weights of both detectors.
        config: The stages. None: all.
        refine: Second stage of the sweep detector; None: no boxes are proposed to it.
    """
    config = config or JoinConfig()
    if found2d is None or not config.rescore:
        config = replace(config, sweep_share=1.0)
    pairs = _pair(make_scene(sample, found2d, found3d), models, config)
    lifted = _lift_unmatched(pairs, config) if config.lift or config.propose else {}
    is_proposed = np.zeros(len(pairs.scores3d), dtype=bool)
    proposals = {index: lifted[index] for index in _proposed(pairs, lifted, config)}
    if found3d is not None and refine is not None and proposals:
        more = add_refined(sample, pairs.scene, proposals, pairs.scores2d, found3d, refine, config)
        is_proposed = more.is_proposed
        pairs = _pair(with_sweep_boxes(pairs.scene, sample, more.found), models, config)
        lifted = _lift_unmatched(pairs, config, lifted)
    scene, scores3d, scores2d, partner, kind = pairs
    num_points = count_all_returns(scene, sample)
    rows = _measured(scene, num_points, scores3d, scores2d, partner, is_proposed, config)
    alone = np.setdiff1d(np.arange(len(scores2d)), partner)
    rows += _unmatched(scene, scores2d, alone, lifted if config.lift else {}, models)
    if config.rescore and config.calibrate:
        rows = _calibrated(rows, kind, "image_3d" if scene.has_lidar else "alone_3d", models)
    return _as_objects(_without_repeats(rows, config), sample)


def image_kind(
    scene: Scene, evidence: Evidence, config: JoinConfig
) -> tuple[Literal["image", "alone"], Float64[np.ndarray, "num_image columns"]]:
    """Kind of the image detector's boxes, and the evidence that its models take."""
    if scene.has_lidar and config.sweep_in_image:
        return "image", evidence.image
    return "alone", evidence.image[:, : len(ALONE_COLUMNS)]


def match(
    evidence: Evidence,
    scores3d: Float64[np.ndarray, " num_sweep"],
    scores2d: Float64[np.ndarray, " num_image"],
    config: JoinConfig,
) -> Int64[np.ndarray, " num_sweep"]:
    """Index of the image box of each box of the sweep's detector; -1: none.

    The surest box chooses first: among the free boxes of its class that overlap it, the one with
    the largest product of IoU and score. By IoU alone, a doubtful box may be chosen over the sure
    one beside it, which then stays as a second object.
    """
    partner = np.full(len(scores3d), -1, dtype=np.int64)
    if not config.associate or evidence.iou.shape[1] == 0:
        return partner
    free = np.ones(evidence.iou.shape[1], dtype=bool)
    for row in np.argsort(-scores3d, kind="stable"):
        overlaps = evidence.iou[row] >= max(config.min_iou, np.finfo(float).tiny)
        overlaps &= evidence.same_class[row] & free
        best = int(np.where(overlaps, evidence.iou[row] * scores2d, -1.0).argmax())
        if overlaps[best]:
            partner[row], free[best] = best, False
    return partner


def liftable(
    scene: Scene, partner: Int64[np.ndarray, " num_sweep"], config: JoinConfig
) -> list[int]:
    """Indices of the image boxes to lift: those without a partner, from a score on."""
    alone = np.setdiff1d(np.arange(len(scene.image.scores)), partner)
    return [int(each) for each in alone if scene.image.scores[each] >= config.min_lifted_score]


class _Pairs(NamedTuple):
    """Rescored boxes of both detectors, and which are one object."""

    scene: Scene
    scores3d: Float64[np.ndarray, " num_sweep"]
    scores2d: Float64[np.ndarray, " num_image"]
    partner: Int64[np.ndarray, " num_sweep"]
    """See `match`."""
    kind: Literal["image", "alone"]
    """See `image_kind`."""


def _pair(scene: Scene, models: JoinModels, config: JoinConfig) -> _Pairs:
    evidence = gather_evidence(scene)
    scores3d = _scores(scene.sweep.names, scene.sweep.scores, evidence.sweep, models.sweep, config)
    kind, seen = image_kind(scene, evidence, config)
    chosen = models.image if kind == "image" else models.alone
    scores2d = _scores(scene.image.names, scene.image.scores, seen, chosen, config)
    outside = np.isnan(scene.sweep.in_image).any(axis=1)
    scores3d = np.where(outside, scene.sweep.scores, scores3d)
    partner = match(evidence, scores3d, scene.image.scores, config)
    return _Pairs(scene, scores3d, scores2d, partner, kind)


def _lift_unmatched(
    pairs: _Pairs, config: JoinConfig, known: Mapping[int, Lifted] = MappingProxyType({})
) -> dict[int, Lifted]:
    """Lift the image boxes that need it; those that are known are not lifted again."""
    indices = liftable(pairs.scene, pairs.partner, config)
    found = lift(pairs.scene, [index for index in indices if index not in known])
    return {index: found[index] if index in found else known[index] for index in indices}


def _proposed(pairs: _Pairs, lifted: Iterable[int], config: JoinConfig) -> list[int]:
    """Indices of the lifted boxes that the second stage refines: sure ones, beside a sweep."""
    if not (config.propose and config.associate) or pairs.kind == "alone":
        return []
    return [index for index in lifted if pairs.scores2d[index] >= config.min_proposed_score]


class _Row(NamedTuple):
    """One object before its columns are stacked."""

    name: str
    box2d: Float64[np.ndarray, "4"]
    box3d: Float64[np.ndarray, "7"]
    origin: Origin
    score: float
    score3d: float
    image_support: float
    lidar_support: float
    num_points: int


def _scores(
    names: tuple[str, ...],
    own: Float64[np.ndarray, " num_boxes"],
    evidence: Float64[np.ndarray, "num_boxes columns"],
    models: Mapping[str, LogisticModel],
    config: JoinConfig,
) -> Float64[np.ndarray, " num_boxes"]:
    scores = own.copy()
    if not config.rescore:
        return scores
    for name, model in models.items():
        chosen = np.array([each == name for each in names], dtype=bool)
        given = model.score(evidence[chosen])
        scores[chosen] = (1 - config.own_share) * given + config.own_share * own[chosen]
    return scores


def _measured(
    scene: Scene,
    num_points: Int64[np.ndarray, " num_sweep"],
    scores3d: Float64[np.ndarray, " num_sweep"],
    scores2d: Float64[np.ndarray, " num_image"],
    partner: Int64[np.ndarray, " num_sweep"],
    is_proposed: Bool[np.ndarray, " num_sweep"],
    config: JoinConfig,
) -> list[_Row]:
    """Objects of the sweep's detector, with their image boxes.

    The image box of a proposed object stays as it was, as its 3D box is made of it.
    """
    rows = []
    for index, name in enumerate(scene.sweep.names):
        box, support = scene.sweep.in_image[index], 0.0
        share = config.sweep_share if config.sweep_in_image else _SHARE_IF_LATE
        score = scores3d[index] * (1.0 if np.isnan(box).any() else share)
        other = int(partner[index])
        if other >= 0:
            seen, support = scene.image.in_image[other], float(scene.image.scores[other])
            is_mixed = config.mix_boxes and config.sweep_in_image and not is_proposed[index]
            projected = config.projected_share if is_mixed else 0.0
            box = projected * box + (1 - projected) * seen
            score = 1 - (1 - score) * (1 - scores2d[other])
            if not config.sweep_in_image:
                score = scores2d[other]
        rows.append(
            _Row(
                name=name,
                box2d=box,
                box3d=scene.boxes3d[index],
                origin="refined" if is_proposed[index] else "measured",
                score=float(score),
                score3d=float(scores3d[index]),
                image_support=support,
                lidar_support=float(scene.sweep.scores[index]),
                num_points=int(num_points[index]),
            )
        )
    return rows


def _unmatched(
    scene: Scene,
    scores2d: Float64[np.ndarray, " num_image"],
    alone: Int64[np.ndarray, " num_alone"],
    lifted: dict[int, Lifted],
    models: JoinModels,
) -> list[_Row]:
    """Objects of the image detector alone, lifted or without a 3D box."""
    rows = []
    for index in alone.tolist():
        name, found = scene.image.names[index], lifted.get(index)
        score3d = 0.0
        if found is not None:
            score3d = float(models.lifted[name].score(found.evidence[None])[0])
        rows.append(
            _Row(
                name=name,
                box2d=scene.image.in_image[index],
                box3d=np.zeros(7) if found is None else found.box,
                origin="none" if found is None else "lifted",
                score=float(scores2d[index]),
                score3d=score3d,
                image_support=float(scene.image.scores[index]),
                lidar_support=0.0,
                num_points=int(scene.image.num_points[index]),
            )
        )
    return rows


def _calibrated(rows: list[_Row], kind: str, kind_3d: str, models: JoinModels) -> list[_Row]:
    """Calibrate both scores of each object; that of a missing 3D box stays 0.

    The score of an object outside the image is that of its 3D box.
    """
    names = np.array([row.name for row in rows])
    scores = np.array([row.score for row in rows])
    scores3d = np.array([row.score3d for row in rows])
    for name in {row.name for row in rows}:
        chosen = names == name
        scores[chosen] = models.calibrators[kind][name](scores[chosen])
        scores3d[chosen] = models.calibrators[kind_3d][name](scores3d[chosen])
    calibrated = []
    for row, score, score3d in zip(rows, scores.tolist(), scores3d.tolist(), strict=True):
        in_space = score3d if row.origin != "none" else 0.0
        is_outside = bool(np.isnan(row.box2d).any())
        in_image = in_space if is_outside else score
        calibrated.append(row._replace(score=in_image, score3d=in_space))
    return calibrated


def _without_repeats(rows: list[_Row], config: JoinConfig) -> list[_Row]:
    """Leave out objects with an image box alone that repeat a surer one of their class."""
    rows = sorted(rows, key=lambda row: -row.score)
    boxes = np.array([row.box2d for row in rows]).reshape(-1, 4)
    names = np.array([row.name for row in rows])
    is_measured = np.array([row.origin in _FROM_RETURNS for row in rows], dtype=bool)
    limits = np.where(is_measured & config.sweep_in_image, config.min_iou, config.max_iou)
    repeats = (image_iou(boxes, boxes) > limits) & (names[:, None] == names)
    kept: list[int] = []
    for index in range(len(rows)):
        may_repeat = config.associate and not is_measured[index]
        if not (may_repeat and repeats[index, kept].any()):
            kept.append(index)
    return [rows[index] for index in kept]


def _as_objects(rows: list[_Row], sample: CameraLidarSample) -> Objects:
    """Stack the rows; boxes return to the LiDAR's own frame."""
    boxes3d = torch.from_numpy(np.array([row.box3d for row in rows]).reshape(-1, 7))
    has_box = boxes3d[:, 3:6].gt(0).all(dim=1)
    scores3d = torch.tensor([row.score3d for row in rows], dtype=torch.float64)
    names = tuple(row.name for row in rows)
    own = mounted_detections(
        Detections3D(class_names=names, boxes=Boxes3D(boxes3d), scores=scores3d), sample
    ).boxes.where(has_box, Boxes3D(boxes3d))
    column = {
        name: torch.tensor([getattr(row, name) for row in rows], dtype=torch.float64)
        for name in ("score", "image_support", "lidar_support")
    }
    boxes2d = torch.from_numpy(np.array([row.box2d for row in rows]).reshape(-1, 4))
    return Objects(
        class_names=names,
        boxes2d=Boxes2D(boxes2d),
        boxes3d=own,
        origins=tuple(row.origin for row in rows),
        scores=column["score"],
        scores3d=scores3d,
        image_support=column["image_support"],
        lidar_support=column["lidar_support"],
        num_points=torch.tensor([row.num_points for row in rows], dtype=torch.int64),
    )
