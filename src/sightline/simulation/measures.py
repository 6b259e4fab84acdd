"""What there is to measure in the frames of an object tree; needs no PyTorch."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from sightline.data.calibration_text import CalibrationMatrices, read_object_matrices
from sightline.data.image_file import read_rgb
from sightline.data.kitti_labels import KittiObjects, read_labels
from sightline.data.object_tree import (
    ObjectFrame,
    Part,
    Velodyne,
    list_files,
    list_object_frames,
)
from sightline.data.progress import track
from sightline.data.velodyne import read_sweep

GRADIENTS: Final = (4, 16, 64)
"""Between these steps of grey from pixel to pixel, pixels are counted."""

_CROP: Final = (352, 1216)
"""Height and width of the depth benchmark's crop: bottom, centre."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Measures:
    """What was seen of a data set."""

    points_in_image: list[int] = field(default_factory=list)
    points_in_sweep: list[int] = field(default_factory=list)
    pixel_shares: list[float] = field(default_factory=list)
    first_rows: list[float] = field(default_factory=list)
    reflectances: list[Float32[np.ndarray, " num_points"]] = field(default_factory=list)
    objects: list[KittiObjects] = field(default_factory=list)
    car_distances_m: list[float] = field(default_factory=list)
    car_points: list[int] = field(default_factory=list)
    """Of each car that is not truncated or hidden."""
    brightness: list[float] = field(default_factory=list)
    contrasts: list[float] = field(default_factory=list)
    gradients: list[Float64[np.ndarray, " num_bins"]] = field(default_factory=list)


def measure_tree(root: Path, labels: Path | None, max_frames: int | None) -> Measures:
    """Looks through an object tree.

    Args:
        root: The folder with `training`.
        labels: Takes the objects from this folder of label files instead.
        max_frames: Looks at so many frames, evenly taken; None: all.

    Raises:
        ValueError: There are no whole frames, or a file cannot be understood.
    """
    measures = Measures()
    frames = list(_whole_frames(root))
    if not frames:
        raise ValueError(
            f"{root} holds no frames with image, sweep, calibration and labels, expected KITTI's "
            "object tree; name the folder that has training/ in it"
        )
    for frame in track(_evenly(frames, max_frames), description=f"measuring {root.name}"):
        _look_at_frame(frame, measures)
    full_sweeps = list_files(root / "full_sweeps", (".bin",))
    measures.points_in_sweep.extend(len(read_sweep(path)) for path in full_sweeps.values())
    if labels is not None:
        files = list_files(labels, (".txt",)).values()
        measures.objects[:] = [read_labels(path) for path in files]
        if not measures.objects:
            raise ValueError(f"{labels} holds no label files; name a folder label_2")
    return measures


def _whole_frames(root: Path) -> Iterator[ObjectFrame]:
    folder = root / "training"
    has_whole_sweeps = (folder / "velodyne").is_dir()
    velodyne: Velodyne = "velodyne" if has_whole_sweeps else "velodyne_reduced"
    parts: tuple[Part, ...] = ("image", "points", "calibration", "objects")
    for frame in list_object_frames(folder, parts, velodyne).values():
        if frame.image and frame.points and frame.calibration and frame.objects:
            yield frame


