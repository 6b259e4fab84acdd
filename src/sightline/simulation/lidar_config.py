"""Simulated LiDARs: their lasers and faults, and the models by name."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final, get_args

import numpy as np

from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.ranges import Within, check_ranges
from sightline.geometry.tilt import Tilt
from sightline.simulation.rigs import LidarModel, PointOrder, Rosette
from sightline.simulation.tables import read_table

KITTI_REACH_M: Final = 74.0
"""`LidarConfig.reach_m` of KITTI's LiDAR."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Laser:
    """One laser of a spinning LiDAR."""

    elevation_deg: float  # elevation of the beam
    offset_m: float = 0.0  # height above the sensor's origin where the beam crosses the axis
    range_bias_m: float = 0.0  # bias of all its ranges
    reading_bias: float = 0.0  # bias of its reflectance readings


@dataclass(frozen=True, kw_only=True, slots=True)
class BlindSector:
    """Sector in which the car that carries the sensor blocks the beams.

    Raises:
        ValueError: The azimuths do not rise within 0 to 360 degrees.
    """

    azimuth_deg: tuple[float, float]  # start and end, counter-clockwise; 0 is straight ahead
    below_deg: float  # elevation below which beams are lost

    def __post_init__(self) -> None:
        """Check the order of the azimuths."""
        start, end = self.azimuth_deg
        if not 0 <= start < end <= 360:
            raise ValueError(
                f"azimuth_deg of a blind sector must rise within 0 to 360, got {start} to {end}; "
                "divide one that lies across 0 in two"
            )


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarConfig:
    """A LiDAR and its faults."""

    lasers: tuple[Laser, ...]  # lasers from the top; none with a `rosette`
    rosette: Rosette | None = None
    azimuth_step_deg: float = 0.1728
    """Step between two firings of a laser; 0.1728 is a Velodyne at 10 turns a second."""
    azimuth_resolution_deg: Annotated[float, Within(0)] = 0.0
    """Step of the encoder in which lasers' azimuths are reported; 0: exact."""
    blind_sectors: tuple[BlindSector, ...] = ()
    height_m: float = KITTI_LIDAR_HEIGHT_M  # height of its origin above the road
    lean_deg: float = 0.0  # forward lean of its axis; points are nevertheless in a level frame
    tilt: Tilt | None = None  # tilt of its frame against the car; points are in this frame
    min_range_m: float = 1.5
    max_range_m: float = 80.0
    reach_m: Annotated[float, Within(1)] = KITTI_REACH_M
    """Range at which returns become rarer on any surface; fitted to the depths in KITTI's images.
    Readings fade in proportion to it."""
    range_noise_m: Annotated[float, Within(0)] = 0.01
    """Standard deviation along the ray, around the laser's bias."""
    drop_out: Annotated[float, Within(0, 1)] = 0.01  # share of returns lost on any surface
    detectable_echo: float = 0.006
    """Echo (reflectance * cosine / (range / 40 m)^2) with detection probability 1 - 1/e."""
    reading_scale: Annotated[float, Within(0)] = 1.0  # factor on the reflectance readings
    order: PointOrder = "rings"
    """Order of the points in a sweep."""
    rolling_shutter: bool = False
    """Motion of the sensor during its turn, which distorts the sweep as in reality."""

    def __post_init__(self) -> None:
        """Check the ranges, and that rings come from the top, as in KITTI's files."""
        elevations = [laser.elevation_deg for laser in self.lasers]
        if self.rosette is not None and elevations:
            raise ValueError("a LiDAR has lasers or a rosette, got both")
        if self.rosette is not None and self.rolling_shutter:
            raise ValueError("rolling_shutter needs a LiDAR that turns, got a rosette")
        falls = elevations == sorted(elevations, reverse=True)
        if self.rosette is None and not (elevations and falls):
            raise ValueError(
                f"a LiDAR needs lasers whose elevations fall from the top, got {elevations} degrees"
            )
        if not self.azimuth_step_deg > 0 or not 0 <= self.min_range_m < self.max_range_m:
            raise ValueError(
                "a LiDAR needs azimuth_step_deg above 0 and min_range_m below max_range_m, got "
                f"{self.azimuth_step_deg}, {self.min_range_m} and {self.max_range_m}"
            )
        check_ranges(self)
        if not self.detectable_echo > 0:
            raise ValueError(f"detectable_echo must be above 0, got {self.detectable_echo}")


def _lidar(row: Mapping[str, Any]) -> LidarConfig:
    """Build a LiDAR from its row of the table.

    `fans` are blocks of evenly spread lasers from the top: first and last elevation [degrees],
    number and offset [m]. Biases are those of the lasers from the top; `firings` are those of a
    laser in a turn; blind sectors are start, end and lower elevation [degrees].
    """
    beams = [
        (elevation, offset)
        for top, bottom, count, offset in row["fans"]
        for elevation in np.linspace(top, bottom, count).tolist()
    ]
    ranges_mm = row.get("range_biases_mm", (0,) * len(beams))
    percents = row.get("reading_biases_percent", (0,) * len(beams))
    return LidarConfig(
        lasers=tuple(
            Laser(
                elevation_deg=elevation,
                offset_m=offset,
                range_bias_m=range_mm / 1000,
                reading_bias=percent / 100,
            )
            for (elevation, offset), range_mm, percent in zip(
                beams, ranges_mm, percents, strict=True
            )
        ),
        azimuth_step_deg=360 / row["firings"],
        azimuth_resolution_deg=row.get("azimuth_resolution_deg", 0.0),
        lean_deg=row.get("lean_deg", 0.0),
        blind_sectors=tuple(
            BlindSector(azimuth_deg=(start, end), below_deg=below)
            for start, end, below in row.get("blind_sectors", ())
        ),
    )


# HDL-64E is KITTI's own sensor, measured in its sweeps: two blocks of lasers, the upper one denser,
# and the car's roof, rails and aerial below them. Its biases of range are those against planes
# through walls, where the lower lasers read too little; those of readings against the lasers above
# and below on the same surface. Its azimuths come in steps of 0.09 degrees: neighbours in KITTI's
# rings are 0.18 or, one in seven, 0.09 degrees apart.
_ROWS: Final = read_table(__file__, "lidars")
LIDARS: Final[Mapping[LidarModel, LidarConfig]] = {
    model: _lidar(_ROWS[model]) for model in get_args(LidarModel)
}
