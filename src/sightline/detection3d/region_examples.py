"""Training proposals of the compact second stage: moved ground truths, and background.

A first stage's proposals on its own training frames are better than elsewhere, so a second stage
trained on them alone learns to leave them unchanged. Randomly moved ground truths have errors of
any chosen size.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

from sightline.detection3d.classes import RoadUserClass
from sightline.detection3d.pillar_detections import FoundBoxes
from sightline.detection3d.targets import SweepTruth
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.transforms import wrap_angle, yaw_rotation
from sightline.ops.rotated_iou import pairwise_iou_bev


@dataclass(frozen=True, kw_only=True)
class RegionExamplesConfig:
    """Number of examples for each sweep, and their errors (standard deviations)."""

    num_objects: int = 24
    """Number of moved ground truths."""
    num_background: int = 8
    """Number of boxes without an object."""
    num_proposals: int = 8
    """Number of first-stage proposals, if there are any, on objects or background alike."""
    center_share: float = 0.07
    """Shift along x and along y, as a share of sqrt(length x width)."""
    least_center_m: float = 0.08
    """Smallest standard deviation of the shift along x and along y."""
    height_share: float = 0.065
    """Shift along z, as a share of the height."""
    log_sizes: tuple[float, float, float] = (0.06, 0.04, 0.05)
    """Changes of the logarithms of length, width and height."""
    yaw_rad: float = 0.06
    """Rotation."""
    doubled_share: float = 0.3
    """Share of boxes with doubled shift, size change and rotation."""
    reversed_share: float = 0.15
    """Share of boxes that are turned to face backwards."""
    proposal_factor: float = 0.5
    """Factor on these errors for first-stage proposals."""
    min_iou: float = 0.2
    """IoU from above with an object from which a first-stage proposal is matched to it."""
    max_background_iou: float = 0.02
    """Largest IoU from above of a background proposal with objects of its class and with those
    ignored for it."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        for name in ("num_objects", "num_background", "num_proposals"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        for name in ("center_share", "least_center_m", "height_share", "yaw_rad"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise ValueError(f"{name} must be finite and not negative, got {value}")
        if not all(0 <= each < math.inf for each in self.log_sizes):
            raise ValueError(f"log_sizes must be finite and not negative, got {self.log_sizes}")
        for name in ("doubled_share", "reversed_share", "proposal_factor"):
            value = getattr(self, name)
            if not 0 <= value <= 1:
                raise ValueError(f"{name} must be from 0 to 1, got {value}")
        if not 0 <= self.max_background_iou <= self.min_iou <= 1:
            raise ValueError(
                "max_background_iou and min_iou must rise from 0 to 1, got "
                f"{self.max_background_iou} and {self.min_iou}"
            )


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
    config: RegionExamplesConfig = RegionExamplesConfig(),
    *,
    found: FoundBoxes | None = None,
) -> RegionExamples:
    """Draw examples of a sweep: moved ground truths, then background, then first-stage proposals.

    A frame without objects gives no moved ground truths. Background is a box with a random class's
    mean sizes around a random point, away from all objects, also ignored ones; so there may be
    fewer than requested. Proposals are dropped if they neither match an object of their class nor
    are clear of all such objects and of those ignored for it; on an object of another class they
    are background.

    Args:
        scene: Ground truth of the sweep.
        points: LiDAR frame [m].
        classes: Classes of the stage.
        rng: Source of all randomness.
        config: Numbers and deviations.
        found: Detections of the first stage in the sweep.
    """
    parts = [
        _moved_truths(scene, rng, config),
        _background(scene, points, classes, rng, config),
    ]
    if found is not None:
        parts.append(_first_stage(scene, found, rng, config))
    return RegionExamples(*(torch.cat(column) for column in zip(*parts, strict=True)))


def _moved_truths(
    scene: SweepTruth, rng: np.random.Generator, config: RegionExamplesConfig
) -> RegionExamples:
    number = config.num_objects if len(scene.boxes) else 0
    chosen = torch.from_numpy(rng.integers(max(len(scene.boxes), 1), size=number))
    truths, classes = scene.boxes[chosen], scene.classes[chosen]
    is_object = torch.ones(number, dtype=torch.bool)
    return RegionExamples(_moved(truths, 1.0, rng, config), classes, truths, is_object)


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
    is_clear = _is_clear(boxes, scene)
    boxes = boxes[is_clear]
    return RegionExamples(boxes, kind[is_clear], boxes, torch.zeros(len(boxes), dtype=torch.bool))


def _first_stage(
    scene: SweepTruth, found: FoundBoxes, rng: np.random.Generator, config: RegionExamplesConfig
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


def _is_clear(
    boxes: Float64[Tensor, "num_boxes 7"], scene: SweepTruth
) -> Bool[Tensor, " num_boxes"]:
    taken = Boxes3D(torch.cat((scene.boxes, scene.ignored_boxes)))
    return (pairwise_iou_bev(Boxes3D(boxes).bev, taken.bev) == 0).all(dim=1)


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
