"""Projection into the image in numpy, for checks and the creation of frames without PyTorch.

PyTorch alone needs half a gigabyte per worker process. Tests compare these functions with the
functions of the same name in `sightline.geometry`.
"""

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from sightline.data.formats.kitti_calibration import CalibrationMatrices


def is_in_view(
    points: Float[np.ndarray, "num_points fields"],
    image_from_lidar: Float64[np.ndarray, "3 4"],
    image_size: tuple[int, int],
) -> Bool[np.ndarray, " num_points"]:
    """Mask of the points in KITTI's reduced sweeps, exact on its own files.

    For six frames with whole and reduced sweeps it keeps exactly the same points. It is not the
    image's area, whose first pixel starts at -0.5: the crop begins at the centres of the first
    pixels and ends half a pixel beyond the last ones.

    Args:
        points: Points in the LiDAR frame, x, y, z first [m].
        image_from_lidar: Projection of a `Calibration`.
        image_size: Height and width [px].

    Returns:
        Mask of the points in front of the camera, with 0 <= x < width and 0 <= y < height [px].
        False for NaN.
    """
    height, width = image_size
    homogeneous = points[:, :3].astype(np.float64) @ image_from_lidar[:, :3].T
    homogeneous += image_from_lidar[:, 3]
    depth = np.where(homogeneous[:, 2] > 0, homogeneous[:, 2], np.nan)
    x, y = homogeneous[:, 0] / depth, homogeneous[:, 1] / depth
    # NaN, for points without a pixel, compares false.
    shown: Bool[np.ndarray, " num_points"] = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    return shown


def resized_and_cropped(
    calibration: CalibrationMatrices, scale: float, x_min: int, y_min: int
) -> CalibrationMatrices:
    """Adapt a calibration to a resized image, cropped so that (x_min, y_min) becomes (0, 0)."""
    offset_px = (scale - 1) / 2  # pixels are squares around their centres
    resize = np.array([[scale, 0.0, offset_px], [0.0, scale, offset_px], [0.0, 0.0, 1.0]])
    crop = np.array([[1.0, 0.0, -x_min], [0.0, 1.0, -y_min], [0.0, 0.0, 1.0]])
    return CalibrationMatrices(
        image_from_camera=crop @ (resize @ calibration.image_from_camera),
        camera_from_lidar=calibration.camera_from_lidar,
    )


def image_from_lidar(calibration: CalibrationMatrices) -> Float64[np.ndarray, "3 4"]:
    """Homogeneous matrix from LiDAR metres to pixels."""
    projection: Float64[np.ndarray, "3 4"] = (
        calibration.image_from_camera @ calibration.camera_from_lidar
    )
    return projection


def project_points(
    points: Float32[np.ndarray, "num_points 4"], calibration: CalibrationMatrices
) -> tuple[Float64[np.ndarray, "num_points 2"], Float64[np.ndarray, " num_points"]]:
    """Project a sweep to pixels (x, y; NaN behind the camera) and depths [m]."""
    projection = image_from_lidar(calibration)
    homogeneous = points[:, :3].astype(np.float64) @ projection[:, :3].T + projection[:, 3]
    depths = homogeneous[:, 2]
    in_front = np.where(depths > 0, depths, np.nan)
    return homogeneous[:, :2] / in_front[:, None], depths


def in_image(
    pixels: Float[np.ndarray, "num_points 2"], image_size: tuple[int, int]
) -> Bool[np.ndarray, " num_points"]:
    """Mask of the positions (x, y) inside an image of (height, width)."""
    height, width = image_size
    x, y = pixels.T
    # In this form NaN is outside: its comparisons are false.
    inside: Bool[np.ndarray, " num_points"] = (x >= -0.5) & (x < width - 0.5)
    inside &= (y >= -0.5) & (y < height - 0.5)
    return inside


def crop_to_view(
    points: Float32[np.ndarray, "num_points 4"],
    calibration: CalibrationMatrices,
    image_size: tuple[int, int],
) -> Float32[np.ndarray, "num_left 4"]:
    """Crop a sweep to KITTI's "reduced" sweep: the points in `is_in_view`."""
    cropped: Float32[np.ndarray, "num_left 4"] = points[
        is_in_view(points, image_from_lidar(calibration), image_size)
    ]
    return cropped


def unproject_pixels(
    pixels: Float64[np.ndarray, "num_points 2"],
    depths: Float64[np.ndarray, " num_points"],
    calibration: CalibrationMatrices,
) -> Float64[np.ndarray, "num_points 3"]:
    """Unproject pixels with depths [m] to points in the LiDAR frame [m]."""
    scaled = np.column_stack((pixels, np.ones(len(pixels)))) * depths[:, None]
    offset = calibration.image_from_camera[:, 3]
    in_camera = np.linalg.solve(calibration.image_from_camera[:, :3], (scaled - offset).T).T
    rotation = calibration.camera_from_lidar[:3, :3]
    lidar_position = -(rotation.T @ calibration.camera_from_lidar[:3, 3])
    points: Float64[np.ndarray, "num_points 3"] = in_camera @ rotation + lidar_position
    return points


def sparse_depth_map(
    points: Float32[np.ndarray, "num_points 4"],
    calibration: CalibrationMatrices,
    image_size: tuple[int, int],
) -> Float32[np.ndarray, "height width"]:
    """Project a sweep to a depth map [m] of (height, width): nearest point per pixel, 0 = none."""
    pixels, depths = project_points(points, calibration)
    kept = in_image(pixels, image_size)
    columns, rows = np.floor(pixels[kept] + 0.5).astype(np.int64).T
    nearest = np.full(image_size, np.inf, np.float32)
    np.minimum.at(nearest, (rows, columns), depths[kept].astype(np.float32))
    nearest[np.isinf(nearest)] = 0
    return nearest


def wrap_angle(angle: Float64[np.ndarray, " num_angles"]) -> Float64[np.ndarray, " num_angles"]:
    """Wrap an angle [rad] to [-pi, pi)."""
    wrapped = np.remainder(angle + np.pi, 2 * np.pi) - np.pi
    # Rounding of the sum: an angle just below -pi would become +pi, which is outside the range.
    return np.where(wrapped >= np.pi, -np.pi, wrapped)
