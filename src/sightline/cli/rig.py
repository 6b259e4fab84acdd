"""Rig of a recording on the command line: its field of 3D detection, its distance from training."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final, Literal

from sightline.cli.output import warn
from sightline.data.kitti_trees import Velodyne

Around = Literal["auto", "yes", "no"]
"""Field of 3D detection: the LiDAR's whole turn, the camera's view, or as the data say (auto)."""
_CHOICES: Final[dict[str, bool | None]] = {"auto": None, "yes": True, "no": False}


def chosen_field(around: Around) -> bool | None:
    """Convert the choice for the jobs; None: as the samples say."""
    return _CHOICES[around]


def warn_of_rig(
    data: Path,
    weights: Iterable[str],
    *,
    sample_list: str | Path | Sequence[str] | None = None,
    velodyne: Velodyne | None = None,
) -> None:
    """Print how far the rig lies from training, if it does; see `rig_distance`."""
    from sightline.inference.rig_distance import rig_distance

    distance = rig_distance(data, weights, sample_list=sample_list, velodyne=velodyne)
    if distance is not None:
        warn(str(distance))
