"""nuScenes' key frames of a camera and the LiDAR, written as a recording with labels."""

from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float32

from sightline.data.atomic import atomic_link
from sightline.data.calibration_text import CalibrationMatrices
from sightline.data.image_header import read_image_size
from sightline.data.importing.nuscenes import Moment, Tables
from sightline.data.importing.nuscenes_labels import kitti_from_annotations
from sightline.data.importing.writer import (
    RESULTS,
    ImportReport,
    describe_view,
    names_present,
    turned,
    write_calibration,
    write_cloud,
    write_times,
)
from sightline.data.jobs import claim_folder, data_name
from sightline.data.kitti_labels import write_objects
from sightline.data.plain_file import read_bytes
from sightline.data.point_files import checked_cloud
from sightline.data.problem import FileError
from sightline.data.progress import track
from sightline.data.recording_calibration import RecordingCalibration
from sightline.data.recording_tree import CALIBRATIONS, IMAGES, LABELS, POINTS
from sightline.geometry.mount import turn_ahead

_POINT_BYTES: Final = 20  # float32 x, y, z, intensity, ring
_MAX_BYTES: Final = 2**26
_REMEDY: Final = "extract nuScenes' archive again"


def import_nuscenes(
    tables: Tables, out: Path, *, camera: str, lidar: str, max_intensity: float
) -> ImportReport:
    """Imports key frames; arguments and errors as of `import_recording`."""
    listed = list(tables.moments(camera, lidar))
    moments = [each for each in listed if each.image.is_file() and each.sweep.is_file()]
    if not moments:
        raise ValueError(
            f"{tables.root} lacks the files of all {len(listed)} key frames of {camera} and "
            f"{lidar}, {listed[0].image} for one; extract the archives with {camera} there"
        )
    settings = {
        "sightline": version("sightline"),
        "source": data_name(tables.folder),
        "camera": camera,
        "lidar": lidar,
        "max_intensity": max_intensity,
    }
    claim_folder(out, settings, results=RESULTS)
    write_times(out, {moment.name: moment.time_s for moment in moments})
    present = names_present(out, CALIBRATIONS, IMAGES, LABELS, POINTS)
    pending = [moment for moment in moments if moment.name not in present]
    work = _Frames(out, max_intensity)
    for moment in track(pending, description="importing"):
        work.write(moment)
    turns = {round(turn_ahead(moment.mount)[1]) for moment in moments} - {0}
    notes = [f"{len(moments)} key frames of {camera} and {lidar}, {tables.folder.name}"]
    if len(moments) < len(listed):
        notes.append(
            f"dropped {len(listed) - len(moments)} of {len(listed)} key frames, whose image or "
            "sweep is not there"
        )
    notes += [
        f"clouds are turned by {-turn} degrees, so that x points where {camera} looks"
        for turn in sorted(turns)
    ]
    return ImportReport(
        out=out,
        written=len(pending),
        skipped=len(moments) - len(pending),
        notes=(*notes, *describe_view(out)),
    )


@dataclass(frozen=True, slots=True)
class _Frames:
    """Writes the files of a moment; the cloud last, so that what is whole can be told."""

    out: Path
    max_intensity: float

    def write(self, moment: Moment) -> None:
        new_from_old, _ = turn_ahead(moment.mount)
        calibration = turned(_calibration(moment), new_from_old)
        size = read_image_size(moment.image)
        if size != moment.image_size:
            raise FileError(
                moment.image,
                f"is {size[0]}x{size[1]} (height x width), expected {moment.image_size[0]}x"
                f"{moment.image_size[1]} as its table says",
                _REMEDY,
            )
        lidar_from_world = new_from_old @ np.linalg.inv(moment.world_from_lidar)
        objects = kitti_from_annotations(
            moment.annotations, calibration.matrices, lidar_from_world, size
        )
        write_calibration(self.out, calibration, moment.name)
        write_objects(self.out / LABELS / f"{moment.name}.txt", objects)
        suffix = moment.image.suffix
        atomic_link(self.out / IMAGES / f"{moment.name}{suffix}", moment.image)
        points = _read_sweep(moment.sweep)
        points = checked_cloud(points, self.max_intensity, moment.sweep)
        write_cloud(self.out, moment.name, points, new_from_old)


def _calibration(moment: Moment) -> RecordingCalibration:
    camera = np.array(moment.camera_matrix)
    if camera.shape != (3, 3):
        raise ValueError(f"{moment.image} has no camera matrix of 3x3; name a camera's channel")
    return RecordingCalibration(
        matrices=CalibrationMatrices(
            image_from_camera=np.pad(camera, ((0, 0), (0, 1))),
            camera_from_lidar=moment.camera_from_lidar,
        ),
        lidar_height_m=moment.lidar_height_m,
    )


def _read_sweep(path: Path) -> Float32[np.ndarray, "num_points 4"]:
    content = read_bytes(path, max_bytes=_MAX_BYTES, remedy=_REMEDY)
    if len(content) % _POINT_BYTES:
        problem = f"holds {len(content)} bytes, expected a multiple of {_POINT_BYTES}"
        raise FileError(path, f"{problem} (float32 x, y, z, intensity, ring)", _REMEDY)
    return np.frombuffer(content, "<f4").reshape(-1, 5)[:, :4].astype(np.float32)
