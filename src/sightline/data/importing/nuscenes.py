"""nuScenes' tables (Caesar et al. 2020): JSON files of rows that point to each other by tokens."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from sightline.data.importing.frames import Rigid, rigid_from_quaternion
from sightline.data.plain_file import read_bytes
from sightline.data.problem import FileError

_MAX_BYTES: Final = 2**32  # sample_data.json of all of nuScenes has 1.1 GB
_REMEDY: Final = "extract nuScenes' metadata archive again"

Row = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, slots=True)
class Annotation:
    """A labelled object, in the world's frame."""

    category: str
    """E.g. vehicle.car."""
    attributes: frozenset[str]
    """E.g. cycle.with_rider."""
    visibility: int
    """1 to 4: up to 40, 60, 80 and 100 percent are visible in the six cameras; 0 unknown."""
    num_lidar_points: int
    size_lwh: tuple[float, float, float]
    world_from_box: Rigid


@dataclass(frozen=True, kw_only=True, slots=True)
class Moment:
    """A camera's image and a LiDAR's sweep, taken together."""

    name: str
    """The scene's name and the number in it: scene-0061-000."""
    time_s: float
    """Of the sweep."""
    image: Path
    sweep: Path
    image_size: tuple[int, int]
    camera_matrix: tuple[tuple[float, ...], ...]
    camera_from_lidar: Rigid
    """Of the image's and the sweep's own times, between which the car has moved."""
    mount: Rigid
    """camera_from_lidar of a car at rest."""
    lidar_height_m: float
    """Above the road, on which the car's frame stands."""
    world_from_lidar: Rigid
    annotations: tuple[Annotation, ...]


@dataclass(frozen=True, slots=True)
class Tables:
    """The tables of one version of the data set."""

    root: Path
    """The folder with `samples`."""
    folder: Path
    """That of the tables, e.g. v1.0-mini."""

    def moments(self, camera: str, lidar: str) -> Iterator[Moment]:
        """All moments with a key frame of both channels, scene after scene.

        Raises:
            ValueError: A table is missing or damaged, or there is no such channel.
        """
        try:
            yield from _Reader(self).moments(camera, lidar)
        except (KeyError, TypeError) as error:
            raise FileError(
                self.folder,
                f"has a table without the row or entry {error} that another one needs",
                _REMEDY,
            ) from error


def find_tables(source: Path) -> Tables | None:
    """The tables in a folder: those of the folder itself, or of v1.0-mini or the like in it.

    Raises:
        ValueError: There are several versions.
    """
    if (source / "sample.json").is_file():
        return Tables(source.resolve().parent, source)
    found = sorted(path.parent for path in source.glob("v*/sample.json"))
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise ValueError(f"{source} holds several versions: {names}; name the folder of one")
    return Tables(source, found[0]) if found else None


