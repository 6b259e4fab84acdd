"""Named simulated data sets: the same name is the same bytes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

from sightline.data.object_tree import Velodyne
from sightline.simulation.simulator import SimulationConfig


@dataclass(frozen=True, kw_only=True, slots=True)
class Preset:
    """Arguments of `generate.simulate`."""

    frames: int
    validation_frames: int = 0
    """Of `frames`."""
    velodyne: Velodyne = "velodyne"
    config: SimulationConfig = field(default_factory=SimulationConfig)


PresetName = Literal["street-2k", "street-8k", "street-hard-500"]
PRESETS: Final[Mapping[PresetName, Preset]] = {
    # 2,000 frames to train on and 200 to validate, of the size of the depth benchmark's crop.
    "street-2k": Preset(
        frames=2200,
        validation_frames=200,
        velodyne="velodyne_reduced",
        config=SimulationConfig(seed=2000, image_size=(352, 1216)),
    ),
    # 8,000 frames to train on and 500 to validate, of the size of KITTI's object benchmark.
    "street-8k": Preset(
        frames=8500,
        validation_frames=500,
        velodyne="velodyne_reduced",
        config=SimulationConfig(seed=8000),
    ),
    # To validate on where street-8k's own validation frames are too easy to tell networks apart.
    "street-hard-500": Preset(
        frames=500,
        validation_frames=500,
        velodyne="velodyne_reduced",
        config=SimulationConfig(seed=500, hard=True),
    ),
}
