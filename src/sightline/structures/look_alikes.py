"""Classes of KITTI that look like a detected class."""

from collections.abc import Collection
from types import MappingProxyType
from typing import Final

LOOK_ALIKES: Final = MappingProxyType(
    {"Van": "Car", "Truck": "Car", "Person_sitting": "Pedestrian"}
)
"""Detected class of each look-alike; training can ignore look-alikes of a class."""


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
