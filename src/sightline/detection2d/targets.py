"""Ground truth of an image, and batches for the 2D detectors."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import ClassVar

import torch
from beartype import beartype
from jaxtyping import Bool, Float, Float32, Int64, jaxtyped
from torch import Tensor

from sightline.data.formats.kitti_labels import KittiObjects
from sightline.detection2d.config import CLASSES
from sightline.detection2d.placement import Placement
from sightline.geometry.ranges import check_range
from sightline.structures.batch import FieldwiseBatch
from sightline.structures.labels import LOOK_ALIKES, ObjectLabels, check_look_alikes


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class DetectionTargets:
    """Ground truth of one image, in pixels of the network's input; boxes are corners."""

    boxes: Float32[Tensor, "num_objects 4"]
    class_indices: Int64[Tensor, " num_objects"]
    """Indices into `CLASSES`."""
    ignored_boxes: Float32[Tensor, "num_ignored 4"]
    """Regions without a loss."""
    ignored_classes: Bool[Tensor, "num_ignored classes"]
    """Classes for which each region is ignored."""


@dataclass(frozen=True, kw_only=True)
class TargetConfig:
    """Selection of objects to detect; the others are ignored, DontCare always."""

    ignored_names: tuple[str, ...] = ("Van", "Truck", "Person_sitting")
    """KITTI's classes that are ignored for the class that they resemble."""
    min_height_px: float = 0.0
    """Smallest height of an object in the network's input."""
    min_width_px: float = 0.0
    """Smallest width of an object in the network's input."""
    max_truncation: float = 0.75
    """Largest share of an object outside the image, including the part that a crop cuts off."""
    max_occlusion: int = 3
    """Largest KITTI occlusion: 0 visible, 1 partly, 2 largely occluded, 3 unknown."""

    def __post_init__(self) -> None:
        """Check the names and ranges."""
        check_look_alikes(self.ignored_names)
        for name in ("min_height_px", "min_width_px"):
            check_range(f"targets.{name}", getattr(self, name), 0, 10_000)
        check_range("targets.max_truncation", self.max_truncation, 0, 1)
        check_range("targets.max_occlusion", self.max_occlusion, 0, 3)


def make_targets(objects: ObjectLabels, config: TargetConfig) -> DetectionTargets:
    """Make the ground truth from labels in pixels of the network's input.

    Objects that are too small, truncated or occluded are ignored for their own class, objects of a
    similar class for the class that they resemble, and DontCare regions for all classes. Other
    objects have no effect.
    """
    boxes = objects.boxes2d.tensor.float()
    width, height = (boxes[:, 2:] - boxes[:, :2]).unbind(dim=1)
    is_clear = (
        (height >= config.min_height_px)
        & (width >= config.min_width_px)
        & (objects.truncation <= config.max_truncation)
        & (objects.occlusion <= config.max_occlusion)
        & (width > 0)
        & (height > 0)
    ).tolist()
    found: list[int] = []
    ignored: list[int] = []
    class_indices: list[int] = []
    ignored_classes: list[list[bool]] = []
    for index, name in enumerate(objects.class_names):
        like = LOOK_ALIKES[name] if name in config.ignored_names else name
        if name in CLASSES and is_clear[index]:
            found.append(index)
            class_indices.append(CLASSES.index(name))
        elif like in CLASSES or name == "DontCare":
            ignored.append(index)
            ignored_classes.append([name == "DontCare" or each == like for each in CLASSES])
    return DetectionTargets(
        boxes=boxes[found],
        class_indices=torch.tensor(class_indices, dtype=torch.int64),
        ignored_boxes=boxes[ignored],
        ignored_classes=torch.tensor(ignored_classes, dtype=torch.bool).reshape(-1, len(CLASSES)),
    )


def covered_shares(
    boxes: Float[Tensor, "num_boxes 4"], regions: Float[Tensor, "num_regions 4"]
) -> Float[Tensor, "num_boxes num_regions"]:
    """Compute the share of each box's area within each region."""
    low = torch.maximum(boxes[:, None, :2], regions[None, :, :2])
    high = torch.minimum(boxes[:, None, 2:], regions[None, :, 2:])
    area = (boxes[:, 2:] - boxes[:, :2]).clamp(min=0).prod(dim=1)
    return (high - low).clamp(min=0).prod(dim=2) / area.clamp(min=1e-9)[:, None]


@dataclass(frozen=True, kw_only=True, slots=True)
class FrameTruth:
    """Ground truth for scoring a frame."""

    placement: Placement
    objects: KittiObjects
    """Objects in the frame's own pixels."""


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class DetectionBatch(FieldwiseBatch):
    """Samples of one size. A missing sensor is an image of zeros."""

    nan_fields: ClassVar[Collection[str]] = ("camera_health", "lidar_health")
    sample_ids: tuple[str, ...]
    image: Float32[Tensor, "batch 3 height width"]
    """RGB in [0, 1]."""
    lidar: Float32[Tensor, "batch 3 height width"]
    """Depth, height and intensity in [0, 1] at points, else 0."""
    targets: tuple[DetectionTargets, ...]
    camera_health: Float32[Tensor, "batch 1 rows columns"] | None = None
    """Share of each cell's pixels with a working camera, to train gates: 1 except for simulated
    faults. NaN: unknown."""
    lidar_health: Float32[Tensor, "batch 1 rows columns"] | None = None
    """Share of each cell's points with a working LiDAR; NaN in cells without points in the intact
    sweep."""
    frames: tuple[FrameTruth, ...] | None = None
    """Ground truth for scoring."""
