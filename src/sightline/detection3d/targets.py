"""What a detector shall find in a sweep, and where nothing shall be asked of it."""

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
    """The truth of one sweep; boxes are x, y, z, length, width, height, yaw, in its frame."""

    boxes: Float64[Tensor, "num_objects 7"]
    """What is to be found."""
    classes: Int64[Tensor, " num_objects"]
    """Places among the detector's classes."""
    ignored_boxes: Float64[Tensor, "num_ignored 7"]
    """Where nothing is right or wrong."""
    ignored_classes: Bool[Tensor, "num_ignored num_classes"]
    """For which classes."""

    def cpu(self) -> "SweepTruth":
        """The same where boxes are walked over one by one."""
        return SweepTruth(
            boxes=self.boxes.cpu(),
            classes=self.classes.cpu(),
            ignored_boxes=self.ignored_boxes.cpu(),
            ignored_classes=self.ignored_classes.cpu(),
        )


@dataclass(frozen=True, kw_only=True)
class TargetConfig:
    """Which objects are to be found; what else has a box is ignored or background."""

    ignored_names: tuple[str, ...] = ("Van", "Truck", "Person_sitting")
    """KITTI's classes that are ignored for the one they look like."""
    min_points: int = 1
    """Points of the sweep on an object that is to be found; others are ignored."""

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
    """The truth that labels give for a sweep.

    Objects of the detector's classes with enough points are to be found if their centre lies in the
    range that is seen; the rest of these are ignored for their own class, what looks like a class
    of ours for that class, and a DontCare with a 3D box for all. Labels without a 3D box tell
    nothing here, and other classes are background. A point in several boxes counts for the first,
    and one that was drawn several times counts once.

    Args:
        objects: In the frame of the labels.
        points: As the network gets them: x, y, z first [m].
        class_names: Of the detector's classes.
        sweep: What the network sees.
        config: What is ignored.

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
    """How many different points each box holds: a sparse sweep is filled up by repeating some."""
    holder = first_box_of_points(points[None, :, :3], boxes[None])[0]
    is_held = holder >= 0
    held = torch.cat((holder[is_held, None].to(points.dtype), points[is_held]), dim=1)
    return torch.bincount(torch.unique(held, dim=0)[:, 0].long(), minlength=len(boxes))