def _evenly(frames: Sequence[ObjectFrame], max_frames: int | None) -> list[ObjectFrame]:
    if max_frames is None or max_frames >= len(frames):
        return list(frames)
    return [frames[index * len(frames) // max_frames] for index in range(max_frames)]


def _look_at_frame(frame: ObjectFrame, measures: Measures) -> None:
    assert frame.image is not None, f"{frame.sample_id} was chosen without an image"
    assert frame.points is not None, f"{frame.sample_id} was chosen without a sweep"
    assert frame.calibration is not None, f"{frame.sample_id} was chosen without a calibration"
    assert frame.objects is not None, f"{frame.sample_id} was chosen without labels"
    image, points = read_rgb(frame.image), read_sweep(frame.points)
    matrices, objects = read_object_matrices(frame.calibration), read_labels(frame.objects)
    _look_at_points(points, matrices, (image.shape[0], image.shape[1]), measures)
    _look_at_cars(points, matrices, objects, measures)
    _look_at_image(image, measures)
    measures.objects.append(objects)


def _look_at_points(
    points: Float32[np.ndarray, "num_points 4"],
    matrices: CalibrationMatrices,
    size: tuple[int, int],
    measures: Measures,
) -> None:
    if (points[:, 0] < 0).any():
        measures.points_in_sweep.append(len(points))
    image_from_lidar = matrices.image_from_camera @ matrices.camera_from_lidar
    homogeneous = points[:, :3] @ image_from_lidar[:, :3].T + image_from_lidar[:, 3]
    depth = np.where(homogeneous[:, 2] > 0, homogeneous[:, 2], np.nan)
    x, y = homogeneous[:, 0] / depth, homogeneous[:, 1] / depth
    inside = (x >= -0.5) & (x < size[1] - 0.5) & (y >= -0.5) & (y < size[0] - 0.5)
    measures.points_in_image.append(int(inside.sum()))
    measures.reflectances.append(points[inside, 3])
    height, width = min(_CROP[0], size[0]), min(_CROP[1], size[1])
    columns = np.floor(x[inside] + 0.5).astype(int) - (size[1] - width) // 2
    rows = np.floor(y[inside] + 0.5).astype(int) - (size[0] - height)
    hit = np.zeros((height, width), dtype=bool)
    in_crop = (columns >= 0) & (columns < width) & (rows >= 0)
    hit[rows[in_crop], columns[in_crop]] = True
    measures.pixel_shares.append(float(hit.mean()))
    if in_crop.any():
        measures.first_rows.append(float(rows[in_crop].min()))


def _look_at_cars(
    points: Float32[np.ndarray, "num_points 4"],
    matrices: CalibrationMatrices,
    objects: KittiObjects,
    measures: Measures,
) -> None:
    ahead = points[points[:, 0] > 0, :3]
    in_camera = ahead @ matrices.camera_from_lidar[:3, :3].T + matrices.camera_from_lidar[:3, 3]
    for index, name in enumerate(objects.class_names):
        if name == "Car" and objects.occlusion[index] == 0 and objects.truncation[index] <= 0:
            location = objects.locations[index]
            inside = _inside(
                in_camera - location, objects.dimensions_hwl[index], objects.rotation_y[index]
            )
            measures.car_distances_m.append(float(np.hypot(location[0], location[2])))
            measures.car_points.append(inside)


def _inside(
    from_bottom: Float64[np.ndarray, "num_points 3"],
    size_hwl: Float64[np.ndarray, "3"],
    rotation_y: float,
) -> int:
    """How many points lie in a box, given from the centre of its bottom in the camera frame."""
    cos, sin = np.cos(rotation_y), np.sin(rotation_y)
    along = cos * from_bottom[:, 0] - sin * from_bottom[:, 2]
    across = sin * from_bottom[:, 0] + cos * from_bottom[:, 2]
    height, width, length = size_hwl
    inside = (np.abs(along) <= length / 2) & (np.abs(across) <= width / 2)
    inside &= (from_bottom[:, 1] <= 0) & (from_bottom[:, 1] >= -height)
    return int(inside.sum())


def _look_at_image(image: UInt8[np.ndarray, "height width 3"], measures: Measures) -> None:
    grey = image.mean(axis=2, dtype=np.float32)
    steps = np.hypot(np.diff(grey, axis=1)[:-1], np.diff(grey, axis=0)[:, :-1])
    counts, _ = np.histogram(steps, bins=(0, *GRADIENTS, np.inf))
    measures.brightness.append(float(grey.mean()))
    measures.contrasts.append(float(grey.std()))
    measures.gradients.append(counts / steps.size)
