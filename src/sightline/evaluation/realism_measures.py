"""Measurements on the frames of an object tree; needs no PyTorch."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from sightline.data.formats.image_file import read_rgb
from sightline.data.formats.image_header import read_image_size
from sightline.data.formats.kitti_boxes import box_corners, project_box
from sightline.data.formats.kitti_calibration import CalibrationMatrices, read_object_matrices
from sightline.data.formats.kitti_labels import NO_LOCATION, KittiObjects, read_labels
from sightline.data.formats.pixels import crop_to_view, sparse_depth_map
from sightline.data.formats.velodyne import read_sweep
from sightline.data.layouts.kitti_trees import (
    ObjectFrame,
    Part,
    find_velodyne,
    list_files,
    list_object_frames,
)
from sightline.evaluation.realism_points import FreeCar, Ground, fit_ground, free_cars
from sightline.jobs.progress import track

GRADIENTS: Final = (4, 16, 64)
"""Borders of the bins of grey steps between neighbouring pixels."""

_CROP: Final = (352, 1216)
"""Height and width of the depth benchmark's crop: bottom, centre."""
_DARK: Final = 32
"""Grey level of 255 below which a pixel is in a deep shadow."""


class BoxFit(NamedTuple):
    """Labelled 2D box compared with the projection of its 3D box, clipped to the image."""

    class_name: str
    iou: float
    width_ratio: float
    height_ratio: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Measures:
    """Measurements on a data set."""

    points_in_image: list[int] = field(default_factory=list)
    points_in_sweep: list[int] = field(default_factory=list)
    pixel_shares: list[float] = field(default_factory=list)
    first_rows: list[int] = field(default_factory=list)
    reflectances: list[Float32[np.ndarray, " num_points"]] = field(default_factory=list)
    objects: list[KittiObjects] = field(default_factory=list)
    box_fits: list[BoxFit] = field(default_factory=list)
    """Fits from the measured frames, even if `objects` is from others."""
    cars: list[FreeCar] = field(default_factory=list)
    grounds: list[Ground] = field(default_factory=list)
    brightness: list[float] = field(default_factory=list)
    contrasts: list[float] = field(default_factory=list)
    dark_shares: list[float] = field(default_factory=list)
    """Shares of dark pixels below the horizon."""
    gradients: list[Float64[np.ndarray, " num_bins"]] = field(default_factory=list)


def measure_tree(root: Path, labels: Path | None, max_frames: int | None) -> Measures:
    """Measure an object tree.

    Args:
        root: The folder with `training`.
        labels: Folder of label files to take the objects from instead.
        max_frames: Maximum number of frames, evenly spaced; None: all.

    Raises:
        ValueError: There are no whole frames, or a file cannot be parsed.
    """
    measures = Measures()
    frames = list(_whole_frames(root))
    if not frames:
        raise ValueError(
            f"{root} holds no object tree of KITTI's with whole frames (image, sweep, calibration, "
            "labels); name the folder that has training/ in it"
        )
    for frame in track(_evenly(frames, max_frames), description=f"measuring {root.name}"):
        _measure_frame(frame, measures)
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
    parts: tuple[Part, ...] = ("image", "points", "calibration", "objects", "depth")
    for frame in list_object_frames(folder, parts, find_velodyne(folder)).values():
        if (frame.image or frame.depth) and frame.points and frame.calibration and frame.objects:
            yield frame


def _evenly(frames: Sequence[ObjectFrame], max_frames: int | None) -> list[ObjectFrame]:
    if max_frames is None or max_frames >= len(frames):
        return list(frames)
    return [frames[index * len(frames) // max_frames] for index in range(max_frames)]


def _measure_frame(frame: ObjectFrame, measures: Measures) -> None:
    assert frame.points is not None, f"{frame.sample_id} was chosen without a sweep"
    assert frame.calibration is not None, f"{frame.sample_id} was chosen without a calibration"
    assert frame.objects is not None, f"{frame.sample_id} was chosen without labels"
    points = read_sweep(frame.points)
    matrices, objects = read_object_matrices(frame.calibration), read_labels(frame.objects)
    sized = frame.image or frame.depth
    assert sized is not None, f"{frame.sample_id} was chosen without a picture"
    size = read_image_size(sized)
    _measure_points(points, matrices, size, measures)
    ground = fit_ground(points)
    measures.grounds.extend([ground] if ground else [])
    measures.cars.extend(free_cars(points, matrices, objects))
    measures.box_fits.extend(_box_fits(objects, matrices, size))
    if frame.image is not None:
        horizon = round(float(matrices.image_from_camera[1, 2]))
        _measure_image(read_rgb(frame.image), horizon, measures)
    measures.objects.append(objects)


def _measure_points(
    points: Float32[np.ndarray, "num_points 4"],
    matrices: CalibrationMatrices,
    size: tuple[int, int],
    measures: Measures,
) -> None:
    if (points[:, 0] < 0).any():
        measures.points_in_sweep.append(len(points))
    seen = crop_to_view(points, matrices, size)
    measures.points_in_image.append(len(seen))
    measures.reflectances.append(seen[:, 3])
    height, width = min(_CROP[0], size[0]), min(_CROP[1], size[1])
    left = (size[1] - width) // 2
    hit = sparse_depth_map(seen, matrices, size)[size[0] - height :, left : left + width] > 0
    measures.pixel_shares.append(float(hit.mean()))
    measures.first_rows.extend(np.flatnonzero(hit.any(axis=1))[:1].tolist())


def _box_fits(
    objects: KittiObjects, matrices: CalibrationMatrices, size: tuple[int, int]
) -> Iterator[BoxFit]:
    for index, name in enumerate(objects.class_names):
        location, turn = objects.locations[index], float(objects.rotation_y[index])
        if location[0] == NO_LOCATION:
            continue
        corners = box_corners(location, objects.dimensions_hwl[index], turn)
        box, _ = project_box(corners, matrices.image_from_camera, size)
        sides, labelled = box[2:] - box[:2], objects.boxes2d[index]
        if sides.min() > 0:  # false if no part is in the image
            labelled_sides = labelled[2:] - labelled[:2]
            shared = np.minimum(box, labelled)[2:] - np.maximum(box, labelled)[:2]
            both = float(np.prod(np.clip(shared, 0, None)))
            iou = both / float(np.prod(sides) + np.prod(labelled_sides) - both)
            yield BoxFit(name, iou, *(labelled_sides / sides).tolist())


def _measure_image(
    image: UInt8[np.ndarray, "height width 3"], horizon: int, measures: Measures
) -> None:
    grey = image.mean(axis=2, dtype=np.float32)
    steps = np.hypot(np.diff(grey, axis=1)[:-1], np.diff(grey, axis=0)[:, :-1])
    counts, _ = np.histogram(steps, bins=(0, *GRADIENTS, np.inf))
    measures.brightness.append(float(grey.mean()))
    measures.contrasts.append(float(grey.std()))
    measures.dark_shares.append(float((grey[horizon:] < _DARK).mean()))
    measures.gradients.append(counts / steps.size)
