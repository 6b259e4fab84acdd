"""Writer of frames and predictions to a file of the Rerun viewer, on a time line."""

import itertools
import os
import shutil
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float64, UInt8
from torch import Tensor

from sightline.data.formats.map_png import MAX_DEPTH_M, STEPS_PER_METRE
from sightline.files.atomic import atomic_path
from sightline.files.extras import import_library
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.calibration import Calibration
from sightline.structures.level import level_view
from sightline.structures.predictions import DepthMap, Detections2D, Detections3D, Perception
from sightline.structures.sample import SENSOR_TITLES, CameraLidarSample
from sightline.visualization.colors import DEPTH_SCALE, class_color
from sightline.visualization.objects import support_marks

if TYPE_CHECKING:
    import rerun

POINTS: Final = "lidar/points"
BOXES_3D: Final = "lidar/boxes"
CAMERA: Final = "lidar/camera"
IMAGE: Final = "lidar/camera/image"
BOXES_2D: Final = "lidar/camera/boxes"
DEPTH: Final = "lidar/camera/depth"
FURTHER: Final = "further"
"""Paths in the file; `lidar` is the LiDAR frame, in metres; pictures of further predictions are
below `further` by their keys."""

FRAME_TIMELINE: Final = "frame"
TIME_TIMELINE: Final = "time"
"""Time lines: the number of the frame, and seconds if the data set has them."""

_THICK_M, _THIN_M = 0.03, 0.01  # radii of the edges of measured and lifted boxes
_JPEG_QUALITY = 85
_MAX_FLUSH_S: Final = 600.0
_BLOCK_BYTES: Final = 2**20
_DISPLAYED_DEPTH_M = (0.0, 80.0)


def check_rerun(path: Path) -> None:
    """Refuse an invalid file of the viewer, before any work.

    Raises:
        ValueError: The name does not end in .rrd, or the library is not installed.
    """
    if path.suffix.lower() != ".rrd":
        raise ValueError(f"{path} cannot be written: expected a name that ends in .rrd")
    _library()


def write_rerun(
    path: Path,
    frames: Iterable[tuple[CameraLidarSample, Perception]],
    *,
    further: Sequence[str] = (),
) -> int:
    """Write a file for `rerun FILE` atomically; return the number of frames.

    Image, depth, points, 2D and 3D boxes and further predictions are at each frame's own time;
    missing parts are cleared, so that nothing of an earlier frame stays on the screen. Joined
    objects replace the detections: their labels have `support_marks`, those of 3D boxes also the
    origin, and the edges of lifted boxes are thin.

    Args:
        path: The file; its name ends in .rrd.
        frames: Frames in order, read one at a time.
        further: Keys of the further predictions to include.

    Raises:
        ValueError: The name ends otherwise, rerun-sdk is not installed, or the disk is full.
    """
    check_rerun(path)
    rr = _library()
    count = 0
    with (
        atomic_path(path) as temporary,
        _recording_to(temporary, further) as (
            recording,
            copier,
        ),
    ):
        recording.log("lidar", rr.ViewCoordinates.FLU, static=True)
        for sample, perception in itertools.starmap(level_view, frames):
            copier.check()
            recording.reset_time()  # so that a frame without a time does not get the previous one's
            recording.set_time(FRAME_TIMELINE, sequence=count)
            if sample.timestamp_s is not None:
                recording.set_time(TIME_TIMELINE, duration=sample.timestamp_s)
            _log_frame(recording, sample, perception, further)
            count += 1
    return count


class _Copier(threading.Thread):
    """Thread that copies a pipe to a file.

    The library writes to the pipe: if it failed to write to a file, it would wait for ever.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(daemon=True)
        self._path = path
        self._fault: OSError | None = None
        self._source, self.sink = os.pipe()

    def run(self) -> None:
        with os.fdopen(self._source, "rb") as pipe:
            try:
                with self._path.open("wb") as file:
                    shutil.copyfileobj(pipe, file)
            except OSError as error:
                self._fault = error
                while pipe.read(_BLOCK_BYTES):  # else the library would wait for a reader
                    pass

    def check(self) -> None:
        """Raise the disk's error, if there was one."""
        if self._fault is not None:
            raise self._fault


