"""Classes of KITTI that look like one that is detected."""

from collections.abc import Collection
from types import MappingProxyType
from typing import Final

LOOK_ALIKES: Final = MappingProxyType(
    {"Van": "Car", "Truck": "Car", "Person_sitting": "Pedestrian"}
)
"""What each may be taken for, so that detectors may be neither asked for it nor told it is none."""


def check_look_alikes(names: Collection[str]) -> None:
    """Refuses names of settings that are none of these.

    Raises:
        ValueError: There is one.
    """
    unknown = set(names) - set(LOOK_ALIKES)
    if unknown:
        raise ValueError(
            f"ignored_names may hold {', '.join(LOOK_ALIKES)}, got {', '.join(sorted(unknown))}"
        )
