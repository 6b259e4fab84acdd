"""Augmentation of samples for training and for tests of robustness.

Each function returns a new sample and documents the changed parts; other parts stay unchanged. The
same functions are used in training (with random arguments) and for the tables of robustness (with
fixed ones).
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float32, Int64, UInt8
from torch import Tensor

from sightline.data.formats.kitti_labels import NO_ALPHA
from sightline.data.formats.pixels import is_in_view
from sightline.data.formats.rings import rings_of_any_order
from sightline.geometry.arguments import plain_size
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.calibration import Calibration
from sightline.geometry.ranges import check_range
from sightline.geometry.transforms import rotation_about_axes, wrap_angle
from sightline.geometry.wrong_types import named_arguments
from sightline.structures.labels import ObjectLabels
from sightline.structures.sample import CameraLidarSample


@named_arguments
def points_in_view(sample: CameraLidarSample) -> Bool[Tensor, " num_points"]:
    """Mask of the points that KITTI's reduced sweeps would keep; see `is_in_view`.

    Raises:
        ValueError: The sample has no sweep.
    """
    image_from_lidar = sample.calibration.image_from_lidar.numpy()
    return torch.from_numpy(
        is_in_view(sweep_of(sample).numpy(), image_from_lidar, sample.image_size)
    )


@named_arguments
def keep_rings(
    sample: CameraLidarSample, rings: Int64[Tensor, " num_points"], kept: Iterable[int]
) -> CameraLidarSample:
    """Keep only the points of some rings, given the ring number of each point.

    Raises:
        ValueError: The sample has no sweep.
    """
    return replace(sample, points=sweep_of(sample)[torch.isin(rings, torch.tensor(list(kept)))])


@named_arguments
def thin_rings(sample: CameraLidarSample, keep_every: int, first: int = 0) -> CameraLidarSample:
    """Simulate a sensor with fewer beams: keep ring `first` and every `keep_every`th after it.

    Points outside the camera's view are removed first and the rest is numbered as for the
    held-out-rings tables (`rings_of_any_order`), so the result is the same for full sweeps and for
    KITTI's reduced ones. Call it before `mirror`, which reverses the order used to find rings.

    Raises:
        ValueError: The sample has no sweep, its rings are unknown, or `first` is not below
            `keep_every`.
    """
    if not 0 <= first < keep_every:
        raise ValueError(
            f"first must be at least 0 and below keep_every, which is {keep_every}; got {first}"
        )
    in_view = replace(sample, points=sweep_of(sample)[points_in_view(sample)])
    try:
        rings = torch.from_numpy(rings_of_any_order(sweep_of(in_view).numpy())[0])
    except ValueError as error:
        raise ValueError(f"sample {sample.sample_id}: {error}") from error
    num_rings = int(rings.max()) + 1 if len(rings) else 0  # 128, of some sensors
    return keep_rings(in_view, rings, range(first, num_rings, keep_every))


@named_arguments
def rotate_extrinsics(
    sample: CameraLidarSample, yaw_deg: float, pitch_deg: float = 0.0, roll_deg: float = 0.0
) -> CameraLidarSample:
    """Rotate the LiDAR in its mount without a change of the calibration.

    Points rotate about the LiDAR's own x (roll), then y (pitch), then z (yaw), each
    counter-clockwise seen from the axis's tip. Depth and labels stay: they are the truth, from
    which the points now deviate.

    Raises:
        ValueError: The sample has no sweep.
    """
    points = sweep_of(sample).clone()
    turned = points[:, :3].double() @ rotation_about_axes(yaw_deg, pitch_deg, roll_deg).T
    points[:, :3] = turned.float()
    return replace(sample, points=points)


@named_arguments
def drop_camera(sample: CameraLidarSample) -> CameraLidarSample:
    """Remove the image. Labels stay: the objects are still there."""
    return replace(sample, image=None)


@named_arguments
def add_outliers(
    sample: CameraLidarSample,
    share: float,
    rng: np.random.Generator,
    *,
    nearest_m: float = 1.5,
    farthest_m: float = 80.0,
) -> CameraLidarSample:
    """Add false echoes: move a share of the returns to random ranges along their rays.

    Exactly the rounded share of the returns is drawn, without preference; ranges [m] are uniform.
    Rays start at the LiDAR's origin, so ring numbers and azimuths stay. A return at the origin has
    no ray and stays unchanged.

    Raises:
        ValueError: The sample has no sweep, or `share` is not in [0, 1].
    """
    if not 0 <= share <= 1:
        raise ValueError(f"share must be between 0 and 1, got {share}")
    points = sweep_of(sample).clone()
    chosen = torch.from_numpy(
        rng.choice(len(points), size=round(share * len(points)), replace=False)
    )
    ranges_m = torch.from_numpy(rng.uniform(nearest_m, farthest_m, size=len(chosen)))
    rays = points[chosen, :3].double()
    lengths_m = rays.norm(dim=1)
    scales = torch.where(lengths_m > 0, ranges_m / lengths_m, 1.0)
    points[chosen, :3] = (rays * scales[:, None]).float()
    return replace(sample, points=points)


@named_arguments
def mirror(sample: CameraLidarSample) -> CameraLidarSample:
    """Mirror the scene left to right, including sensors and drive.

    Image, depth, points, calibration, pose and labels in 2D and 3D stay consistent: the mirrored
    points project to the mirrored pixels with the same depths (a point on the border of two pixels
    may project to the other). Mirroring twice restores the sample. The order of the points stays,
    so it is no longer KITTI's.
    """
    width = sample.image_size[1]
    pose, level_from_lidar = sample.world_from_lidar, sample.level_from_lidar
    lidar_flip = torch.diag(torch.tensor([1.0, -1.0, 1.0, 1.0], dtype=torch.float64))
    return replace(
        sample,
        calibration=_mirrored_calibration(sample.calibration, width),
        image=None if sample.image is None else sample.image.flip(-1),
        depth=None if sample.depth is None else sample.depth.flip(-1),
        points=None
        if sample.points is None
        else sample.points * sample.points.new_tensor([1, -1, 1, 1]),
        objects=None if sample.objects is None else _mirrored_objects(sample.objects, width),
        world_from_lidar=None if pose is None else lidar_flip @ pose @ lidar_flip,
        level_from_lidar=None
        if level_from_lidar is None
        else lidar_flip @ level_from_lidar @ lidar_flip,
    )


@named_arguments
def crop(
    sample: CameraLidarSample, top: int, left: int, height: int, width: int
) -> CameraLidarSample:
    """Crop the image to a region [px].

    Image, depth and calibration are cropped, as views of the same memory; the sweep stays complete.
    2D boxes are clipped, and labels outside the region are removed, as in KITTI. Truncation, if
    known, grows by the removed share of the box; occlusion stays, although its share in the region
    may differ.

    Raises:
        ValueError: The region is not inside the image.
    """
    full_height, full_width = sample.image_size
    is_inside = 0 <= top < top + height <= full_height and 0 <= left < left + width <= full_width
    if not is_inside:
        raise ValueError(
            f"the crop of {height}x{width} at row {top}, column {left} does not lie within sample "
            f"{sample.sample_id}, whose image is {full_height}x{full_width} (height x width)"
        )
    window = (..., slice(top, top + height), slice(left, left + width))
    return replace(
        sample,
        calibration=sample.calibration.crop(left, top),
        image_size=plain_size("the crop", (height, width)),
        image=None if sample.image is None else sample.image[window],
        depth=None if sample.depth is None else sample.depth[window],
        objects=None
        if sample.objects is None
        else _cropped_objects(sample.objects, top, left, (height, width)),
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class ColorJitterConfig:
    """Range x of each colour change: factors are drawn from [1 / (1 + x), 1 + x], uniform in log.

    So as many images get darker as lighter; 0 disables a change.
    """

    brightness: float = 0.3
    """Factor on all values."""
    contrast: float = 0.3
    """Factor on the distance to the image's mean level."""
    gamma: float = 0.3
    """Exponent of the values in [0, 1]."""
    saturation: float = 0.3
    """Factor on the distance to grey."""
    hue_deg: float = 0.0
    """Largest turn of the hue [deg], uniform in both directions: 180 makes any colour of any."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name in ("brightness", "contrast", "gamma", "saturation"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise ValueError(f"{name} must be finite and not negative, got {value}")
        check_range("hue_deg", self.hue_deg, 0, 180)


@named_arguments
def jitter_color(
    sample: CameraLidarSample,
    rng: np.random.Generator,
    config: ColorJitterConfig = ColorJitterConfig(),
) -> CameraLidarSample:
    """Change the image's colours: gamma, contrast, brightness, saturation, hue, in this order.

    Draws the same number of random numbers with and without an image.
    """
    spreads = (config.brightness, config.contrast, config.gamma, config.saturation)
    brightness, contrast, gamma, saturation = (
        math.exp(rng.uniform(-1, 1) * math.log1p(spread)) for spread in spreads
    )
    hue_deg = rng.uniform(-1, 1) * config.hue_deg if config.hue_deg else 0.0
    if sample.image is None:
        return sample
    image = sample.image.numpy()
    mean_level = float(image.mean() / 255) ** gamma
    curve = (np.arange(256) / 255) ** gamma
    curve = brightness * ((curve - mean_level) * contrast + mean_level)
    table = np.rint(255 * curve.clip(0, 1)).astype(np.uint8)
    flat = np.ascontiguousarray(image).reshape(len(image), -1)
    planes = cv2.LUT(flat, table).reshape(image.shape)
    planes = _saturate(planes, saturation)
    if hue_deg:
        planes = _turn_hue(planes, hue_deg)
    return replace(sample, image=torch.from_numpy(planes))


def _turn_hue(
    planes: UInt8[np.ndarray, "3 height width"], turn_deg: float
) -> UInt8[np.ndarray, "3 height width"]:
    hue, saturation, value = cv2.split(cv2.cvtColor(cv2.merge(list(planes)), cv2.COLOR_RGB2HSV))
    half_degrees = 180  # OpenCV's hues of 8 bits are half degrees
    turned = (hue.astype(np.int16) + round(turn_deg / 2)) % half_degrees
    image = cv2.merge([turned.astype(np.uint8), saturation, value])
    return np.stack(cv2.split(cv2.cvtColor(image, cv2.COLOR_HSV2RGB)))


def _saturate(
    planes: UInt8[np.ndarray, "3 height width"], factor: float
) -> UInt8[np.ndarray, "3 height width"]:
    grey = cv2.cvtColor(cv2.merge(list(planes)), cv2.COLOR_RGB2GRAY)
    return np.stack([cv2.addWeighted(plane, factor, grey, 1 - factor, 0) for plane in planes])


@named_arguments
def sweep_of(sample: CameraLidarSample) -> Float32[Tensor, "num_points 4"]:
    """Return the points of a sample.

    Raises:
        ValueError: The sample has no sweep.
    """
    if sample.points is None:
        raise ValueError(
            f"sample {sample.sample_id} has no sweep to change; give it points or leave out this "
            "step"
        )
    return sample.points


def _mirrored_calibration(calibration: Calibration, width: int) -> Calibration:
    """Flip camera and LiDAR along their left-right axes, and the image about its centre."""
    camera_flip = calibration.camera_from_lidar.new_tensor([-1, 1, 1, 1]).diag()
    lidar_flip = calibration.camera_from_lidar.new_tensor([1, -1, 1, 1]).diag()
    pixel_flip = calibration.image_from_camera.new_tensor(
        [[-1, 0, width - 1], [0, 1, 0], [0, 0, 1]]
    )
    return Calibration(
        image_from_camera=pixel_flip @ calibration.image_from_camera @ camera_flip,
        camera_from_lidar=camera_flip @ calibration.camera_from_lidar @ lidar_flip,
    )


def _cropped_objects(
    objects: ObjectLabels, top: int, left: int, size: tuple[int, int]
) -> ObjectLabels:
    moved = Boxes2D(objects.boxes2d.tensor - objects.boxes2d.tensor.new_tensor([left, top] * 2))
    boxes2d = moved.clip(size)
    left_over = boxes2d.area() / moved.area().clamp(min=1e-9)
    truncation = torch.where(
        objects.truncation >= 0, 1 - (1 - objects.truncation) * left_over, objects.truncation
    )
    cut = replace(objects, boxes2d=boxes2d, truncation=truncation)
    return cut.select(boxes2d.area() > 0)


def _mirrored_objects(objects: ObjectLabels, width: int) -> ObjectLabels:
    x_min, y_min, x_max, y_max = objects.boxes2d.tensor.unbind(dim=-1)
    boxes3d = objects.boxes3d.tensor.clone()
    boxes3d[:, 1] *= -1
    boxes3d[:, 6] = torch.where(objects.has_box3d, wrap_angle(-boxes3d[:, 6]), boxes3d[:, 6])
    # Bearings change their sign and rotation_y becomes pi - rotation_y; so their difference does,
    # too.
    alpha = torch.where(
        objects.alpha == NO_ALPHA, objects.alpha, wrap_angle(math.pi - objects.alpha)
    )
    return replace(
        objects,
        boxes2d=Boxes2D(torch.stack((width - 1 - x_max, y_min, width - 1 - x_min, y_max), dim=-1)),
        boxes3d=Boxes3D(boxes3d),
        alpha=alpha,
    )
