"""Training of the second stage: moved ground truths, background, proposals, and losses."""

import math
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

from sightline.detection3d.classes import RoadUserClass
from sightline.detection3d.pillars.boxes import (
    RegionOutput,
    corner_costs,
    decode_regions,
    encode_regions,
    keeps_front,
    quality_from_iou,
)
from sightline.detection3d.pillars.region_config import RegionExamplesConfig, RegionLossConfig
from sightline.detection3d.stages import Proposed
from sightline.detection3d.sweeps import SweepTruth
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.transforms import wrap_angle, yaw_rotation
from sightline.ops.rotated_iou import aligned_iou_3d, pairwise_iou_bev


class RegionExamples(NamedTuple):
    """Proposals of a sweep with ground truth; boxes are x, y, z, length, width, height, yaw."""

    proposals: Float64[Tensor, "num_examples 7"]
    """Boxes in the LiDAR frame, metres and radians."""
    classes: Int64[Tensor, " num_examples"]
    """First stage's classes: indices into the classes."""
    truths: Float64[Tensor, "num_examples 7"]
    """Boxes of their objects; the proposal itself where there is none."""
    is_object: Bool[Tensor, " num_examples"]


def region_examples(
    scene: SweepTruth,
    points: Float[Tensor, "num_points 3"],
    classes: tuple[RoadUserClass, ...],
    rng: np.random.Generator,
    config: RegionExamplesConfig,
    *,
    found: Proposed | None = None,
) -> RegionExamples:
    """Draw examples of a sweep: moved ground truths, then background, then first-stage proposals.

    A frame without objects gives no moved ground truths. Background is a box with a random class's
    mean sizes around a random point, away from all objects, also ignored ones; so there may be
    fewer than requested. Proposals are dropped if they neither match an object of their class nor
    are clear of all such objects and of those ignored for it; on an object of another class they
    are background.

    Points are those of the sweep [m], classes those of the stage; `found` has the first stage's
    detections.
    """
    number = config.num_objects if len(scene.boxes) else 0
    chosen = torch.from_numpy(rng.integers(max(len(scene.boxes), 1), size=number))
    truths = scene.boxes[chosen]
    moved = _moved(truths, 1.0, rng, config)
    parts = [
        RegionExamples(moved, scene.classes[chosen], truths, torch.ones(number, dtype=torch.bool)),
        _background(scene, points, classes, rng, config),
    ]
    if found is not None:
        parts.append(_first_stage(scene, found, rng, config))
    return RegionExamples(*(torch.cat(column) for column in zip(*parts, strict=True)))


def _background(
    scene: SweepTruth,
    points: Float[Tensor, "num_points 3"],
    classes: tuple[RoadUserClass, ...],
    rng: np.random.Generator,
    config: RegionExamplesConfig,
) -> RegionExamples:
    number = config.num_background if len(points) else 0
    chosen = torch.from_numpy(rng.integers(max(len(points), 1), size=number))
    kind = torch.from_numpy(rng.integers(len(classes), size=number))
    sizes = torch.tensor([entry.mean_size_m for entry in classes], dtype=torch.float64)[kind]
    inside = torch.from_numpy(rng.uniform(-0.5, 0.5, (number, 3)))  # the point's place in the box
    yaw = torch.from_numpy(rng.uniform(-math.pi, math.pi, (number, 1)))
    rotation = yaw_rotation(yaw[:, 0])
    offset = (rotation @ (inside * sizes)[:, :, None])[:, :, 0]
    boxes = torch.cat((points[chosen].double() - offset, sizes, yaw), dim=1)
    taken = Boxes3D(torch.cat((scene.boxes, scene.ignored_boxes)))
    is_clear = (pairwise_iou_bev(Boxes3D(boxes).bev, taken.bev) == 0).all(dim=1)
    boxes = boxes[is_clear]
    return RegionExamples(boxes, kind[is_clear], boxes, torch.zeros(len(boxes), dtype=torch.bool))


