"""All kinds of corruption at five severities; levels are tabulated in the sensors' own units."""

import difflib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from sightline.corruptions.blank import CameraFramesLost, LidarFramesLost
from sightline.corruptions.camera_precipitation import CameraRain, CameraSnow
from sightline.corruptions.corruption import Corruption
from sightline.corruptions.exposure import (
    CameraBrightness,
    CameraContrast,
    CameraDarkness,
    CameraIllumination,
)
from sightline.corruptions.haze import CameraFog
from sightline.corruptions.lidar_fog import LidarFog
from sightline.corruptions.lidar_loss import (
    LidarBeams,
    LidarCutout,
    LidarFov,
    LidarPointDrop,
    LidarSector,
)
from sightline.corruptions.lidar_noise import (
    LidarCrosstalk,
    LidarGaussianNoise,
    LidarImpulseNoise,
    LidarUniformNoise,
)
from sightline.corruptions.lidar_precipitation import LidarRain, LidarSnow
from sightline.corruptions.misalignment import SpatialMisalignment, TemporalMisalignment
from sightline.corruptions.noise import (
    CameraDeadPixels,
    CameraGaussianNoise,
    CameraImpulseNoise,
    CameraShotNoise,
    CameraUniformNoise,
)
from sightline.corruptions.occlusion import CameraOcclusion
from sightline.corruptions.optics import CameraDefocus, CameraDirt, CameraJpeg, CameraMotionBlur
from sightline.corruptions.pixel_box import AreaDrawing
from sightline.corruptions.sensor import HDL_64E, SpinningLidar
from sightline.corruptions.sun_glare import SunGlare
from sightline.files.plain_text import shortened
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments

SEVERITIES: Final = (1, 2, 3, 4, 5)

_MIN_SIMILARITY = 0.7  # minimum similarity of a misspelt name; a lower limit confuses sensors

Level = tuple[float | int, ...]
"""Settings of a severity, one number for each quantity of its kind."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Kind:
    """Kind of corruption with the settings of its five severities."""

    name: str
    quantities: tuple[str, ...]
    """Names of the level's numbers, with units."""
    levels: tuple[Level, Level, Level, Level, Level]
    """Levels from severity 1 to 5."""
    make: Callable[[tuple[float, ...], SpinningLidar], Corruption]
    is_core: bool = False
    """Whether the kind is in suite `core`."""

    def at(self, severity: int, lidar: SpinningLidar = HDL_64E) -> Corruption:
        """Make the corruption of a severity.

        Args:
            severity: From 1, slight, to 5.
            lidar: The affected LiDAR, if its properties matter.

        Raises:
            ValueError: There is no such severity.
        """
        level = self.levels[plain_severity(self.name, severity) - 1]
        return self.make(tuple(map(float, level)), lidar)

    def describe(self, severity: int) -> str:
        """Format the level of a severity: quantities with units."""
        numbers = self.levels[severity - 1]
        return ", ".join(
            f"{quantity.split(' [')[0]} {number:g}{_unit(quantity)}"
            for quantity, number in zip(self.quantities, numbers, strict=True)
        )

    def said(self, severity: int) -> str:
        """Deprecated name of `describe`."""
        warn_user("Kind.said is deprecated; call Kind.describe", DeprecationWarning)
        return self.describe(severity)


def plain_severity(kind: str, severity: object) -> int:
    """Convert a severity of any number type to int: 3.0 and NumPy's 3 give 3, True is invalid.

    Raises:
        ValueError: The kind has no such severity.
    """
    if isinstance(severity, bool | np.bool_ | Sequence) or severity not in SEVERITIES:
        raise ValueError(
            f"{kind} has severities from 1 to 5, got {severity!r}; give a whole number"
        )
    return SEVERITIES[SEVERITIES.index(severity)]


@named_arguments
def find_kind(name: str) -> Kind:
    """Find a kind by name.

    Raises:
        ValueError: There is no such kind.
    """
    if name not in KINDS:
        raise ValueError(unknown("there is no kind of corruption", name, tuple(KINDS)))
    return KINDS[name]


@named_arguments
def unknown(
    problem: str, name: str, names: Sequence[str], listed: Iterable[str] | None = None
) -> str:
    """Describe an unknown name, with similar valid names and all of them.

    Args:
        problem: Beginning of the message.
        name: The unknown name.
        names: All valid names.
        listed: Names in the message instead of all. None: all.
    """
    holding = [each for each in names if name and name in each]
    close = difflib.get_close_matches(name, names, n=2, cutoff=_MIN_SIMILARITY) or holding[:2]
    meant = f"perhaps {' or '.join(close)} is meant; " if close else ""
    return f"{problem} '{shortened(name)}'; {meant}name one of {', '.join(listed or names)}"


def _unit(quantity: str) -> str:
    _, bracket, unit = quantity.partition(" [")
    return f" {unit[:-1]}" if bracket else ""