@contextmanager
def _recording_to(
    path: Path, further: Sequence[str]
) -> Iterator[tuple["rerun.RecordingStream", _Copier]]:
    """Open a recording to a file, complete if the block ends without an error."""
    rr = _library()
    recording = rr.RecordingStream("sightline")
    recording.set_log_time_enabled(False)  # the time of writing is no useful time line
    copier = _Copier(path)
    copier.start()
    try:
        try:
            recording.save(f"/dev/fd/{copier.sink}", default_blueprint=_blueprint(further))
        finally:
            os.close(copier.sink)  # the library has opened it itself
        yield recording, copier
        recording.flush(timeout_sec=_MAX_FLUSH_S)
    finally:
        recording.disconnect()
        copier.join(_MAX_FLUSH_S)
    copier.check()


def _library() -> ModuleType:
    return import_library("rerun", "viz", package="rerun-sdk")


def _blueprint(further: Sequence[str]) -> "rerun.blueprint.Blueprint":
    """Layout: the image above depth and further predictions, and the scene beside them."""
    import rerun.blueprint as rrb

    flat = (
        rrb.Spatial2DView(origin=CAMERA, name="camera", contents=["$origin/**", f"- {DEPTH}"]),
        rrb.Spatial2DView(origin=CAMERA, name="depth", contents=[DEPTH, BOXES_2D]),
        *(rrb.Spatial2DView(origin=f"{FURTHER}/{key}", name=key) for key in further),
    )
    scene = rrb.Spatial3DView(origin="lidar", name="scene", contents=["$origin/**", f"- {DEPTH}"])
    return rrb.Blueprint(rrb.Horizontal(rrb.Vertical(*flat), scene), collapse_panels=True)


def _log_frame(
    recording: "rerun.RecordingStream",
    sample: CameraLidarSample,
    perception: Perception,
    further: Sequence[str],
) -> None:
    import rerun as rr

    empty = rr.Clear(recursive=False)
    _log_camera(recording, sample)
    image, points = sample.image, sample.points
    recording.log("frame", rr.TextDocument(_description(sample)))
    recording.log(IMAGE, empty if image is None else _image(image.permute(1, 2, 0).numpy()))
    recording.log(POINTS, empty if points is None else _points(points[:, :3].numpy()))
    in_2d, in_3d = _all_boxes(sample, perception)
    recording.log(BOXES_2D, empty if in_2d is None else _boxes_2d(in_2d))
    recording.log(BOXES_3D, empty if in_3d is None else _boxes_3d(in_3d))
    recording.log(DEPTH, empty if perception.depth is None else _depth(perception.depth))
    for key in further:
        each = perception.further.get(key)
        recording.log(f"{FURTHER}/{key}", empty if each is None else _image(each.draw(sample)))


def _description(sample: CameraLidarSample) -> str:
    missing = [SENSOR_TITLES[sensor] for sensor in sample.missing_sensors]
    return f"{sample.sample_id}{''.join(f', no {title}' for title in missing)}"


def _log_camera(recording: "rerun.RecordingStream", sample: CameraLidarSample) -> None:
    """Log the camera's pose for each frame: a calibration may change."""
    import rerun as rr

    matrix, lidar_from_camera = pinhole_of(sample.calibration)
    height, width = sample.image_size
    recording.log(
        CAMERA,
        rr.Transform3D(translation=lidar_from_camera[:3, 3], mat3x3=lidar_from_camera[:3, :3]),
        rr.Pinhole(
            image_from_camera=matrix,
            resolution=(width, height),
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=3.0,
        ),
    )


def pinhole_of(
    calibration: Calibration,
) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "4 4"]]:
    """Camera matrix [px], and the transform from the camera's own frame to the LiDAR frame.

    KITTI's P2 has the offset of camera 0 to camera 2 in its last column; a pinhole has none.
    """
    matrix = calibration.image_from_camera[:, :3]
    offset = torch.linalg.solve(matrix, calibration.image_from_camera[:, 3])
    pinhole_from_lidar = calibration.camera_from_lidar.clone()
    pinhole_from_lidar[:3, 3] += offset
    return matrix.numpy(), torch.linalg.inv(pinhole_from_lidar).numpy()