def _first_stage(
    scene: SweepTruth, found: Proposed, rng: np.random.Generator, config: RegionExamplesConfig
) -> RegionExamples:
    boxes = found.boxes.double()
    iou = pairwise_iou_bev(Boxes3D(boxes).bev, Boxes3D(scene.boxes).bev)
    iou = torch.where(found.classes[:, None] == scene.classes, iou, 0.0)
    # a column of zeros for frames without objects
    best, truth = torch.cat((iou, iou.new_zeros(len(boxes), 1)), dim=1).max(dim=1)
    is_object = best >= max(config.min_iou, 1e-9)
    ignored_iou = pairwise_iou_bev(Boxes3D(boxes).bev, Boxes3D(scene.ignored_boxes).bev)
    is_ignored = (ignored_iou > config.max_background_iou) & scene.ignored_classes.T[found.classes]
    is_off = (best <= config.max_background_iou) & ~is_ignored.any(dim=1)
    usable = (is_object | is_off).nonzero()[:, 0]
    chosen = usable[torch.from_numpy(rng.permutation(len(usable))[: config.num_proposals])]
    moved = _moved(boxes[chosen], config.proposal_factor, rng, config)
    truths = moved.clone()
    on_object = is_object[chosen]
    truths[on_object] = scene.boxes[truth[chosen[on_object]]]
    return RegionExamples(moved, found.classes[chosen], truths, on_object)


def _moved(
    boxes: Float64[Tensor, "n 7"],
    factor: float,
    rng: np.random.Generator,
    config: RegionExamplesConfig,
) -> Float64[Tensor, "n 7"]:
    """Shift, resize and rotate boxes at random, some doubly, some backwards."""
    number = len(boxes)
    reach = factor * (1 + torch.from_numpy(rng.random(number) < config.doubled_share).double())
    is_reversed = torch.from_numpy(rng.random(number) < config.reversed_share)
    change = reach[:, None] * torch.from_numpy(rng.normal(size=(number, 7)))
    ground = (boxes[:, 3] * boxes[:, 4]).sqrt()
    across_m = (config.center_share * ground).clamp(min=config.least_center_m)
    deviation = torch.stack((across_m, across_m, config.height_share * boxes[:, 5]), dim=1)
    centers = boxes[:, :3] + change[:, :3] * deviation
    sizes = boxes[:, 3:6] * (change[:, 3:6] * boxes.new_tensor(config.log_sizes)).exp()
    yaw = boxes[:, 6] + config.yaw_rad * change[:, 6] + torch.where(is_reversed, math.pi, 0.0)
    return torch.cat((centers, sizes, wrap_angle(yaw)[:, None]), dim=1)


class RegionLosses(NamedTuple):
    """Scalar losses; the parts are unweighted."""

    total: Float[Tensor, ""]
    values: Float[Tensor, ""]
    corners: Float[Tensor, ""]
    front: Float[Tensor, ""]
    quality: Float[Tensor, ""]


def region_loss(
    output: RegionOutput,
    proposals: Float[Tensor, "num_regions 7"],
    truths: Float[Tensor, "num_regions 7"],
    is_object: Bool[Tensor, " num_regions"],
    config: RegionLossConfig,
) -> RegionLosses:
    """Compute the loss of regions: box changes of those on objects (mean), and qualities of all.

    The quality target is the IoU of the currently decoded box (soft label), and 0 without an
    object; it has no gradient for the boxes. Without objects, the other losses and their gradients
    are 0; without regions, all are.

    Boxes are x, y, z, length, width, height, yaw; `truths` has any values where there is no object.
    """
    values, proposed = output.values[is_object], proposals[is_object].to(output.values.dtype)
    truth = truths[is_object].to(values.dtype)
    kept = keeps_front(truth, proposed)
    changed = decode_regions(values, kept, proposed)
    error = F.smooth_l1_loss(
        values, encode_regions(truth, proposed), reduction="none", beta=config.knee
    )
    front = F.binary_cross_entropy_with_logits(
        output.front_logits[is_object], kept.to(values.dtype), reduction="sum"
    )
    quality = torch.zeros_like(output.quality_logits)
    with torch.no_grad():
        quality[is_object] = quality_from_iou(aligned_iou_3d(changed, truth))
    rated = F.binary_cross_entropy_with_logits(output.quality_logits, quality, reduction="sum")
    number = max(len(values), 1)
    corners = corner_costs(changed, truth, knee_m=config.corner_knee_m).sum() / number
    parts = (error.sum() / number, corners, front / number, rated / max(len(quality), 1))
    total = config.value_weight * parts[0] + config.corner_weight * parts[1]
    total = total + config.front_weight * parts[2] + config.quality_weight * parts[3]
    return RegionLosses(total, *parts)
