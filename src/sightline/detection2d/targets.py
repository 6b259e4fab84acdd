"""What a detector shall find in an image, and where nothing shall be asked of it."""

from dataclasses import dataclass

import torch
from beartype import beartype
from jaxtyping import Bool, Float, Float32, Int64, jaxtyped
from torch import Tensor

from sightline.detection2d.config import CLASSES, check_range
from sightline.structures.labels import ObjectLabels
from sightline.structures.look_alikes import LOOK_ALIKES, check_look_alikes


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class DetectionTargets:
    """The truth of one image, in pixels of the network's input; boxes are corners."""

    boxes: Float32[Tensor, "num_objects 4"]
    class_indices: Int64[Tensor, " num_objects"]
    """In `CLASSES`."""
    ignored_boxes: Float32[Tensor, "num_ignored 4"]
    """Regions where nothing is right or wrong."""
    ignored_classes: Bool[Tensor, "num_ignored classes"]
    """For which classes."""


@dataclass(frozen=True, kw_only=True)
class TargetConfig:
    """Which objects are to be found; the others are ignored, DontCare always."""

    ignored_names: tuple[str, ...] = ("Van", "Truck", "Person_sitting")
    """KITTI's classes that are ignored for the one they look like."""
    min_height_px: float = 0.0
    """Of an object in the network's input."""
    min_width_px: float = 0.0
    """Of an object in the network's input."""
    max_truncation: float = 0.75
    """Share of an object outside the image, that which a crop cuts off included."""
    max_occlusion: int = 3
    """KITTI's: 0 visible, 1 partly, 2 largely occluded, 3 unknown."""

    def __post_init__(self) -> None:
        """Checks the names and ranges."""
        check_look_alikes(self.ignored_names)
        for name in ("min_height_px", "min_width_px"):
            check_range(f"targets.{name}", getattr(self, name), 0, 10_000)
        check_range("targets.max_truncation", self.max_truncation, 0, 1)
        check_range("targets.max_occlusion", self.max_occlusion, 0, 3)


def make_targets(objects: ObjectLabels, config: TargetConfig) -> DetectionTargets:
    """The truth that labels give, which are in pixels of the network's input already.

    What is too small, too truncated or too much occluded is ignored for its own class, a class that
    looks like one of ours for that one, and a DontCare region for all. Other objects are nothing.
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
    wanted: list[int] = []
    of_classes: list[list[bool]] = []
    for index, name in enumerate(objects.class_names):
        like = LOOK_ALIKES[name] if name in config.ignored_names else name
        if name in CLASSES and is_clear[index]:
            found.append(index)
            wanted.append(CLASSES.index(name))
        elif like in CLASSES or name == "DontCare":
            ignored.append(index)
            of_classes.append([name == "DontCare" or each == like for each in CLASSES])
    return DetectionTargets(
        boxes=boxes[found],
        class_indices=torch.tensor(wanted, dtype=torch.int64),
        ignored_boxes=boxes[ignored],
        ignored_classes=torch.tensor(of_classes, dtype=torch.bool).reshape(-1, len(CLASSES)),
    )


def covered_shares(
    boxes: Float[Tensor, "num_boxes 4"], regions: Float[Tensor, "num_regions 4"]
) -> Float[Tensor, "num_boxes num_regions"]:
    """Share of each box's area that lies within each region."""
    low = torch.maximum(boxes[:, None, :2], regions[None, :, :2])
    high = torch.minimum(boxes[:, None, 2:], regions[None, :, 2:])
    area = (boxes[:, 2:] - boxes[:, :2]).clamp(min=0).prod(dim=1)
    return (high - low).clamp(min=0).prod(dim=2) / area.clamp(min=1e-9)[:, None]