def _image(pixels: UInt8[np.ndarray, "height width 3"]) -> "rerun.EncodedImage":
    import rerun as rr

    bgr = cv2.cvtColor(np.ascontiguousarray(pixels), cv2.COLOR_RGB2BGR)
    _, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return rr.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg")


def _points(xyz: np.ndarray) -> "rerun.Points3D":
    import rerun as rr

    return rr.Points3D(xyz, colors=DEPTH_SCALE.colors(np.linalg.norm(xyz, axis=1)), radii=0.03)


def _depth(depth: DepthMap) -> "rerun.DepthImage":
    """Shown depth in KITTI's PNG encoding: 0 where there is none or beyond the encoding's range."""
    import rerun as rr

    shown_m = depth.shown_m.numpy(force=True)
    metres = np.where(shown_m <= MAX_DEPTH_M, shown_m, 0)
    steps = np.rint(metres * STEPS_PER_METRE).astype(np.uint16)
    return rr.DepthImage(
        steps, meter=STEPS_PER_METRE, colormap="viridis", depth_range=_displayed_steps()
    )


def _displayed_steps() -> tuple[float, float]:
    nearest_m, farthest_m = _DISPLAYED_DEPTH_M
    return nearest_m * STEPS_PER_METRE, farthest_m * STEPS_PER_METRE


class _Labelled(NamedTuple):
    """Boxes of one kind with their classes and labels."""

    boxes: Float[Tensor, "num_boxes columns"]
    class_names: tuple[str, ...]
    labels: tuple[str, ...]
    radii: tuple[float, ...] | None = None
    """Radii of the edges [m]. None: the viewer's own."""


def _all_boxes(
    sample: CameraLidarSample, perception: Perception
) -> tuple[_Labelled | None, _Labelled | None]:
    """2D and 3D boxes to log; None: not predicted."""
    objects = perception.objects
    if objects is None:
        return _labelled(perception.detections2d), _labelled(perception.detections3d)
    marks = support_marks(objects, sample)
    labels = [
        f"{label} {mark}"
        for label, mark in zip(_labels(objects.class_names, objects.scores), marks, strict=True)
    ]
    origins = objects.origins

    def chosen(boxes: Tensor, mask: Tensor, texts: list[str]) -> _Labelled:
        kept = mask.nonzero()[:, 0].tolist()
        return _Labelled(
            boxes=boxes[kept],
            class_names=tuple(objects.class_names[index] for index in kept),
            labels=tuple(texts[index] for index in kept),
            radii=tuple(_THIN_M if origins[index] == "lifted" else _THICK_M for index in kept),
        )

    in_space = [f"{label} {origin}" for label, origin in zip(labels, origins, strict=True)]
    return (
        chosen(objects.boxes2d.tensor, objects.has_box2d, labels),
        chosen(objects.boxes3d.tensor, objects.has_box3d, in_space),
    )


def _labelled(found: Detections2D | Detections3D | None) -> _Labelled | None:
    if found is None:
        return None
    labels = _labels(found.class_names, found.scores)
    return _Labelled(found.boxes.tensor, found.class_names, labels)


def _boxes_2d(found: _Labelled) -> "rerun.Boxes2D":
    import rerun as rr

    return rr.Boxes2D(
        array=found.boxes.numpy(force=True),
        array_format=rr.Box2DFormat.XYXY,
        colors=[class_color(name) for name in found.class_names],
        labels=found.labels,
    )


def _boxes_3d(found: _Labelled) -> "rerun.Boxes3D":
    import rerun as rr

    upright = (0.0, 0.0, 1.0)
    boxes = Boxes3D(found.boxes)
    return rr.Boxes3D(
        centers=boxes.centers.numpy(force=True),
        half_sizes=boxes.sizes.numpy(force=True) / 2,
        rotation_axis_angles=[
            rr.RotationAxisAngle(axis=upright, radians=yaw) for yaw in boxes.yaws.tolist()
        ],
        colors=[class_color(name) for name in found.class_names],
        labels=found.labels,
        radii=found.radii,
    )


def _labels(class_names: tuple[str, ...], scores: Float[Tensor, " num_boxes"]) -> tuple[str, ...]:
    pairs = zip(class_names, scores.tolist(), strict=True)
    return tuple(f"{name} {score:.2f}" for name, score in pairs)
