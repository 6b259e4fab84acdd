"""Cars and patches cut from real and simulated frames, for `benchmarks.sim_or_real`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64, Int64, UInt8
from numpy import ndarray
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.projection import project_points
from sightline.structures.sample import CameraLidarSample

PATCH_PX = 64
MIN_POINTS = 20
FARTHEST_M = 50.0

_MARGIN_M = 0.1  # labels are drawn by hand
_GROUND_M = 0.15  # labels cut the ground at different heights: lower points are dropped
_SMALLEST_PX = 24  # a car's patch that is smaller would show the enlargement
_MATCH_DISTANCE = 0.1  # of the logarithm, costs as much as
_MATCH_ANGLE = math.radians(10)
_OTHER_OCCLUSION = 4.0
# Corners of plain patches from the principal point [px]: below the horizon, inside every size of
# KITTI's images.
_PLACES_X, _PLACES_Y = (-580, 520), (0, 120)


@dataclass(frozen=True, kw_only=True, slots=True)
class CarCrop:
    """Car: its points in the frame of its box, and its image patch."""

    frame: int
    points: Float[Tensor, "num_points 4"]
    """x, y [m] from the centre, z [m] from the bottom, reflectance; in the file's order."""
    ranges_m: Float[Tensor, " num_points"]
    azimuths: Float[Tensor, " num_points"]
    """From the sensor [rad]."""
    size_lwh: Float[Tensor, "3"]
    patch: UInt8[Tensor, "3 size size"] | None
    """None where it would be too small."""
    distance_m: float
    view_angle: float
    """The car's heading from the line of sight [rad]."""
    occlusion: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Frames:
    """Cars and plain patches of one side's frames."""

    num_frames: int
    cars: tuple[CarCrop, ...]
    patches: UInt8[Tensor, "num_patches 3 size size"]
    """Patches: the same number for each frame, at the same places on both sides."""


def cut_frames(
    root: Path, sample_list: str | None, patches_per_frame: int, max_frames: int | None = None
) -> Frames:
    """Read an object tree.

    Raises:
        ValueError: There are no frames, or one lacks a part.
    """
    whole = (root / "training" / "velodyne").is_dir()
    velodyne: Velodyne = "velodyne" if whole else "velodyne_reduced"
    dataset = KittiObjectDataset(root, sample_list=sample_list, velodyne=velodyne)
    count = len(dataset) if max_frames is None else min(max_frames, len(dataset))
    cars: list[CarCrop] = []
    patches = []
    for frame in range(count):
        sample = dataset[frame]
        cars += _cars(frame, sample)
        patches.append(_plain_patches(frame, sample, patches_per_frame))
    return Frames(num_frames=count, cars=tuple(cars), patches=torch.cat(patches))


def match(real: Sequence[CarCrop], simulated: Sequence[CarCrop]) -> list[tuple[int, int]]:
    """Pair each real car with another simulated one of similar distance, view and occlusion."""
    places = [_pose(cars) for cars in (real, simulated)]
    distance, angle, occlusion = (
        places[0][:, None, column] - places[1][None, :, column] for column in range(3)
    )
    turn = (angle + math.pi) % (2 * math.pi) - math.pi
    cost = (distance / _MATCH_DISTANCE) ** 2 + (turn / _MATCH_ANGLE) ** 2
    rows, columns = linear_sum_assignment(cost + _OTHER_OCCLUSION * (occlusion != 0))
    return list(zip(rows.tolist(), columns.tolist(), strict=True))


def _pose(cars: Sequence[CarCrop]) -> Float64[ndarray, "num_cars 3"]:
    return np.array([(math.log(car.distance_m), car.view_angle, car.occlusion) for car in cars])


def _cars(frame: int, sample: CameraLidarSample) -> list[CarCrop]:
    assert sample.points is not None, f"{sample.sample_id} was read without its sweep"
    assert sample.objects is not None, f"{sample.sample_id} was read without its labels"
    seen = project_points(sample.points[:, :3], sample.calibration).in_image(sample.image_size)
    points, objects = sample.points[seen], sample.objects
    crops = []
    for row, name in enumerate(objects.class_names):
        clear = int(objects.occlusion[row]) <= 1 and float(objects.truncation[row]) <= 0
        if name == "Car" and clear and bool(objects.has_box3d[row]):
            crop = _car(frame, sample, points, objects.boxes3d[row : row + 1], row)
            if len(crop.points) >= MIN_POINTS and crop.distance_m < FARTHEST_M:
                crops.append(crop)
    return crops


def _car(
    frame: int,
    sample: CameraLidarSample,
    points: Float32[Tensor, "num_points 4"],
    box: Boxes3D,
    row: int,
) -> CarCrop:
    assert sample.objects is not None, f"{sample.sample_id} was read without its labels"
    x, y = box.centers[0, :2].tolist()
    height_m = float(box.sizes[0, 2])
    in_box = box.to_canonical(points[:, :3].double())[0]
    in_box[:, 2] += height_m / 2
    inside = box.enlarge(_MARGIN_M).contain(points[:, :3].double())[0] & (in_box[:, 2] > _GROUND_M)
    kept = points[inside].double()
    return CarCrop(
        frame=frame,
        points=torch.cat((in_box[inside], kept[:, 3:]), dim=1).float(),
        ranges_m=kept[:, :3].norm(dim=1),
        azimuths=torch.atan2(kept[:, 1], kept[:, 0]),
        size_lwh=box.sizes[0].float(),
        patch=_car_patch(sample, box),
        distance_m=math.hypot(x, y),
        view_angle=float(box.yaws[0]) - math.atan2(y, x),
        occlusion=int(sample.objects.occlusion[row]),
    )


def _car_patch(
    sample: CameraLidarSample, box: Boxes3D
) -> UInt8[Tensor, "3 {PATCH_PX} {PATCH_PX}"] | None:
    """Cut and resize the square around the projected 3D box; 2D boxes may follow another rule."""
    assert sample.image is not None, f"{sample.sample_id} was read without its image"
    pixels = project_points(box.corners()[0], sample.calibration).pixels
    low, high = pixels.amin(dim=0), pixels.amax(dim=0)
    limit = float(min(sample.image_size))
    size = round(min(1.1 * float((high - low).amax()), limit))
    if size < _SMALLEST_PX:
        return None
    corner = ((low + high - size) / 2).round().long().clamp(min=0)
    x = min(int(corner[0]), sample.image_size[1] - size)
    y = min(int(corner[1]), sample.image_size[0] - size)
    cut = sample.image[None, :, y : y + size, x : x + size].float()
    patch = torch.nn.functional.interpolate(
        cut, (PATCH_PX, PATCH_PX), mode="bilinear", antialias=True
    )
    return patch[0].round().clamp(0, 255).to(torch.uint8)


def _plain_patches(
    frame: int, sample: CameraLidarSample, count: int
) -> UInt8[Tensor, "{count} 3 {PATCH_PX} {PATCH_PX}"]:
    assert sample.image is not None, f"{sample.sample_id} was read without its image"
    center_x, center_y = sample.calibration.image_from_camera[:2, 2].round().long().tolist()
    patches = []
    for x, y in _places(frame, count).tolist():
        top, left = center_y + y, center_x + x
        patches.append(sample.image[:, top : top + PATCH_PX, left : left + PATCH_PX])
    return torch.stack(patches)


def _places(frame: int, count: int) -> Int64[ndarray, "{count} 2"]:
    """Draw the patches' places, the same for frame N of either side."""
    rng = np.random.default_rng(frame)
    return np.column_stack((rng.integers(*_PLACES_X, count), rng.integers(*_PLACES_Y, count)))
