"""What the compact design shall find in a sweep, and where nothing shall be asked of it."""

from dataclasses import dataclass
from typing import Final

import torch
from beartype import beartype
from jaxtyping import Bool, Float, Float64, Int64, jaxtyped
from torch import Tensor

from sightline.detection3d.classes import RoadUserClass
from sightline.ops.points_in_boxes import first_box_of_points
from sightline.structures.labels import ObjectLabels

_NEIGHBOURS: Final = {"Van": "Car", "Truck": "Car", "Person_sitting": "Pedestrian"}
"""Classes that look like one of ours."""


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class SceneObjects:
    """The truth of one sweep; boxes are x, y, z, length, width, height, yaw, LiDAR frame."""

    boxes: Float64[Tensor, "num_objects 7"]
    class_indices: Int64[Tensor, " num_objects"]
    """Places among the classes that are looked for."""
    ignored_boxes: Float64[Tensor, "num_ignored 7"]
    """Where nothing is right or wrong."""
    ignored_classes: Bool[Tensor, "num_ignored num_classes"]
    """For which classes."""


@dataclass(frozen=True, kw_only=True)
class SceneObjectsConfig:
    """Which objects are to be found."""

    ignored_names: tuple[str, ...] = ("Van", "Truck", "Person_sitting")
    """KITTI's classes that are ignored for the one they look like."""
    min_points: int = 5
    """Objects with fewer points are ignored for their own class."""

    def __post_init__(self) -> None:
        """Checks the names and the number."""
        unknown = set(self.ignored_names) - set(_NEIGHBOURS)
        if unknown:
            raise ValueError(
                f"ignored_names may hold {', '.join(_NEIGHBOURS)}, got {', '.join(sorted(unknown))}"
            )
        if self.min_points < 0:
            raise ValueError(f"min_points must not be negative, got {self.min_points}")


def scene_objects(
    objects: ObjectLabels,
    points: Float[Tensor, "num_points fields"],
    classes: tuple[RoadUserClass, ...],
    config: SceneObjectsConfig = SceneObjectsConfig(),
) -> SceneObjects:
    """The truth that labels give for a sweep.

    An object with too few points is ignored for its own class, one that looks like a class of ours
    for that class, and what is not told from road users for all: a DontCare with a box. Labels
    without a 3D box tell nothing here, and other classes are nothing. A point in several boxes
    counts for the first.

    Args:
        objects: The labels.
        points: x, y, z first, LiDAR frame [m].
        classes: What is looked for.
        config: Which of them.

    Raises:
        ValueError: A point or a box is not finite.
    """
    boxes = objects.boxes3d.tensor.double()
    holder = first_box_of_points(points[None, :, :3], boxes[None])[0]
    num_points = torch.bincount(holder[holder >= 0], minlength=len(objects)).tolist()
    has_box = objects.has_box3d.tolist()
    names = [entry.name for entry in classes]
    found: list[int] = []
    ignored: list[int] = []
    of_classes: list[list[bool]] = []
    for index, name in enumerate(objects.class_names):
        like = _NEIGHBOURS[name] if name in config.ignored_names else name
        if not has_box[index]:
            continue
        if name in names and num_points[index] >= config.min_points:
            found.append(index)
        elif like in names or name == "DontCare":
            ignored.append(index)
            of_classes.append([name == "DontCare" or each == like for each in names])
    return SceneObjects(
        boxes=boxes[found],
        class_indices=torch.tensor(
            [names.index(objects.class_names[index]) for index in found], dtype=torch.int64
        ),
        ignored_boxes=boxes[ignored],
        ignored_classes=torch.tensor(of_classes, dtype=torch.bool).reshape(-1, len(names)),
    )
