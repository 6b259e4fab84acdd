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


PresetName = Literal["street-2k"]
PRESETS: Final[Mapping[PresetName, Preset]] = {
    # 2,000 frames to train on and 200 to validate, of the size of the depth benchmark's crop.
    "street-2k": Preset(
        frames=2200,
        validation_frames=200,
        velodyne="velodyne_reduced",
        config=SimulationConfig(seed=2000, image_size=(352, 1216)),
    ),
}
