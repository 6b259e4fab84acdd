"""Projection of LiDAR points to pixels, and back."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Float32, Int64
from torch import Tensor

from sightline.geometry.arguments import plain_size, wrong_type
from sightline.geometry.calibration import Calibration, plain_calibration
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.transforms import rigid_inverse, transform_points
from sightline.geometry.wrong_types import named_arguments

# Kim et al. 2018, Eq. 1-3: far end of each channel of a DHI image.
DHI_RANGE_M = 80.0
DHI_HEIGHT_M = 6.0
DHI_REFLECTANCE = 0.7
_MAX_FIELDS = 16  # of a point: a sweep of fewer rows and more columns is transposed


class ProjectedPoints(NamedTuple):
    """Projected points in the image.

    Pixel (0, 0) is the centre of the top-left pixel. Points that are not in front of the camera
    have no pixel: NaN.
    """

    pixels: Float[Tensor, "*batch num_points 2"]
    """x, y [px]."""
    depths: Float[Tensor, "*batch num_points"]
    """Metres along the camera's optical axis; not positive behind it."""

    def in_image(self, image_size: tuple[int, int]) -> Bool[Tensor, "*batch num_points"]:
        """Mask of the points on a pixel of an image of (height, width)."""
        height, width = image_size
        x, y = self.pixels.unbind(dim=-1)
        # NaN fails the comparison, so it is outside.
        return (x >= -0.5) & (x < width - 0.5) & (y >= -0.5) & (y < height - 0.5)


@named_arguments
def project_points(
    points: Float[Tensor, "*batch num_points 3"], calibration: Calibration
) -> ProjectedPoints:
    """Project LiDAR points [m] to pixels and depths, in float64; results have the points' dtype.

    Those of whole numbers are float64.

    Examples:
        >>> import sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> sample = sightline.open_dataset(PACKAGED_FRAMES)[0]
        >>> projected = sightline.project_points(sample.points[:, :3], sample.calibration)
        >>> float(projected.in_image(sample.image_size).float().mean()) > 0.99  # cut to it
        True

    Raises:
        TypeError: The points are no tensor, or the calibration is none.
        ValueError: The points have other columns.
    """
    _check_given(points, calibration, 3, exactly=True)
    homogeneous = transform_points(calibration.image_from_lidar, points.double())
    depths = homogeneous[..., 2]
    in_front = torch.where(depths > 0, depths, torch.nan)
    pixels = homogeneous[..., :2] / in_front[..., None]
    dtype = points.dtype if points.is_floating_point() else torch.float64
    return ProjectedPoints(pixels.to(dtype), depths.to(dtype))


def unproject_pixels(
    pixels: Float[Tensor, "*batch num_points 2"],
    depths: Float[Tensor, "*batch num_points"],
    calibration: Calibration,
) -> Float[Tensor, "*batch num_points 3"]:
    """Compute LiDAR-frame points [m] of pixels with depth [m]: the inverse of `project_points`.

    They have the pixels' dtype; those of whole numbers are float64.
    """
    scaled = torch.cat((pixels.double(), torch.ones_like(pixels[..., :1]).double()), dim=-1)
    scaled = scaled * depths.double()[..., None]
    offset = calibration.image_from_camera[..., None, :, 3]
    intrinsics = calibration.image_from_camera[..., :3]
    in_camera = torch.linalg.solve(intrinsics, (scaled - offset).transpose(-1, -2))
    lidar_from_camera = rigid_inverse(calibration.camera_from_lidar)
    points = transform_points(lidar_from_camera, in_camera.transpose(-1, -2))
    return points.to(pixels.dtype) if pixels.is_floating_point() else points


@named_arguments
def sparse_depth_map(
    points: Float[Tensor, "num_points fields"],
    calibration: Calibration,
    image_size: tuple[int, int],
) -> Float32[Tensor, "height width"]:
    """Project a sweep (x, y, z first [m]) to a depth map [m] of (height, width); 0 = no point.

    Where several points fall on one pixel the nearest stays.

    Examples:
        >>> import sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> sample = sightline.open_dataset(PACKAGED_FRAMES)[0]
        >>> size = sample.image_size
        >>> sparse = sightline.sparse_depth_map(sample.points, sample.calibration, size)
        >>> sparse.shape == size, 0.01 < float((sparse > 0).float().mean()) < 0.1
        (True, True)

    Raises:
        TypeError: The points are no tensor, or the calibration is none.
        ValueError: The points lack coordinates, or no image is of such a size.
    """
    _check_given(points, calibration, 3)
    height, width = image_size = plain_size("image_size", image_size)
    flat, depths, _ = _visible(points, calibration, image_size)
    nearest = torch.full((height * width,), torch.inf, device=points.device)
    nearest.scatter_reduce_(0, flat, depths.float(), "amin")
    return torch.where(nearest.isfinite(), nearest, 0.0).reshape(height, width)


