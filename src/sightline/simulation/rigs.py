"""Rigs: a camera and a LiDAR on a car as data; named ones, and files in YAML.

Without the sensors' code, for a fast command line; `rig_sensors` mounts a rig.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin, get_type_hints

from sightline.files.plain_text import shortened
from sightline.files.plain_yaml import read_yaml
from sightline.files.problem import FileError
from sightline.geometry.choices import check_choices
from sightline.geometry.ranges import Within, check_ranges
from sightline.simulation.tables import read_table

LidarModel = Literal["hdl-64e", "hdl-32e", "vlp-16"]
"""Names in `lidar.LIDARS`."""
Drawn = Literal["random", "named"]
"""Rigs of many frames: another random one for each, or the named ones in turn."""
DRAWN: Final = get_args(Drawn)
PointOrder = Literal["rings", "firings", "none"]
"""Orders of a sweep's points."""
MIN_ROOF_GAP_M: Final = 0.1
"""Smallest height of a LiDAR above the own car's roof."""
MIN_SIDE_PX: Final = 32
MAX_SIDE_PX: Final = 8192
"""Together the limits of `data.formats.image_header` for an image."""
_MAX_RINGS: Final = 256
_MIN_RINGS_WITH_VIEW: Final = 4
_MIN_VIEW_DEG: Final = 2.0  # a LiDAR with rings sees 10 degrees or more; 115 are 2 radians
_MAX_ELEVATION_DEG: Final = 89.0
_REMEDY: Final = "see docs/guides/simulate.md, Other rigs, for an example"


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraRig:
    """Camera without distortion: intrinsics and mount. Angles are those of a URDF, as in `Tilt`."""

    image_size: tuple[int, int]
    """Height, width [px]."""
    focal_px: Annotated[float, Within(50, 20000)]
    """Focal length."""
    principal_px: tuple[float, float] | None = None
    """Principal point x, y [px]. None: the middle of the image."""
    height_m: Annotated[float, Within(0.3, 5)] = 1.65
    """Height above the road."""
    ahead_m: Annotated[float, Within(-5, 10)] = 0.3
    """Offset ahead of the LiDAR."""
    left_m: Annotated[float, Within(-3, 3)] = 0.0
    """Offset to the left of the LiDAR."""
    pitch_deg: Annotated[float, Within(-20, 20)] = 0.0
    """Pitch against the road; positive: it looks down."""
    roll_deg: Annotated[float, Within(-15, 15)] = 0.0
    """Roll against the road; positive: its right side is lower."""
    white_balance: Annotated[tuple[float, float, float], Within(0.5, 2)] = (1.0, 1.0, 1.0)
    """Factors on red, green and blue of the image."""
    jpeg_quality: Annotated[int, Within(20, 100)] = 100
    """Quality of a compression before the image is stored; 100: none."""
    bonnet_m: Annotated[float, Within(0, 2)] = 0.0
    """Height of the own car's bonnet, which the camera sees ahead of it; 0: no bonnet."""
    dirt: Annotated[float, Within(0, 1)] = 0.0
    """Dirt on the windscreen: 0 clean, 1 as dirty as one can drive with."""
    readout_ms: Annotated[float, Within(0, 100)] = 0.0
    """Time from the first row's exposure to the last one's, while the car moves; the middle row
    has the frame's time. 0: all rows at once."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        height, width = self.image_size
        if not MIN_SIDE_PX <= min(self.image_size) <= max(self.image_size) <= MAX_SIDE_PX:
            raise ValueError(
                f"the image must have {MIN_SIDE_PX} to {MAX_SIDE_PX} pixels along each side, got "
                f"{width} x {height} (width x height)"
            )
        check_ranges(self)
        x, y = self.principal
        if not (0 <= x <= width and 0 <= y <= height):
            raise ValueError(
                f"principal_px must lie in the image of {width} x {height}, got {x:g}, {y:g}"
            )
        if self.bonnet_m > self.height_m - 0.1:
            raise ValueError(
                f"bonnet_m must be 0.1 m or more below the camera at {self.height_m:g} m, got "
                f"{self.bonnet_m:g}"
            )

    @property
    def principal(self) -> tuple[float, float]:
        """Principal point x, y [px]."""
        height, width = self.image_size
        return self.principal_px or ((width - 1) / 2, (height - 1) / 2)

    @property
    def width_deg(self) -> float:
        """Horizontal field of view."""
        x, width = self.principal[0], self.image_size[1]
        sides = math.atan((x + 0.5) / self.focal_px), math.atan((width - 0.5 - x) / self.focal_px)
        return math.degrees(sum(sides))


@dataclass(frozen=True, kw_only=True, slots=True)
class Rosette:
    """Pattern of a solid-state LiDAR, whose two prisms lead the beam in rosettes without rings."""

    width_deg: Annotated[float, Within(5, 120)]
    height_deg: Annotated[float, Within(5, 90)]
    """Field of view, middle ahead."""
    points: Annotated[int, Within(100, 1_000_000)]
    """Firings in a frame of 0.1 s."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_ranges(self)


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarRig:
    """LiDAR: rings by their elevations, the lasers of a measured model, or a rosette."""

    elevations_deg: tuple[float, ...] = ()
    """Elevations of the rings from the top."""
    model: LidarModel | None = None
    """Measured lasers, in place of `elevations_deg`."""
    rosette: Rosette | None = None
    """Pattern without rings, in place of `elevations_deg`."""
    azimuth_step_deg: Annotated[float, Within(0.02, 5)] = 0.2
    """Step between two firings of a ring."""
    blind_sectors: tuple[tuple[float, float, float], ...] = ()
    """Sectors hidden by the own car: start, end (counter-clockwise, 0 is ahead) and the elevation
    below which beams are lost [degrees]."""
    height_m: Annotated[float, Within(0.3, 5)] = 1.73
    """Height above the road."""
    pitch_deg: Annotated[float, Within(-20, 20)] = 0.0
    """Pitch against the road; positive: its front is lower. Points are in the tilted frame."""
    roll_deg: Annotated[float, Within(-20, 20)] = 0.0
    """Roll against the road; positive: its right side is lower."""
    range_m: Annotated[float, Within(20, 250)] = 80.0
    """Largest range; returns become rarer from nine tenths of it on."""
    range_noise_m: Annotated[float, Within(0, 0.3)] = 0.02
    """Standard deviation of a range."""
    reflectance: Annotated[float, Within(0, 3)] = 1.0
    """Factor on KITTI's scale of reflectances, clipped to 1; 0: all are 0."""
    order: PointOrder = "rings"
    """Order of the points: ring by ring from the top, as in KITTI's files, from which ring numbers
    follow; in the order of the firings, from behind; or without any order."""
    roof_m: Annotated[float, Within(0, 4)] = 0.0
    """Height of the own car's roof, which returns points as its bonnet does; 0: none returned."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        given = (bool(self.elevations_deg), self.model is not None, self.rosette is not None)
        if sum(given) != 1:
            raise ValueError(
                "a LiDAR needs one of elevations_deg (or fans), model and rosette, got "
                f"{sum(given)} of them"
            )
        check_choices(self)
        check_ranges(self)
        rings = self.elevations_deg
        if len(rings) > _MAX_RINGS or any(not abs(ring) <= _MAX_ELEVATION_DEG for ring in rings):
            raise ValueError(
                f"elevations_deg must be up to {_MAX_RINGS} numbers from -{_MAX_ELEVATION_DEG:g} "
                f"to {_MAX_ELEVATION_DEG:g}"
            )
        if list(rings) != sorted(rings, reverse=True):
            raise ValueError("elevations_deg must fall, from the top ring to the lowest")
        if len(rings) >= _MIN_RINGS_WITH_VIEW and rings[0] - rings[-1] < _MIN_VIEW_DEG:
            raise ValueError(
                f"elevations_deg span {rings[0] - rings[-1]:.2g} degrees, expected at least "
                f"{_MIN_VIEW_DEG:g} for {len(rings)} rings: they are probably in radians"
            )
        if self.roof_m > self.height_m - MIN_ROOF_GAP_M:
            raise ValueError(
                f"roof_m must be {MIN_ROOF_GAP_M:g} m or more below the LiDAR at "
                f"{self.height_m:g} m, got {self.roof_m:g}"
            )
        for start, end, below in self.blind_sectors:
            if not (0 <= start < end <= 360 and abs(below) <= 90):
                raise ValueError(
                    "blind_sectors must be start, end and elevation with 0 <= start < end <= 360, "
                    f"got {start:g}, {end:g}, {below:g}; divide one that lies across 0 in two"
                )


@dataclass(frozen=True, kw_only=True, slots=True)
class Rig:
    """Camera and LiDAR on one car, both looking ahead."""

    name: str
    camera: CameraRig
    lidar: LidarRig
    source: str = ""
    """Source of the numbers, such as a data sheet."""


_NAMED: Final[Mapping[str, Any]] = read_table(__file__, "rigs")
RIG_NAMES: Final = tuple(_NAMED)


@lru_cache
def named_rig(name: str) -> Rig:
    """Take a rig of `rigs.json`."""
    return _rig(name, _NAMED[name])


def choose_rig(given: str) -> Rig | Drawn:
    """Interpret the name of a rig, "random", "named", or the path of a file.

    Raises:
        ValueError: There is no such rig or file, or the file is invalid.
    """
    if given == "random":
        return "random"
    if given == "named":
        return "named"
    if given in RIG_NAMES:
        return named_rig(given)
    path = Path(given)
    if not path.is_file() and path.suffix not in (".yaml", ".yml", ".json"):
        raise ValueError(
            f"rig must be random, named, a YAML file, or one of {', '.join(RIG_NAMES)}; got "
            f"{shortened(given, 60)!r}"
        )
    return read_rig(path)


def read_rig(path: Path) -> Rig:
    """Read a rig from a YAML file with the entries `camera` and `lidar`.

    Entries are those of `CameraRig` and `LidarRig`; `image_size` is {width: .., height: ..}, and
    `fans` may stand for `elevations_deg`: blocks of evenly spread rings from the top, each with
    first and last elevation [degrees] and number.

    Raises:
        FileError: The file is unreadable or no rig.
    """
    content = read_yaml(path, _REMEDY)
    try:
        if not isinstance(content, dict):
            raise ValueError("holds no mapping of names to values, expected camera and lidar")
        return _rig(path.stem, content)
    except (ValueError, OverflowError) as error:
        raise FileError(path, str(error), _REMEDY) from error


def _rig(name: str, content: Mapping[str, Any]) -> Rig:
    lidar = content.get("lidar")
    if isinstance(lidar, Mapping) and "fans" in lidar:
        if "elevations_deg" in lidar:
            raise ValueError("lidar has both fans and elevations_deg, expected one")
        rings = _fanned(_converted("fans", lidar["fans"], tuple[tuple[float, float, int], ...]))
        others = {key: value for key, value in lidar.items() if key != "fans"}
        content = {**content, "lidar": {**others, "elevations_deg": rings}}
    rig: Rig = _converted("the rig", {"name": name, **content}, Rig)
    return rig


def _fanned(fans: Iterable[tuple[float, float, int]]) -> tuple[float, ...]:
    """Spread the rings of each block evenly."""
    rings: list[float] = []
    for top, bottom, count in fans:
        if not 1 <= count <= _MAX_RINGS:
            raise ValueError(f"each of fans must have 1 to {_MAX_RINGS} rings, got {count}")
        step = (bottom - top) / max(count - 1, 1)
        rings += [round(top + step * ring, 4) for ring in range(count)]
    return tuple(rings)


def _converted(name: str, value: Any, hint: Any) -> Any:  # noqa: ANN401 - any plain value
    """Convert a plain value, as read from a file, to the type of a field."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _converted(name, value, parts[0])
    if origin in (Union, UnionType):  # X | None
        return None if value is None else _converted(name, value, parts[0])
    if is_dataclass(hint):
        return _built(name, value, hint)
    if name == "image_size":  # named sides, as the order of a list would be doubtful
        if not isinstance(value, Mapping) or set(value) != {"width", "height"}:
            given = shortened(str(value), 40)
            raise ValueError(f"{name} is {given!r}, expected {{width: .., height: ..}}")
        value = (value["height"], value["width"])
    if origin is tuple and isinstance(value, list | tuple):
        kinds = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
        if len(kinds) == len(value):
            each = zip(kinds, value, strict=True)
            return tuple(_converted(f"an entry of {name}", one, kind) for kind, one in each)
    if hint is float and type(value) in (int, float) and math.isfinite(value):
        return float(value)
    if (hint in (int, str) and type(value) is hint) or (origin is Literal and value in parts):
        return value
    raise ValueError(f"{name} is {shortened(str(value), 40)!r}, expected {_described(hint)}")


