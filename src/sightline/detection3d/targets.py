"""What a detector shall find in a sweep, and where nothing shall be asked of it."""

from dataclasses import dataclass
from typing import Final

import torch
from beartype import beartype
from jaxtyping import Float, Float32, Int64, jaxtyped
from torch import Tensor

from sightline.detection3d.detector_config import SweepConfig
from sightline.detection3d.foreground import IGNORED
from sightline.geometry.boxes3d import Boxes3D
from sightline.ops.points_in_boxes import first_box_of_points
from sightline.structures.labels import ObjectLabels

_NEIGHBOURS: Final = {"Van": "Car", "Truck": "Car", "Person_sitting": "Pedestrian"}
"""Classes that look like one of ours."""


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class SweepTruth:
    """The truth of one sweep."""

    boxes: Float32[Tensor, "num_objects 7"]
    """x, y, z, length, width, height, yaw, in the frame of the network's points."""
    classes: Int64[Tensor, " num_objects"]
    """Places among the detector's classes, or `IGNORED`."""

    @property
    def is_wanted(self) -> Tensor:
        """Which objects are to be found."""
        return self.classes >= 0


@dataclass(frozen=True, kw_only=True)
class TargetConfig:
    """Which objects are to be found; what else has a box is ignored or background."""

    ignored_names: tuple[str, ...] = ("Van", "Truck", "Person_sitting")
    """KITTI's classes that are ignored, as they look like one of ours."""
    min_points: int = 1
    """Points of the sweep on an object that is to be found; others are ignored."""

    def __post_init__(self) -> None:
        """Checks the names and the number."""
        unknown = set(self.ignored_names) - set(_NEIGHBOURS)
        if unknown:
            raise ValueError(
                f"ignored_names may hold {', '.join(_NEIGHBOURS)}, got {', '.join(sorted(unknown))}"
            )
        if self.min_points < 0:
            raise ValueError(f"min_points must not be negative, got {self.min_points}")


def make_truth(
    objects: ObjectLabels,
    points: Float[Tensor, "num_points 4"],
    class_names: tuple[str, ...],
    sweep: SweepConfig,
    config: TargetConfig,
) -> SweepTruth:
    """The truth that labels give for a sweep.

    Objects of the detector's classes with enough points are to be found if their centre lies in the
    range that is seen; the rest of these, and classes that look like one, are ignored. Other
    objects are background, like all that has no 3D box.

    Args:
        objects: In the frame of the labels.
        points: As the network gets them, but for repetitions.
        class_names: Of the detector's classes.
        sweep: What the network sees.
        config: What is ignored.
    """
    ours = [name in class_names for name in objects.class_names]
    like = [
        name in config.ignored_names and _NEIGHBOURS[name] in class_names
        for name in objects.class_names
    ]
    is_ours, is_like = (torch.tensor(each, dtype=torch.bool) for each in (ours, like))
    kept = objects.has_box3d & (is_ours | is_like)
    boxes = objects.boxes3d.tensor[kept].float()
    boxes[:, 2] += sweep.height_offset_m
    numbers = [
        class_names.index(name) if name in class_names else IGNORED
        for name, taken in zip(objects.class_names, kept.tolist(), strict=True)
        if taken
    ]
    box = first_box_of_points(points[None, :, :3], boxes[None])[0]
    inside = torch.bincount(box[box >= 0], minlength=len(boxes))
    low, high = (boxes.new_tensor(corner) for corner in (sweep.lowest_m, sweep.highest_m))
    centers = Boxes3D(boxes).centers
    is_seen = ((centers >= low) & (centers <= high)).all(dim=1) & (inside >= config.min_points)
    classes = torch.tensor(numbers, dtype=torch.int64)
    return SweepTruth(boxes=boxes, classes=torch.where(is_seen, classes, IGNORED))
