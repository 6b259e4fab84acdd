"""Pictures and point clouds as users have them, made into what a sample holds."""

import warnings

import numpy as np
import torch
from jaxtyping import Float32, UInt8
from torch import Tensor

from sightline.geometry.calibration import Calibration
from sightline.geometry.mount import MAX_RANGE_M, mount_doubt
from sightline.geometry.projection import project_points

_LEAST_SHARE = 0.01  # of the points that an image shows, where both look the same way


def image_planes(image: np.ndarray | Tensor) -> UInt8[Tensor, "3 height width"]:
    """A picture as RGB, channels first.

    Args:
        image: 8 bits; an array of height, width (, 3), or a tensor of 3, height, width.

    Raises:
        ValueError: It is something else.
    """
    planes = image if isinstance(image, Tensor) else torch.from_numpy(np.array(image, order="C"))
    if not isinstance(image, Tensor) and planes.ndim == 2:
        planes = planes[..., None].expand(-1, -1, 3)
    if not isinstance(image, Tensor) and planes.ndim == 3:
        planes = planes.permute(2, 0, 1)
    if planes.dtype != torch.uint8 or planes.ndim != 3 or len(planes) != 3:
        raise ValueError(
            f"the image is {image.dtype} of shape {tuple(image.shape)}, expected uint8, an array "
            "of height, width, 3 or a tensor of 3, height, width; convert it to RGB of 8 bits"
        )
    return planes.cpu().contiguous()


def sweep_points(
    points: np.ndarray | Tensor, max_intensity: float = 1.0
) -> Float32[Tensor, "num_points 4"]:
    """A cloud as x, y, z [m] and reflectance in [0, 1]; rows that are not finite are left out.

    Args:
        points: x, y, z and, if it is known, intensity first.
        max_intensity: What stands for a reflectance of 1.

    Raises:
        ValueError: There are fewer than three columns, most points lie beyond 300 m, or
            intensities outside [0, max_intensity].
    """
    plain = points.detach().cpu().numpy() if isinstance(points, Tensor) else np.asarray(points)
    if plain.ndim != 2 or plain.shape[1] < 3 or plain.dtype.kind not in "fiu":
        raise ValueError(
            f"the points are {plain.dtype} of shape {plain.shape}, expected numbers in rows of x, "
            "y, z [m] and perhaps intensity; give one row a point"
        )
    if not 0 < max_intensity < np.inf:
        raise ValueError(f"max_intensity must be positive, got {max_intensity}; often it is 255")
    columns = plain[:, :4].astype(np.float64)
    columns = columns[np.isfinite(columns).all(axis=1)]
    if columns.shape[1] == 3:
        columns = np.pad(columns, ((0, 0), (0, 1)))
    _check_metres(columns[:, :3])
    lowest, highest = (columns[:, 3].min(), columns[:, 3].max()) if len(columns) else (0.0, 0.0)
    if lowest < 0 or highest > max_intensity:
        raise ValueError(
            f"the points have intensities from {lowest:.4g} to {highest:.4g}, expected 0 to "
            f"{max_intensity:.6g}; set max_intensity to what stands for a reflectance of 1 (255?)"
        )
    columns[:, 3] /= max_intensity
    return torch.from_numpy(columns.astype(np.float32))


def warn_of_view(
    points: Float32[Tensor, "num_points 4"], calibration: Calibration, image_size: tuple[int, int]
) -> None:
    """Warns, with the likely cause, where hardly a point falls into the image."""
    share = share_in_image(points, calibration, image_size)
    if len(points) and share < _LEAST_SHARE:
        doubt = mount_doubt(calibration.camera_from_lidar.numpy())
        cause = (
            f"camera_from_lidar {doubt}"
            if doubt is not None
            else "check camera_matrix against the image's size, and that the sweep is of this LiDAR"
        )
        warnings.warn(
            f"{100 * share:.2g} % of the {len(points)} points fall into the image of "
            f"{image_size[0]}x{image_size[1]} (height x width): {cause}",
            stacklevel=3,
        )


def share_in_image(
    points: Float32[Tensor, "num_points 4"], calibration: Calibration, image_size: tuple[int, int]
) -> float:
    """Which share of a sweep's points the image shows, 0 to 1; 0 of an empty sweep."""
    shown = project_points(points[:, :3], calibration).in_image(image_size)
    return float(shown.float().mean()) if len(points) else 0.0


def _check_metres(places: np.ndarray) -> None:
    ranges_m = np.linalg.norm(places, axis=1)
    if len(ranges_m) and np.median(ranges_m) > MAX_RANGE_M:
        raise ValueError(
            f"half of the points lie farther away than {np.median(ranges_m):.4g} m, expected up to "
            f"{MAX_RANGE_M:.0f} m: they are probably in millimetres; give metres"
        )