class _Reader:
    def __init__(self, tables: Tables) -> None:
        self._tables = tables
        names = ("calibrated_sensor", "ego_pose", "instance", "category")
        self._by_token = {name: {row["token"]: row for row in self._rows(name)} for name in names}
        self._attributes = {row["token"]: row["name"] for row in self._rows("attribute")}
        self._channels = {row["token"]: row["channel"] for row in self._rows("sensor")}

    def moments(self, camera: str, lidar: str) -> Iterator[Moment]:
        by_sample: dict[str, dict[str, Row]] = {}
        for row in self._rows("sample_data"):
            channel = self._channel(row)
            if row["is_key_frame"] and channel in (camera, lidar):
                by_sample.setdefault(row["sample_token"], {})[channel] = row
        annotations: dict[str, list[Row]] = {}
        for row in self._rows("sample_annotation"):
            annotations.setdefault(row["sample_token"], []).append(row)
        scenes = {row["token"]: row["name"] for row in self._rows("scene")}
        samples = sorted(
            self._rows("sample"), key=lambda row: (scenes[row["scene_token"]], row["timestamp"])
        )
        self._check_channels(by_sample, (camera, lidar))
        if camera == lidar or not any(len(taken) == 2 for taken in by_sample.values()):
            raise ValueError(
                f"{self._tables.folder} has no sample with key frames of {camera} and {lidar}; "
                "name a camera by --camera-topic and a LiDAR by --lidar-topic"
            )
        counts = dict.fromkeys(scenes, 0)
        for sample in samples:
            number = counts[sample["scene_token"]]
            counts[sample["scene_token"]] += 1
            taken = by_sample.get(sample["token"], {})
            if len(taken) == 2:
                name = f"{scenes[sample['scene_token']]}-{number:03}"
                labelled = annotations.get(sample["token"], [])
                yield self._moment(name, taken[camera], taken[lidar], labelled)

    def _moment(self, name: str, image: Row, sweep: Row, labelled: list[Row]) -> Moment:
        ego_from_camera, ego_from_lidar = (self._sensor_pose(row) for row in (image, sweep))
        world_from_camera = self._ego_pose(image) @ ego_from_camera
        world_from_lidar = self._ego_pose(sweep) @ ego_from_lidar
        camera = self._by_token["calibrated_sensor"][image["calibrated_sensor_token"]]
        return Moment(
            name=name,
            time_s=sweep["timestamp"] / 1e6,
            image=self._tables.root / image["filename"],
            sweep=self._tables.root / sweep["filename"],
            image_size=(int(image["height"]), int(image["width"])),
            camera_matrix=tuple(tuple(map(float, row)) for row in camera["camera_intrinsic"]),
            camera_from_lidar=np.linalg.inv(world_from_camera) @ world_from_lidar,
            mount=np.linalg.inv(ego_from_camera) @ ego_from_lidar,
            lidar_height_m=float(ego_from_lidar[2, 3]),
            world_from_lidar=world_from_lidar,
            annotations=tuple(map(self._annotation, labelled)),
        )

    def _annotation(self, row: Row) -> Annotation:
        instance = self._by_token["instance"][row["instance_token"]]
        width, length, height = row["size"]
        visibility = str(row.get("visibility_token", ""))
        return Annotation(
            category=self._by_token["category"][instance["category_token"]]["name"],
            attributes=frozenset(self._attributes[token] for token in row["attribute_tokens"]),
            visibility=int(visibility) if visibility.isdecimal() else 0,
            num_lidar_points=int(row["num_lidar_pts"]),
            size_lwh=(float(length), float(width), float(height)),
            world_from_box=_pose(row),
        )

    def _sensor_pose(self, row: Row) -> Rigid:
        return _pose(self._by_token["calibrated_sensor"][row["calibrated_sensor_token"]])

    def _ego_pose(self, row: Row) -> Rigid:
        return _pose(self._by_token["ego_pose"][row["ego_pose_token"]])

    def _channel(self, row: Row) -> str:
        calibrated = self._by_token["calibrated_sensor"][row["calibrated_sensor_token"]]
        return str(self._channels[calibrated["sensor_token"]])

    def _check_channels(
        self, by_sample: Mapping[str, Mapping[str, Row]], wanted: tuple[str, str]
    ) -> None:
        taken = {channel for each in by_sample.values() for channel in each}
        for channel, option in zip(wanted, ("--camera-topic", "--lidar-topic"), strict=True):
            if channel not in taken:
                known = ", ".join(sorted(set(self._channels.values())))
                raise ValueError(
                    f"{self._tables.folder} has no key frame of the channel {channel}; name one of "
                    f"{known} by {option}"
                )

    def _rows(self, name: str) -> list[Row]:
        path = self._tables.folder / f"{name}.json"
        try:
            rows = json.loads(read_bytes(path, max_bytes=_MAX_BYTES, remedy=_REMEDY))
        except FileError:
            raise
        except (ValueError, RecursionError) as error:
            raise FileError(path, "is no JSON", _REMEDY) from error
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise FileError(path, "is no table: expected a list of rows", _REMEDY)
        return rows


def _pose(row: Row) -> Rigid:
    w, x, y, z = row["rotation"]
    try:
        return rigid_from_quaternion(
            np.array((x, y, z, w), dtype=np.float64), np.array(row["translation"], dtype=np.float64)
        )
    except ValueError as error:
        raise ValueError(f"nuScenes' row {row['token']} {error}") from error
