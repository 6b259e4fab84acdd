"""Simulated data sets, some of them named presets: the same name gives the same bytes."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final, Literal

from sightline.data.object_tree import Velodyne
from sightline.simulation.settings import SimulationConfig


@dataclass(frozen=True, kw_only=True, slots=True)
class SimulatedSet:
    """Settings of a data set; its fields, and those of `config`, are options of `simulate`."""

    frames: int = 100
    """Number of frames, over all drives."""
    validation_frames: int = 0
    """Number of frames, the first ones, that go to ImageSets/val.txt instead of train.txt."""
    velodyne: Velodyne = "velodyne"
    """Folder of the sweeps: velodyne for whole turns of the LiDAR, velodyne_reduced for only the
    points in the camera's view."""
    config: SimulationConfig = field(default_factory=SimulationConfig)


PresetName = Literal["street-2k", "street-8k", "street-hard-500", "street-negatives-4k"]
PRESETS: Final[Mapping[PresetName, SimulatedSet]] = {
    # 2,000 frames for training and 200 for validation, of the size of the depth benchmark's crop.
    "street-2k": SimulatedSet(
        frames=2200,
        validation_frames=200,
        velodyne="velodyne_reduced",
        config=SimulationConfig(seed=2000, image_size=(352, 1216)),
    ),
    # 8,000 frames for training and 500 for validation, of the size of KITTI's object benchmark.
    "street-8k": SimulatedSet(
        frames=8500,
        validation_frames=500,
        velodyne="velodyne_reduced",
        config=SimulationConfig(seed=8000),
    ),
    # For validation where street-8k's validation frames are too easy to distinguish networks.
    "street-hard-500": SimulatedSet(
        frames=500,
        validation_frames=500,
        velodyne="velodyne_reduced",
        config=SimulationConfig(seed=500, hard=True),
    ),
    # 4,000 frames for training detectors and 500 for validation, with many hard negatives.
    "street-negatives-4k": SimulatedSet(
        frames=4500,
        validation_frames=500,
        velodyne="velodyne_reduced",
        config=SimulationConfig(seed=4000, hard_negatives=True),
    ),
}


def choose_set(preset: PresetName | None, given: Mapping[str, Any]) -> SimulatedSet:
    """Take a preset, or the defaults, and replace the settings that are given by name.

    Raises:
        ValueError: The settings are invalid.
    """
    base = SimulatedSet() if preset is None else PRESETS[preset]
    of_config = {each.name for each in fields(SimulationConfig)} & given.keys()
    config = replace(base.config, **{name: given[name] for name in of_config})
    return replace(base, config=config, **{name: given[name] for name in given.keys() - of_config})
