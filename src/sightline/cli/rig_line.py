"""Line of the commands on a recording's distance from the networks' training."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from sightline.cli.output import warn
from sightline.data.kitti_trees import Velodyne


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