def _described(hint: Any) -> str:  # noqa: ANN401 - a type
    parts = get_args(hint)
    if get_origin(hint) is Literal:
        return f"one of {', '.join(parts)}"
    if get_origin(hint) is tuple:
        number = "" if parts[-1] is Ellipsis else f"{len(parts)} "
        return f"a list of {number}numbers" if get_origin(parts[0]) is None else "a list of lists"
    return {int: "a whole number", float: "a number", str: "a text"}[hint]


def _built(name: str, content: object, kind: Any) -> Any:  # noqa: ANN401 - a dataclass
    """Build a dataclass from a mapping of its fields."""
    if not isinstance(content, Mapping):
        raise ValueError(f"{name} is no mapping of entries to values")
    listed = {field.name: field for field in fields(kind)}
    unknown = [str(key) for key in content if key not in listed]
    if unknown:
        known = [*listed, *(["fans"] if kind is LidarRig else [])]
        raise ValueError(
            f"{name} has the unknown entry {shortened(unknown[0], 40)!r}, expected "
            f"{', '.join(known)}"
        )
    lacking = [
        key for key, each in listed.items() if each.default is MISSING and key not in content
    ]
    if lacking:
        raise ValueError(f"{name} lacks {lacking[0]}")
    hints = get_type_hints(kind, include_extras=True)
    return kind(**{key: _converted(key, value, hints[key]) for key, value in content.items()})
