"""Reader of key frames of nuScenes (Caesar et al. 2020) and of data sets with the same tables."""

import hashlib
import os
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from sightline.data.importing.frames import Rigid
from sightline.data.importing.nuscenes_tables import REMEDY, Row, Table, read_rows, read_table
from sightline.files.plain_text import shortened
from sightline.files.problem import FileError
from sightline.files.safe_names import checked_name, path_below
from sightline.geometry.road_height import MAX_LIDAR_HEIGHT_M, MIN_LIDAR_HEIGHT_M
from sightline.geometry.tilt import Tilt

_DATA_FOLDERS: Final = (("samples", "sweeps"), ("data", "lidar", "images"))
"""Folders beside those of tables: nuScenes', then TIER IV's and Lyft's."""
_MODALITIES: Final = ("camera", "lidar", "radar")
_VISIBILITY: Final = "visibility"
"""Table that some data sets lack."""
_OCCLUSIONS: Final = {
    # Percent, in nuScenes
    "v0-40": 2,
    "v40-60": 1,
    "v60-80": 1,
    "v80-100": 0,
    # Words, in TIER IV's data sets
    "none": 2,
    "partial": 1,
    "most": 1,
    "full": 0,
}
"""KITTI's occlusion by the level of a visibility."""
_DISTORTION: Final = "camera_distortion"
"""Entry of the lens in tables of TIER IV; nuScenes' images are straight."""
_CYCLE: Final = "cycle."
"""Begin of nuScenes' attributes of riders, which every cycle with a rider has."""
_RIDDEN: Final = "with_rider"
_UNRIDDEN: Final = frozenset(("without_rider", "parked"))
"""Last words of cycles' attributes: TIER IV's begin with cycle_state, two_wheel_vehicle_state .."""
_REFERENCED: Final = (
    "attribute",
    "calibrated_sensor",
    "category",
    "ego_pose",
    "instance",
    "sensor",
)
"""Tables that rows of others refer to."""
_ANNOTATIONS: Final = "sample_annotation"
_DESCRIBING: Final = ("attribute", "category", "instance")
"""Tables that only annotations refer to."""
_LISTED: Final = ("sample", "sample_annotation", "sample_data", "scene")
"""Tables whose rows are read in their order."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Annotation:
    """Labelled object in the world frame."""

    category: str
    """Category, e.g. vehicle.car."""
    is_ridden: bool | None
    """Presence of a rider on a cycle; None: the attributes of the annotation do not give it."""
    occlusion: int | None
    """KITTI's occlusion, 0 to 2, by the visibility in all cameras; None: unknown."""
    num_lidar_points: int | None
    """Number of LiDAR points in the box; None: unknown, or perhaps of several LiDARs."""
    size_lwh: tuple[float, float, float]
    world_from_box: Rigid