def _check_given(
    points: object, calibration: object, columns: int, *, exactly: bool = False
) -> None:
    """Check the types and columns of given points and calibration."""
    plain_calibration(calibration)
    if not isinstance(points, Tensor):
        expected = "a tensor; give torch.from_numpy(array), or sample.points"
        raise wrong_type("points", points, expected)
    num_rows, width = points.shape[-2:] if points.ndim > 1 else (0, 0)
    is_transposed = num_rows < _MAX_FIELDS < width
    is_batch = points.ndim > 2 and not exactly
    if width < columns or (exactly and width != columns) or is_transposed or is_batch:
        rows = "points.mT" if is_transposed else f"points[..., :{columns}]"
        remedy = "give one sweep after another" if is_batch else f"give one row per point: {rows}"
        raise ValueError(
            f"points have shape {tuple(points.shape)}, expected num_points, {columns}"
            f"{'' if exactly else ' or more'}; {remedy}"
        )


def dhi_image(
    points: Float[Tensor, "num_points 4"],
    calibration: Calibration,
    image_size: tuple[int, int],
    *,
    height_offset_m: float = KITTI_LIDAR_HEIGHT_M,
    range_m: float = DHI_RANGE_M,
) -> Float32[Tensor, "3 height width"]:
    """Image of a sweep's depth, height and intensity in [0, 255]: Kim et al. 2018, Eq. 1-4.

    Channels fall from 255 to 0 with the distance x over 80 m, the height over 6 m and the
    reflectance over 0.7. Pixels without a point are 0 in all channels; the nearest of several
    points on a pixel stays, the first in the sweep at equal depth. The 2D detectors' input `lidar`
    is this image divided by 255, in [0, 1].

    Departure: the paper uses z directly, which is negative for nearly all road users; here
    `height_offset_m` (the LiDAR's height above the road; 0 as in the paper) is added first and the
    sum is clipped to [0, 6] m. Another `range_m` than 80 suits an image of another scale: see
    `detection2d.views`.
    """
    height, width = image_size
    flat, depths, kept = _visible(points, calibration, image_size)
    ahead = points[kept, 0] > 0
    flat, depths, kept = flat[ahead], depths[ahead], kept[ahead]
    nearest = _nearest_per_pixel(flat, depths, height * width)
    x, _, z, reflectance = points[kept[nearest]].unbind(dim=-1)
    shares = torch.stack(
        (
            x / range_m,
            (z + height_offset_m) / DHI_HEIGHT_M,
            reflectance / DHI_REFLECTANCE,
        )
    )
    image = torch.zeros(3, height * width, device=points.device)
    image[:, flat[nearest]] = (255 * (1 - shares.clamp(0, 1))).float()
    return image.reshape(3, height, width)


def _visible(
    points: Float[Tensor, "num_points fields"],
    calibration: Calibration,
    image_size: tuple[int, int],
) -> tuple[Int64[Tensor, " visible"], Float[Tensor, " visible"], Int64[Tensor, " visible"]]:
    """Flat pixel index, depth and index in the sweep of the points inside the image."""
    projected = project_points(points[:, :3].double(), calibration)
    kept = projected.in_image(image_size).nonzero()[:, 0]
    column, row = (projected.pixels[kept] + 0.5).floor().long().unbind(dim=-1)
    return row * image_size[1] + column, projected.depths[kept], kept


def _nearest_per_pixel(
    flat: Int64[Tensor, " visible"], depths: Float[Tensor, " visible"], num_pixels: int
) -> Int64[Tensor, " occupied"]:
    """Positions in `flat` of the nearest point of each occupied pixel, the first on ties."""
    nearest = torch.full((num_pixels,), torch.inf, dtype=depths.dtype, device=depths.device)
    nearest.scatter_reduce_(0, flat, depths, "amin")
    order = torch.arange(len(flat), device=flat.device)
    candidates = depths == nearest[flat]
    first = torch.full((num_pixels,), len(flat), device=flat.device)
    first.scatter_reduce_(0, flat[candidates], order[candidates], "amin")
    return first[first < len(flat)]
