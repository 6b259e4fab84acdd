"""Classes of road users for the 3D detectors."""

from dataclasses import dataclass
from typing import Final

from sightline.geometry.ranges import check_range

_SMALLEST_M, _LARGEST_M = 0.01, 100.0


@dataclass(frozen=True, kw_only=True)
class RoadUserClass:
    """Class of road users, with mean box size in KITTI's training split."""

    name: str
    """Name as in KITTI's labels."""
    mean_size_m: tuple[float, float, float]
    """Length, width, height."""

    def __post_init__(self) -> None:
        """Check the sizes."""
        for size_m in self.mean_size_m:
            check_range(f"mean_size_m of {self.name}", size_m, _SMALLEST_M, _LARGEST_M)


CAR: Final = RoadUserClass(name="Car", mean_size_m=(3.88, 1.63, 1.53))
PEDESTRIAN: Final = RoadUserClass(name="Pedestrian", mean_size_m=(0.84, 0.66, 1.76))
CYCLIST: Final = RoadUserClass(name="Cyclist", mean_size_m=(1.76, 0.60, 1.74))
