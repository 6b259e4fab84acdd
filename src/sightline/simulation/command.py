"""`sightline simulate`, with plain arguments."""

from pathlib import Path
from typing import Final, TypeVar

from sightline.data.object_tree import Velodyne
from sightline.simulation.generate import simulate
from sightline.simulation.lidar import LidarModel
from sightline.simulation.presets import PRESETS, Preset, PresetName
from sightline.simulation.simulator import SimulationConfig

_FRAMES: Final = 100

Value = TypeVar("Value")


def run_simulation(
    out: Path,
    *,
    frames: int | None = None,
    seed: int | None = None,
    workers: int = 2,
    sequence_length: int | None = None,
    image_size: tuple[int, int] | None = None,
    focal_px: float | None = None,
    samples_per_pixel: int | None = None,
    lidar: LidarModel | None = None,
    rolling_shutter: bool | None = None,
    camera: bool | None = None,
    hard: bool | None = None,
    velodyne: Velodyne | None = None,
    validation_frames: int | None = None,
    preset: PresetName | None = None,
) -> str:
    """Makes a simulated data set, or finishes or extends one; see `generate.simulate`.

    What is None is the preset's, or the default's. `image_size` is width and height, as KITTI's
    users write it; everywhere else in this project it is height and width.

    Returns:
        What was done, for a person.

    Raises:
        ValueError: The arguments make no sense, or as `generate.simulate` says.
    """
    base = Preset(frames=_FRAMES) if preset is None else PRESETS[preset]
    default = base.config
    config = SimulationConfig(
        seed=_given(seed, default.seed),
        sequence_length=_given(sequence_length, default.sequence_length),
        image_size=default.image_size if image_size is None else (image_size[1], image_size[0]),
        focal_px=_given(focal_px, default.focal_px),
        samples_per_pixel=_given(samples_per_pixel, default.samples_per_pixel),
        lidar=_given(lidar, default.lidar),
        rolling_shutter=_given(rolling_shutter, default.rolling_shutter),
        camera=_given(camera, default.camera),
        hard=_given(hard, default.hard),
    )
    result = simulate(
        out,
        frames=_given(frames, base.frames),
        config=config,
        workers=workers,
        velodyne=_given(velodyne, base.velodyne),
        validation_frames=_given(validation_frames, base.validation_frames),
    )
    return f"{out}: {result.written} frames simulated, {result.skipped} were there already"


def _given(value: Value | None, default: Value) -> Value:
    return default if value is None else value
