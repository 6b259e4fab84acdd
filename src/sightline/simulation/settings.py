"""Settings of a simulation; heavy imports are avoided for a fast command line."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final, Literal

from sightline.data.layouts.kitti_trees import Velodyne
from sightline.geometry.choices import check_choices
from sightline.geometry.wrong_types import named_fields
from sightline.simulation.rigs import (
    DRAWN,
    MAX_SIDE_PX,
    MIN_SIDE_PX,
    RIG_NAMES,
    Drawn,
    LidarModel,
    Rig,
)

KITTI_IMAGE_SIZE: Final = (375, 1242)
"""Height and width [px]."""
KITTI_FOCAL_PX: Final = 721.5377
_MAX_SEQUENCE_LENGTH = 10_000  # a quarter of an hour, as long as any of KITTI's drives
_MIN_FOCAL_PX, _MAX_FOCAL_PX = 1.0, 1e5


@named_fields
@dataclass(frozen=True, kw_only=True, slots=True)
class SimulationConfig:
    """Settings of a simulation except the number of frames; the fields are `simulate`'s options."""

    seed: int = 0
    """Another seed gives other streets."""
    sequence_length: int = 1
    """Frames of a drive at 10 Hz, in KITTI's raw layout; 1 = each frame is another street, in the
    object layout."""
    image_size: tuple[int, int] = KITTI_IMAGE_SIZE
    """Height, width [px]. Relative to KITTI's size, the image is cropped or extended at its top and
    both sides."""
    focal_px: float = KITTI_FOCAL_PX
    """Focal length. It scales the image before cropping: half of KITTI's shows the same view in
    half the pixels."""
    samples_per_pixel: Literal[1, 4] = 1
    """Rays for each pixel: 1, or 4 for finer pictures."""
    lidar: LidarModel = "hdl-64e"
    """Model of the LiDAR."""
    rolling_shutter: bool = False
    """Whether the LiDAR moves with the car during its turn."""
    camera: bool = True
    """Whether images are rendered; without them all other output is unchanged, in half the time."""
    rig: Rig | Drawn | None = None
    """Another rig than KITTI's: its name, a YAML file, random for another rig in each frame, or
    named for the named ones in turn. It replaces image_size, focal_px and lidar."""
    hard: bool = False
    """Whether streets are hard: objects far away, hidden and on slopes, with few points."""
    hard_negatives: bool = False
    """Whether many objects beside streets are easily mistaken for a person or a car: beacons of
    road works, masts, low signs, bare trunks, bushes, heaps."""
    varied: bool = False
    """Whether streets are as varied as other rigs than KITTI's meet them: tall houses, glass
    fronts, rows of bicycles, bicycle traffic, buses, motorcycles, people sitting, wide junctions,
    wet roads, dusk."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, got {self.seed}")
        if not 1 <= self.sequence_length <= _MAX_SEQUENCE_LENGTH:
            raise ValueError(
                f"sequence_length must be between 1 and {_MAX_SEQUENCE_LENGTH}, got "
                f"{self.sequence_length}"
            )
        if not MIN_SIDE_PX <= min(self.image_size) <= max(self.image_size) <= MAX_SIDE_PX:
            height, width = self.image_size
            raise ValueError(
                f"the image must have {MIN_SIDE_PX} to {MAX_SIDE_PX} pixels along each side, got "
                f"{width} x {height} (width x height)"
            )
        check_choices(self)
        if not _MIN_FOCAL_PX <= self.focal_px <= _MAX_FOCAL_PX:
            raise ValueError(
                f"focal_px must be between {_MIN_FOCAL_PX:g} and {_MAX_FOCAL_PX:g}, got "
                f"{self.focal_px:g}"
            )
        if not self.camera and self.samples_per_pixel != 1:
            raise ValueError("samples_per_pixel has no effect without the camera; leave it out")
        self._check_rig()

    def _check_rig(self) -> None:
        """Check the rig against the other settings."""
        if self.rig is None:
            return
        if not isinstance(self.rig, Rig) and self.rig not in DRAWN:
            raise ValueError(
                f"rig must be a Rig or one of {', '.join(DRAWN)}, got {self.rig!r}; "
                "rigs.choose_rig finds a name or reads a file"
            )
        own = ("image_size", "focal_px", "lidar")
        given = [
            each.name
            for each in fields(self)
            if each.name in own and getattr(self, each.name) != each.default
        ]
        if given:
            raise ValueError(f"a rig has its own {given[0]}; leave out {given[0]} or the rig")
        if self.sequence_length > 1 and not isinstance(self.rig, Rig):
            raise ValueError(
                f"a drive has one rig for all frames, got {self.rig!r} rigs; name one, or make "
                "single frames with a sequence_length of 1"
            )


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


PresetName = Literal[
    "street-2k",
    "street-8k",
    "street-hard-500",
    "street-negatives-4k",
    "street-rigs-8k",
    "rigs-val-600",
]
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
    # 8,000 frames for training and 500 for validation, each with another random rig in another kind
    # of street; whole turns.
    "street-rigs-8k": SimulatedSet(
        frames=8500,
        validation_frames=500,
        config=SimulationConfig(seed=38000, rig="random", varied=True),
    ),
    # 50 frames of each of the named rigs, in turn: frame N has rig N modulo their number.
    "rigs-val-600": SimulatedSet(
        frames=50 * len(RIG_NAMES),
        validation_frames=50 * len(RIG_NAMES),
        config=SimulationConfig(seed=38600, rig="named", varied=True),
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