@dataclass(frozen=True, kw_only=True, slots=True)
class Moment:
    """Image and sweep of one frame."""

    name: str
    """Name of the scene with the index in it: scene-0061-000."""
    time_s: float
    """Time of the sweep."""
    image_time_s: float
    image: Path
    sweep: Path
    image_size: tuple[int, int]
    camera_matrix: tuple[tuple[float, ...], ...]
    lens: tuple[float, ...]
    """Coefficients of a distorting lens; empty: the image is straight."""
    camera_from_lidar: Rigid
    """Transform between the poses at the times of image and sweep, including the car's motion."""
    mount: Rigid
    """Transform camera_from_lidar of a car at rest."""
    lidar_height_m: float | None
    """Height above the road, the origin of the car's frame; None: the frame is not on the road."""
    world_from_lidar: Rigid
    tilt: Tilt
    """Tilt of the LiDAR against the car."""
    annotations: tuple[Annotation, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Moments:
    """All frames of a data set, and counts of dropped ones."""

    moments: tuple[Moment, ...]
    num_incomplete: int
    """Number of samples without a key frame of each of the two channels."""
    num_repeated: int
    """Number of key frames beyond the first of a sample and a channel."""
    num_invalid: int
    """Number of key frames of the two channels that the tables mark as invalid."""
    other_lidars: tuple[str, ...]
    """Channels of the other LiDARs."""


@dataclass(frozen=True, slots=True)
class Tables:
    """Tables of one version of the data set."""

    root: Path
    """Folder with `samples`."""
    folder: Path
    """Folder of the tables, e.g. v1.0-mini."""

    def moments(self, camera: str, lidar: str) -> Moments:
        """Return all frames with a key frame of both channels, scene by scene.

        Raises:
            ValueError: A table is missing or damaged, a name or path in it leads out of the data
                set, or there is no such channel.
        """
        return _Reader(self).moments(camera, lidar)

    def digest(self) -> str:
        """Twelve digits of the SHA-256 of all tables: other digits mean other contents."""
        total = hashlib.sha256()
        has_visibility = (self.folder / f"{_VISIBILITY}.json").is_file()
        absent = self.absent_annotation_tables()
        for name in (*_REFERENCED, *_LISTED, *([_VISIBILITY] if has_visibility else [])):
            if f"{name}.json" not in absent:
                with (self.folder / f"{name}.json").open("rb") as file:
                    total.update(hashlib.file_digest(file, "sha256").digest())
        return total.hexdigest()[:12]

    def absent_annotation_tables(self) -> tuple[str, ...]:
        """Names of missing tables of annotations, which data sets without labels lack."""
        names = (f"{name}.json" for name in (_ANNOTATIONS, *_DESCRIBING))
        # a link to nothing is a table that cannot be read
        return tuple(name for name in names if not os.path.lexists(self.folder / name))


def find_tables(source: Path) -> Tables | None:
    """Find the tables in a folder or its subfolder, such as v1.0-mini.

    Tables may be a link in the folder of the data, or a folder of the data may be linked.

    Raises:
        ValueError: There are several versions.
    """
    if (source / "sample.json").is_file():
        target = source.resolve().parent
        roots = (
            place
            for names in _DATA_FOLDERS
            for place in (source.absolute().parent, target)
            if any((place / name).is_dir() for name in names)
        )
        return Tables(next(roots, target), source)
    found = sorted(path.parent for path in source.glob("*/sample.json"))
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise ValueError(f"{source} holds several versions: {names}; name the folder of one")
    return Tables(source, found[0]) if found else None


@dataclass(frozen=True, kw_only=True, slots=True)
class _KeyFrames:
    """Rows of the two channels, and counts as in `Moments`."""

    by_sample: dict[str, dict[str, Row]]
    """Rows by sample and channel."""
    num_repeated: int
    num_invalid: int
    other_lidars: tuple[str, ...]


class _Reader:
    def __init__(self, tables: Tables) -> None:
        self._tables = tables
        absent = tables.absent_annotation_tables()
        is_annotated = f"{_ANNOTATIONS}.json" not in absent
        self._annotations = list(read_rows(self._path(_ANNOTATIONS))) if is_annotated else []
        self._tables_by_name = {
            name: self._read_referenced(name)
            for name in _REFERENCED
            if self._annotations or f"{name}.json" not in absent
        }
        attributes = self._tables_by_name["attribute"].rows.values() if self._annotations else ()
        self._samples = read_table(self._path("sample"))
        self._occlusions = self._read_occlusions()
        self._has_counts = True
        self._has_riders = any(row.text("name").startswith(_CYCLE) for row in attributes)

    def moments(self, camera: str, lidar: str) -> Moments:
        found = self._key_frames((camera, lidar))
        by_sample = found.by_sample
        has_counts = any(row.entries.get("num_lidar_pts") for row in self._annotations)
        self._has_counts = has_counts and not found.other_lidars
        annotations: dict[str, list[Row]] = {}
        for row in self._annotations:
            token = self._samples.of(row, "sample_token").text("token")
            annotations.setdefault(token, []).append(row)
        num_complete = sum(len(by_channel) == 2 for by_channel in by_sample.values())
        if camera == lidar or not num_complete:
            raise ValueError(
                f"{self._tables.folder} has no sample with key frames of {camera} and {lidar}; "
                "name a camera by --camera-topic and a LiDAR by --lidar-topic"
            )
        moments = [
            self._moment(name, by_sample[token][camera], by_sample[token][lidar], labelled)
            for token, name in self._names()
            if len(by_sample.get(token, {})) == 2
            for labelled in [annotations.get(token, [])]
        ]
        return Moments(
            moments=tuple(moments),
            num_incomplete=len(self._samples.rows) - len(moments),
            num_repeated=found.num_repeated,
            num_invalid=found.num_invalid,
            other_lidars=found.other_lidars,
        )

    def _key_frames(self, channels: tuple[str, str]) -> "_KeyFrames":
        by_sample: dict[str, dict[str, Row]] = {}
        num_repeated = num_invalid = 0
        modalities: dict[str, object] = {}
        num_between = 0
        for row in read_rows(self._path("sample_data")):
            if not row.flag("is_key_frame"):
                num_between += 1
                continue
            sensor = self._sensor(row)
            channel = sensor.text("channel")
            modalities[channel] = sensor.entries.get("modality")
            if channel in channels and row.entries.get("is_valid") is False:
                num_invalid += 1
            elif channel in channels:
                token = self._samples.of(row, "sample_token").text("token")
                by_channel = by_sample.setdefault(token, {})
                num_repeated += channel in by_channel
                by_channel.setdefault(channel, row)
        if not modalities:
            raise FileError(
                self._path("sample_data"),
                f"has no key frame: none of its {num_between} rows has is_key_frame true, and "
                "only key frames have labels",
                f"{REMEDY}, or mark the rows to import",
            )
        for channel, kind in zip(channels, ("camera", "lidar"), strict=True):
            others = [each for each in _MODALITIES if each != kind]
            fitting = [name for name, each in modalities.items() if each not in others]
            if channel not in fitting:
                names = ", ".join(sorted(map(shortened, fitting)))
                raise ValueError(
                    f"{self._tables.folder} has no key frame of a {kind} {shortened(channel)}; "
                    + (f"name one of {names} by --{kind}-topic" if names else f"it has no {kind}")
                )
        lidars = (name for name, each in modalities.items() if each == "lidar")
        return _KeyFrames(
            by_sample=by_sample,
            num_repeated=num_repeated,
            num_invalid=num_invalid,
            other_lidars=tuple(sorted(name for name in lidars if name not in channels)),
        )

    def _names(self) -> Iterator[tuple[str, str]]:
        """Yield the tokens of all samples, scene by scene, and the names of their frames."""
        scenes = read_table(self._path("scene"))
        names: dict[str, Row] = {}
        for row in scenes.rows.values():
            name = checked_name(row.get("name"), row.path, f"row {row.number}: the name")
            if name in names:
                raise row.fault(f"has the name {name!r} of row {names[name].number}, too")
            names[name] = row
        keyed = [
            (scenes.of(row, "scene_token").text("name"), row.time_us("timestamp"), token)
            for token, row in self._samples.rows.items()
        ]
        totals, counts = Counter(scene for scene, _, _ in keyed), Counter[str]()
        for scene, _, token in sorted(keyed, key=lambda each: each[:2]):
            width = max(3, len(str(totals[scene] - 1)))  # frames are read in alphabetical order
            yield token, f"{scene}-{counts[scene]:0{width}}"
            counts[scene] += 1

    def _moment(self, name: str, image: Row, sweep: Row, labelled: Sequence[Row]) -> Moment:
        ego_from_camera, ego_from_lidar = (
            self._referenced(row, "calibrated_sensor").pose() for row in (image, sweep)
        )
        height_m = float(ego_from_lidar[2, 3])
        world_from_camera = self._referenced(image, "ego_pose").pose() @ ego_from_camera
        world_from_lidar = self._referenced(sweep, "ego_pose").pose() @ ego_from_lidar
        camera = self._referenced(image, "calibrated_sensor")
        return Moment(
            name=name,
            time_s=sweep.time_us("timestamp") / 1e6,
            image_time_s=image.time_us("timestamp") / 1e6,
            image=self._file(image),
            sweep=self._file(sweep),
            image_size=(image.whole("height", minimum=1), image.whole("width", minimum=1)),
            camera_matrix=tuple(map(tuple, camera.numbers("camera_intrinsic", 3, 3).tolist())),
            lens=_lens(camera),
            camera_from_lidar=np.linalg.inv(world_from_camera) @ world_from_lidar,
            mount=np.linalg.inv(ego_from_camera) @ ego_from_lidar,
            lidar_height_m=(
                height_m if MIN_LIDAR_HEIGHT_M <= height_m <= MAX_LIDAR_HEIGHT_M else None
            ),
            world_from_lidar=world_from_lidar,
            tilt=Tilt.from_up(ego_from_lidar[2, :3]),
            annotations=tuple(map(self._annotation, labelled)),
        )

    def _annotation(self, row: Row) -> Annotation:
        category = self._referenced(self._referenced(row, "instance"), "category")
        has_attributes = row.entries.get("attribute_tokens") is not None
        tokens = row.texts("attribute_tokens") if has_attributes else []
        known = self._tables_by_name["attribute"]
        attributes = {known.of(row, "attribute_tokens", token).text("name") for token in tokens}
        width, length, height = row.numbers("size", 3).tolist()
        if min(width, length, height) <= 0:
            raise row.fault(f"has the size {[width, length, height]}, expected lengths above 0")
        return Annotation(
            category=category.text("name"),
            is_ridden=self._is_ridden(attributes) if has_attributes else None,
            occlusion=self._occlusions.get(str(row.entries.get("visibility_token"))),
            num_lidar_points=_num_points(row) if self._has_counts else None,
            size_lwh=(length, width, height),
            world_from_box=row.pose(),
        )

    def _is_ridden(self, attributes: Collection[str]) -> bool | None:
        """Return whether a cycle of these attributes has a rider; None: unknown."""
        states = {plain_word(name.rpartition(".")[2]) for name in attributes}
        if _RIDDEN in states:
            return True
        return False if self._has_riders or states & _UNRIDDEN else None

    def _read_occlusions(self) -> dict[str, int]:
        """Read KITTI's occlusion of each visibility token; without a table, nuScenes' four."""
        path = self._path(_VISIBILITY)
        if not path.is_file():
            return {str(token): occlusion for token, occlusion in enumerate((2, 1, 1, 0), start=1)}
        levels = {
            token: str(row.entries.get("level", "")).strip().lower()
            for token, row in read_table(path).rows.items()
        }
        return {
            token: _OCCLUSIONS[level] for token, level in levels.items() if level in _OCCLUSIONS
        }

    def _read_referenced(self, name: str) -> Table:
        path = self._path(name)
        if name in _DESCRIBING and not os.path.lexists(path):
            raise FileError(
                path,
                f"is missing, and rows of {_ANNOTATIONS}.json refer to it",
                f"{REMEDY}, or remove {_ANNOTATIONS}.json to import without labels",
            )
        return read_table(path)

    def _referenced(self, row: Row, name: str) -> Row:
        return self._tables_by_name[name].of(row, f"{name}_token")

    def _sensor(self, row: Row) -> Row:
        return self._referenced(self._referenced(row, "calibrated_sensor"), "sensor")

    def _file(self, row: Row) -> Path:
        place = f"row {row.number}: the filename"
        return path_below(self._tables.root, row.get("filename"), row.path, place)

    def _path(self, name: str) -> Path:
        return self._tables.folder / f"{name}.json"


def plain_word(name: str) -> str:
    """Return a name in lower case, with _ for - and spaces."""
    return name.strip().lower().replace("-", "_").replace(" ", "_")


def _lens(camera: Row) -> tuple[float, ...]:
    """Return the coefficients of a distorting lens; empty: there is none."""
    given = camera.entries.get(_DISTORTION)
    if not given:
        return ()
    count = len(given) if isinstance(given, list) else 0
    coefficients = camera.numbers(_DISTORTION, count)
    return tuple(coefficients.tolist()) if coefficients.any() else ()


def _num_points(row: Row) -> int | None:
    """Return the number of points in a box; None: unknown, in Lyft's tables -1, null or missing."""
    value = row.entries.get("num_lidar_pts")
    if value is None or (type(value) in (int, float) and value < 0):
        return None
    return row.whole("num_lidar_pts")
