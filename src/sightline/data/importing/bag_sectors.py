"""Search for clouds of a bag that are parts of a turn, of which each image would get only one."""

from contextlib import suppress
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Bool, Float32

from sightline.data.importing.bag import Bag
from sightline.data.importing.bag_messages import cloud_from_message
from sightline.files.plain_text import shortened
from sightline.geometry.echoes import echoes

_NUM_CLOUDS: Final = 12  # consecutive clouds at the start of a drive
_MIN_CLOUDS: Final = 4
_MIN_POINTS: Final = 50  # points of a cloud that shows its sector
_NUM_SECTORS: Final = 72
_MAX_SHARED: Final = 0.4
"""Share of the sectors of a cloud that the next one shows again, below which it is a part."""


def describe_parts_of_turns(bag: Bag, topic: str) -> tuple[str, ...]:
    """Warn if the first clouds of a topic show different sectors one after the other.

    Drivers may publish a cloud for each packet or each tenth of a turn.

    Returns:
        One line, or none.
    """
    shown = []
    for message in bag.messages([topic], selected={(topic, at) for at in range(_NUM_CLOUDS)}):
        with suppress(ValueError):  # reported when frames are written
            points = echoes(cloud_from_message(message.content, topic))
            if len(points) >= _MIN_POINTS:
                shown.append(_sectors(points))
    if len(shown) < _MIN_CLOUDS:
        return ()
    shared = [
        np.count_nonzero(one & next_one) / np.count_nonzero(one)
        for one, next_one in pairwise(shown)
    ]
    if np.median(shared) > _MAX_SHARED:
        return ()
    width_deg = 360 / _NUM_SECTORS * float(np.median([np.count_nonzero(each) for each in shown]))
    return (
        f"warning: clouds of {shortened(topic)} show different sectors of {width_deg:.0f} degrees "
        "one after the other: they are parts of a turn, and each image gets one of them; let the "
        "driver publish whole turns, or join the clouds of a turn before the import",
    )


def _sectors(points: Float32[np.ndarray, "num_points 4"]) -> Bool[np.ndarray, " num_sectors"]:
    """Sectors around the LiDAR that hold points."""
    share = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5
    sectors = np.zeros(_NUM_SECTORS, bool)
    sectors[(share * _NUM_SECTORS).astype(int) % _NUM_SECTORS] = True
    return sectors
