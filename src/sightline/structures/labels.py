"""Object labels of a frame, and classes of KITTI that look like a detected class."""

from collections.abc import Collection
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from jaxtyping import Bool, Float64, Int64
from torch import Tensor

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.checked import checked
from sightline.geometry.given_arrays import Rows, selected_rows

LOOK_ALIKES: Final = MappingProxyType(
    {"Van": "Car", "Truck": "Car", "Person_sitting": "Pedestrian"}
)
"""Detected class of each look-alike; training can ignore look-alikes of a class."""


@checked()
@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectLabels:
    """The labelled objects of one frame, in the order of the label file.

    Examples:
        >>> import sightline, torch
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> labels = sightline.open_dataset(PACKAGED_FRAMES)[0].objects
        >>> cars = labels.select(torch.tensor([name == "Car" for name in labels.class_names]))
        >>> len(cars) == labels.class_names.count("Car")
        True
    """

    class_names: tuple[str, ...]
    """KITTI's class names, e.g. Car, Pedestrian, DontCare."""
    boxes2d: Boxes2D
    """Boxes in the image of camera 2."""
    boxes3d: Boxes3D
    """Boxes in the LiDAR frame; zeros for objects without a 3D part, such as DontCare."""
    truncation: Float64[Tensor, " num_objects"]
    """Share outside the image, 0 to 1; -1: unknown."""
    occlusion: Int64[Tensor, " num_objects"]
    """0 visible, 1 partly, 2 largely occluded, 3 unknown; -1 for DontCare."""
    alpha: Float64[Tensor, " num_objects"]
    """KITTI's observation angle [rad]: rotation_y minus the bearing; -10: unknown."""

    def __post_init__(self) -> None:
        """Check that the columns have equal lengths."""
        lengths = {
            "class_names": len(self.class_names),
            "boxes2d": len(self.boxes2d),
            "boxes3d": len(self.boxes3d),
            "truncation": len(self.truncation),
        }
        if len(set(lengths.values())) > 1:
            raise ValueError(f"labels of one frame need columns of one length, got {lengths}")

    def __len__(self) -> int:
        """Number of objects."""
        return len(self.class_names)

    @property
    def has_box3d(self) -> Bool[Tensor, " num_objects"]:
        """Mask of the objects with a 3D part."""
        return (self.boxes3d.sizes > 0).all(dim=-1)

    def select(self, kept: Rows) -> "ObjectLabels":
        """Select objects by indices, in their order, or by a mask."""
        kept = selected_rows(kept, len(self))
        return ObjectLabels(
            class_names=tuple(self.class_names[index] for index in kept.tolist()),
            boxes2d=self.boxes2d[kept],
            boxes3d=self.boxes3d[kept],
            truncation=self.truncation[kept],
            occlusion=self.occlusion[kept],
            alpha=self.alpha[kept],
        )


def check_look_alikes(names: Collection[str]) -> None:
    """Refuse names in settings that are no look-alikes.

    Raises:
        ValueError: A name is no look-alike.
    """
    unknown = set(names) - set(LOOK_ALIKES)
    if unknown:
        raise ValueError(
            f"ignored_names may hold {', '.join(LOOK_ALIKES)}, got {', '.join(sorted(unknown))}"
        )