def _same(number: float) -> tuple[float, float]:
    """Make a range that contains only this number."""
    return (number, number)


_ALL_KINDS = (
    Kind(
        name="camera_blank",
        quantities=("chance of a picture to be lost",),
        levels=((0.2,), (0.4,), (0.6,), (0.8,), (1,)),
        make=lambda level, _: CameraFramesLost(chance=level[0]),
        is_core=True,
    ),
    Kind(
        name="camera_occlusion",
        quantities=("share of the area",),
        levels=((0.05,), (0.1,), (0.2,), (0.3,), (0.4,)),
        make=lambda level, _: CameraOcclusion(box=AreaDrawing(area_share=level[0])),
        is_core=True,
    ),
    Kind(
        name="camera_dirt",
        quantities=("blobs",),
        levels=((5,), (10,), (20,), (40,), (80,)),
        make=lambda level, _: CameraDirt(num_blobs=int(level[0])),
        is_core=True,
    ),
    Kind(
        name="camera_gaussian_noise",
        quantities=("sigma [of full scale]",),
        levels=((0.08,), (0.12,), (0.18,), (0.26,), (0.38,)),
        make=lambda level, _: CameraGaussianNoise(sigma_levels=_same(255 * level[0])),
        is_core=True,
    ),
    Kind(
        name="camera_uniform_noise",
        quantities=("half width [of full scale]",),
        levels=((0.08,), (0.12,), (0.18,), (0.26,), (0.38,)),
        make=lambda level, _: CameraUniformNoise(half_width_levels=255 * level[0]),
    ),
    Kind(
        name="camera_shot_noise",
        quantities=("photons at full scale",),
        levels=((60,), (25,), (12,), (5,), (3,)),
        make=lambda level, _: CameraShotNoise(full_scale_photons=level[0]),
    ),
    Kind(
        name="camera_impulse_noise",
        quantities=("share of the values",),
        levels=((0.03,), (0.06,), (0.09,), (0.17,), (0.27,)),
        make=lambda level, _: CameraImpulseNoise(share=level[0]),
    ),
    Kind(
        name="camera_dead_pixels",
        quantities=("share of the pixels",),
        levels=((0.1,), (0.25,), (0.4,), (0.55,), (0.7,)),
        make=lambda level, _: CameraDeadPixels(share=_same(level[0])),
        is_core=True,
    ),
    Kind(
        name="camera_motion_blur",
        quantities=("length [px]",),
        levels=((7,), (13,), (19,), (25,), (31,)),
        make=lambda level, _: CameraMotionBlur(length_px=level[0]),
        is_core=True,
    ),
    Kind(
        name="camera_defocus",
        quantities=("radius [px]",),
        levels=((3,), (4,), (6,), (8,), (10,)),
        make=lambda level, _: CameraDefocus(radius_px=level[0]),
    ),
    Kind(
        name="camera_brightness",
        quantities=("added value [of full scale]",),
        levels=((0.1,), (0.2,), (0.3,), (0.4,), (0.5,)),
        make=lambda level, _: CameraBrightness(added_share=level[0]),
    ),
    Kind(
        name="camera_darkness",
        quantities=("peak [of full scale]",),
        levels=((0.6,), (0.5,), (0.4,), (0.3,), (0.2,)),
        make=lambda level, _: CameraDarkness(peak=level[0]),
        is_core=True,
    ),
    Kind(
        name="camera_illumination",
        quantities=(
            "radius [px]",
            "added levels",
        ),
        levels=((60, 100), (120, 130), (180, 160), (270, 190), (360, 220)),
        make=lambda level, _: CameraIllumination(
            radius_px=_same(level[0]), added_levels=(int(level[1]), int(level[1]))
        ),
        is_core=True,
    ),
    Kind(
        name="camera_fog",
        quantities=("visibility [m]",),
        levels=((200,), (100,), (60,), (40,), (25,)),
        make=lambda level, _: CameraFog(visibility_m=level[0]),
        is_core=True,
    ),
    Kind(
        name="camera_rain",
        quantities=("rate [mm/h]",),
        levels=((5,), (10,), (20,), (35,), (50,)),
        make=lambda level, _: CameraRain(rate_mm_per_h=level[0]),
        is_core=True,
    ),
    Kind(
        name="camera_snow",
        quantities=("rate [mm/h]",),
        levels=((0.5,), (1,), (1.5,), (2,), (2.5,)),
        make=lambda level, _: CameraSnow(rate_mm_per_h=level[0]),
    ),
    Kind(
        name="camera_jpeg",
        quantities=("quality",),
        levels=((25,), (18,), (15,), (10,), (7,)),
        make=lambda level, _: CameraJpeg(quality=int(level[0])),
    ),
    Kind(
        name="camera_contrast",
        quantities=("factor",),
        levels=((0.4,), (0.3,), (0.2,), (0.1,), (0.05,)),
        make=lambda level, _: CameraContrast(factor=level[0]),
    ),
    Kind(
        name="sun_glare",
        quantities=(
            "radius [px]",
            "ghosts [of the points]",
        ),
        levels=((30, 0.004), (40, 0.008), (50, 0.012), (60, 0.016), (70, 0.02)),
        make=lambda level, lidar: SunGlare(radius_px=level[0], ghost_share=level[1], lidar=lidar),
        is_core=True,
    ),
    Kind(
        name="lidar_blank",
        quantities=("chance of a sweep to be lost",),
        levels=((0.2,), (0.4,), (0.6,), (0.8,), (1,)),
        make=lambda level, _: LidarFramesLost(chance=level[0]),
        is_core=True,
    ),
    Kind(
        name="lidar_beams",
        quantities=("beams kept [of 64]",),
        levels=((48,), (32,), (16,), (8,), (4,)),
        make=lambda level, lidar: LidarBeams(kept_share=level[0] / 64, lidar=lidar),
        is_core=True,
    ),
    Kind(
        name="lidar_point_drop",
        quantities=("share of the points",),
        levels=((0.2,), (0.4,), (0.6,), (0.8,), (0.9,)),
        make=lambda level, _: LidarPointDrop(share=level[0]),
        is_core=True,
    ),
    Kind(
        name="lidar_fov",
        quantities=("half angle [deg]",),
        levels=((35,), (28,), (20,), (12,), (6,)),
        make=lambda level, _: LidarFov(half_angle_deg=level[0]),
    ),
    Kind(
        name="lidar_sector",
        quantities=("width [deg]",),
        levels=((10,), (20,), (30,), (40,), (60,)),
        make=lambda level, _: LidarSector(width_deg=level[0]),
        is_core=True,
    ),
    Kind(
        name="lidar_cutout",
        quantities=("blobs",),
        levels=((2,), (3,), (5,), (7,), (10,)),
        make=lambda level, _: LidarCutout(num_blobs=int(level[0])),
    ),
    Kind(
        name="lidar_gaussian_noise",
        quantities=("sigma [m]",),
        levels=((0.02,), (0.04,), (0.06,), (0.08,), (0.1,)),
        make=lambda level, _: LidarGaussianNoise(sigma_m=level[0]),
        is_core=True,
    ),
    Kind(
        name="lidar_uniform_noise",
        quantities=("half width [m]",),
        levels=((0.02,), (0.04,), (0.06,), (0.08,), (0.1,)),
        make=lambda level, _: LidarUniformNoise(half_width_m=level[0]),
    ),
    Kind(
        name="lidar_impulse_noise",
        quantities=("one point of",),
        levels=((30,), (25,), (20,), (15,), (10,)),
        make=lambda level, _: LidarImpulseNoise(share=1 / level[0]),
    ),
    Kind(
        name="lidar_crosstalk",
        quantities=("share of the points",),
        levels=((0.004,), (0.008,), (0.012,), (0.016,), (0.02,)),
        make=lambda level, _: LidarCrosstalk(share=level[0]),
        is_core=True,
    ),
    Kind(
        name="lidar_fog",
        quantities=("attenuation [1/m]",),
        levels=((0.005,), (0.01,), (0.02,), (0.03,), (0.06,)),
        make=lambda level, lidar: LidarFog(attenuation_per_m=level[0], lidar=lidar),
        is_core=True,
    ),
    Kind(
        name="lidar_rain",
        quantities=("rate [mm/h]",),
        levels=((5,), (10,), (20,), (35,), (50,)),
        make=lambda level, lidar: LidarRain(rate_mm_per_h=level[0], lidar=lidar),
    ),
    Kind(
        name="lidar_snow",
        quantities=("rate [mm/h]",),
        levels=((0.5,), (1,), (1.5,), (2,), (2.5,)),
        make=lambda level, lidar: LidarSnow(rate_mm_per_h=level[0], lidar=lidar),
        is_core=True,
    ),
    Kind(
        name="misalignment_spatial",
        quantities=(
            "rotation [deg]",
            "translation [m]",
        ),
        levels=((0.25, 0.02), (0.5, 0.05), (1, 0.1), (2, 0.2), (3, 0.3)),
        make=lambda level, _: SpatialMisalignment(rotation_deg=level[0], translation_m=level[1]),
        is_core=True,
    ),
    Kind(
        name="misalignment_temporal",
        quantities=("latency [s]",),
        levels=((0.05,), (0.1,), (0.2,), (0.3,), (0.5,)),
        make=lambda level, _: TemporalMisalignment(latency_s=level[0]),
        is_core=True,
    ),
)
KINDS: Final[dict[str, Kind]] = {kind.name: kind for kind in _ALL_KINDS}
"""Kinds by name: of the camera, of both sensors, of the LiDAR, of their alignment."""
