"""Ground truth of a sweep: objects to detect, and ignored areas."""

from dataclasses import dataclass

import torch
from beartype import beartype
from jaxtyping import Bool, Float, Float64, Int64, jaxtyped
from torch import Tensor

from sightline.detection3d.detector_config import SweepConfig
from sightline.ops.points_in_boxes import first_box_of_points
from sightline.structures.labels import ObjectLabels
from sightline.structures.look_alikes import LOOK_ALIKES, check_look_alikes


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class SweepTruth:
    """Ground truth of one sweep; boxes are x, y, z, length, width, height, yaw, in its frame."""

    boxes: Float64[Tensor, "num_objects 7"]
    """Boxes of the objects to detect."""
    classes: Int64[Tensor, " num_objects"]
    """Indices into the detector's classes."""
    ignored_boxes: Float64[Tensor, "num_ignored 7"]
    """Boxes of areas without a loss."""
    ignored_classes: Bool[Tensor, "num_ignored num_classes"]
    """Classes for which each area is ignored."""

    def cpu(self) -> "SweepTruth":
        """Copy to the CPU, for loops over single boxes."""
        return SweepTruth(
            boxes=self.boxes.cpu(),
            classes=self.classes.cpu(),
            ignored_boxes=self.ignored_boxes.cpu(),
            ignored_classes=self.ignored_classes.cpu(),
        )


@dataclass(frozen=True, kw_only=True)
class TargetConfig:
    """Selection of objects to detect; other boxes are ignored or background."""

    ignored_names: tuple[str, ...] = ("Van", "Truck", "Person_sitting")
    """KITTI's classes that are ignored for the class that they resemble."""
    min_points: int = 1
    """Smallest number of points on an object to detect; others are ignored."""

    def __post_init__(self) -> None:
        """Checks the names and the number."""
        check_look_alikes(self.ignored_names)
        if self.min_points < 0:
            raise ValueError(f"min_points must not be negative, got {self.min_points}")


def make_truth(
    objects: ObjectLabels,
    points: Float[Tensor, "num_points fields"],
    class_names: tuple[str, ...],
    sweep: SweepConfig,
    config: TargetConfig = TargetConfig(),
) -> SweepTruth:
    """Make the ground truth of a sweep from labels.

    Objects of the detector's classes with enough points are targets if their centre lies in the
    network's range. Other objects of these classes are ignored for their own class, those of
    similar classes for the class that they resemble, and a DontCare with a 3D box for all classes.
    Labels without a 3D box have no effect, and other classes are background. A point in several
    boxes counts for the first, and a point that was drawn several times counts once.

    Args:
        objects: Labels in their own frame.
        points: The network's input: x, y, z first [m].
        class_names: Names of the detector's classes.
        sweep: The network's range.
        config: Rules for ignored objects.

    Raises:
        ValueError: A point or a box is not finite.
    """
    offset = torch.tensor([0, 0, sweep.height_offset_m, 0, 0, 0, 0], dtype=torch.float64)
    boxes = objects.boxes3d.tensor.double() + offset
    low, high = (boxes.new_tensor(corner) for corner in (sweep.lowest_m, sweep.highest_m))
    is_seen = ((boxes[:, :3] >= low) & (boxes[:, :3] <= high)).all(dim=1)
    inside = _points_inside(points, boxes)
    is_clear = (is_seen & (inside >= config.min_points)).tolist()
    found: list[int] = []
    ignored: list[int] = []
    of_classes: list[list[bool]] = []
    for index in objects.has_box3d.nonzero()[:, 0].tolist():
        name = objects.class_names[index]
        like = LOOK_ALIKES[name] if name in config.ignored_names else name
        if name in class_names and is_clear[index]:
            found.append(index)
        elif like in class_names or name == "DontCare":
            ignored.append(index)
            of_classes.append([name == "DontCare" or each == like for each in class_names])
    classes = [class_names.index(objects.class_names[index]) for index in found]
    return SweepTruth(
        boxes=boxes[found],
        classes=torch.tensor(classes, dtype=torch.int64),
        ignored_boxes=boxes[ignored],
        ignored_classes=torch.tensor(of_classes, dtype=torch.bool).reshape(-1, len(class_names)),
    )


def _points_inside(
    points: Float[Tensor, "num_points fields"], boxes: Float64[Tensor, "num_boxes 7"]
) -> Int64[Tensor, " num_boxes"]:
    """Count the different points in each box: sparse sweeps repeat some points."""
    holder = first_box_of_points(points[None, :, :3], boxes[None])[0]
    is_held = holder >= 0
    held = torch.cat((holder[is_held, None].to(points.dtype), points[is_held]), dim=1)
    return torch.bincount(torch.unique(held, dim=0)[:, 0].long(), minlength=len(boxes))
