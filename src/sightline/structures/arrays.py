"""Conversion of users' pictures and point clouds to the tensors of a sample."""

from collections.abc import Sequence
from contextlib import suppress
from typing import Final, SupportsFloat

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64, Shaped, UInt8
from torch import Tensor

from sightline.geometry.arguments import short_repr
from sightline.geometry.calibration import Calibration
from sightline.geometry.cloud_batches import is_batch_of_clouds
from sightline.geometry.cloud_checks import (
    as_point_rows,
    cloud_fault,
    shape_doubt,
    warn_of_columns,
    warn_of_integers,
)
from sightline.geometry.echoes import USUAL_LOSS, echoes, warn_of_losses
from sightline.geometry.given_arrays import given_array
from sightline.geometry.intensity_checks import reflectances, warn_of_intensities
from sightline.geometry.kitti_sizes import kitti_size_doubt
from sightline.geometry.mount import (
    MIN_SHARE_IN_IMAGE,
    mount_doubt,
    off_centre_doubt,
    resolution_doubt,
    size_doubt,
)
from sightline.geometry.picture_checks import GREY_DOUBT
from sightline.geometry.plain_arrays import without_masked
from sightline.geometry.projection import project_points
from sightline.geometry.transforms import transform_points
from sightline.geometry.user_warning import warn_user

_INTENSITY_FIELDS: Final = ("intensity", "reflectivity", "reflectance", "i")
_MAX_LISTED_FIELDS: Final = 12  # in an error message
_OVERSHOOT: Final = 0.25  # of a picture's levels beyond its scale, as by cubic interpolation
_MAX_NORMALISED: Final = 10.0  # magnitude; ImageNet's mean and std give -2.2 to 2.7
_BLACK_LEVEL: Final = 3  # highest level of a normalised picture that was only rounded


def plain_number(name: str, value: SupportsFloat) -> float:
    """Convert a number of any type, including NumPy's and tensors, to a float.

    Raises:
        ValueError: The value is no number.
    """
    if not isinstance(value, str | bytes | bool | np.bool_):
        # RuntimeError: PyTorch raises it for several numbers.
        with suppress(TypeError, ValueError, OverflowError, RuntimeError):
            return float(value)
    raise ValueError(f"{name} is {short_repr(value)}, expected a number; give one")


def image_planes(image: np.ndarray | Tensor) -> UInt8[Tensor, "3 height width"]:
    """Convert a picture to RGB, channels first.

    Args:
        image: 8 bits, colour or grey; an array of height, width (, 3 or 1), or a tensor of
            3, height, width.

    Warns of grey, and of levels from 0 to 3 alone.

    Raises:
        ValueError: The picture has another type or shape.
    """
    plain = given_array("the image", image)
    planes = plain
    if not isinstance(image, Tensor) and plain.ndim in (2, 3):
        planes = plain[None] if plain.ndim == 2 else plain.transpose(2, 0, 1)
        if len(planes) == 1 and plain.dtype == np.uint8:
            planes = np.broadcast_to(planes, (3, *planes.shape[1:]))
            warn_user(GREY_DOUBT)
    if planes.dtype != np.uint8 or planes.ndim != 3 or len(planes) != 3 or not planes.size:
        raise ValueError(
            f"the image is {plain.dtype} of shape {plain.shape}, expected uint8, an array of "
            "height, width, 3 or a tensor of 3, height, width; "
            f"{image_remedy(plain, is_tensor=isinstance(image, Tensor))}"
        )
    warn_of_levels(planes)
    return torch.from_numpy(np.array(planes, order="C"))


def warn_of_levels(image: UInt8[np.ndarray, "..."]) -> None:
    """Warn of a picture with no level above 3, but not of one of zeros alone."""
    brightest = image.max()
    if 0 < brightest <= _BLACK_LEVEL:
        cause = (
            "of shares from 0 to 1; give (255 * image).round() as uint8"
            if brightest == 1
            else "a normalised one; give (255 * (image * std + mean)).round() as uint8"
        )
        warn_user(
            f"the image has no level above {brightest} of 255, which is all but black: before "
            f"rounding it was probably {cause}",
        )


def image_remedy(given: Shaped[np.ndarray, "..."], *, is_tensor: bool = False) -> str:
    """Choose the remedy for an invalid picture: the conversion that makes it valid."""
    height_first = given.ndim == 3 and given.shape[0] in (1, 3, 4) and given.shape[2] > 4
    if given.ndim < 2:
        return "read the file first, e.g. with PIL or OpenCV"
    if given.ndim > 3:
        return "give one picture at a time"
    if not given.size:
        return "it holds no pixel: give a whole picture"
    if given.dtype != np.uint8 and given.dtype.kind == "f":
        return _rounding_remedy(given[np.isfinite(given)], is_tensor=is_tensor)
    if given.dtype != np.uint8:
        return "convert it to RGB of 8 bits"
    if not is_tensor and height_first:
        return "it has channels first: give np.asarray(image).transpose(1, 2, 0)"
    if is_tensor and given.ndim == 3 and given.shape[2] in (1, 3, 4):
        return "it has channels last: give image.permute(2, 0, 1)"
    if given.shape[0 if is_tensor else -1] == 4:
        return "leave its fourth channel out"
    return "convert it to RGB of 8 bits"


def _rounding_remedy(levels: Float[np.ndarray, " num_levels"], *, is_tensor: bool) -> str:
    """Choose the remedy for a picture of float levels: their rounding, scaled if necessary.

    Cubic interpolation exceeds the levels' scale a little; farther below 0 they are normalised.
    """
    darkest, brightest = (levels.min(), levels.max()) if levels.size else (0.0, 0.0)
    if darkest < -_OVERSHOOT * max(brightest, 1):
        shares = "image * std + mean"
        is_small = max(brightest, -darkest) <= _MAX_NORMALISED
        return (
            f"its levels from {darkest:.3g} to {brightest:.3g} are probably normalised: give "
            f"({f'255 * ({shares})' if is_small else shares}).round().clip(0, 255) as uint8 with "
            f"the normalisation's mean and std ({'of shape 3, 1, 1; ' * is_tensor}0.5 and 0.5 for "
            "levels from -1 to 1)"
        )
    scale = "255 * image" if brightest <= 1 + _OVERSHOOT else "image"
    return f"round its levels: ({scale}).round().clip(0, 255) as uint8"


def sweep_points(
    points: np.ndarray | Tensor, max_intensity: SupportsFloat = 1.0
) -> Float32[Tensor, "num_points 4"]:
    """Convert a point cloud to x, y, z [m] and reflectance in [0, 1].

    Rows without an echo are left out: x, y, z are not finite or all zero. Non-finite intensities
    become 0. A warning counts such intensities, and the left-out rows, of an organised cloud (rows
    of rows) only if they are most of it. Intensities above max_intensity, such as of
    retroreflectors, become 1; a warning is given if all intensities are far below it.

    Args:
        points: x, y, z and intensity first, as rows or rows of rows. A missing intensity becomes 0
            and further columns are left out, both with a warning.
        max_intensity: Intensity of a reflectance of 1.

    Raises:
        ValueError: There are fewer than three columns, or several clouds; most points lie beyond
            300 m; an intensity is negative, more than one in a hundred lies above max_intensity, or
            the intensities are ring numbers.
    """
    given = given_array("the points", without_masked(points))
    columns = cloud_columns(given)
    max_intensity = plain_number("max_intensity", max_intensity)
    if not 0 < max_intensity < np.inf:
        raise ValueError(f"max_intensity must be positive, got {max_intensity}; often it is 255")
    if not len(columns):
        warn_user(
            "there are no points: the sample has an empty sweep, in which nothing is detected; "
            "give None if there is no LiDAR",
        )
    # Rays of an organised cloud into the sky have no echo; masked points were chosen by the user.
    has_usual_losses = given.ndim > 2 or isinstance(points, np.ma.MaskedArray)
    warn_of_losses(columns, "the points", usual_share=USUAL_LOSS if has_usual_losses else 0.0)
    columns = echoes(columns)
    fault = cloud_fault(columns, max_intensity)
    if fault is not None:
        problem, remedy = fault
        raise ValueError(f"the cloud has {problem}; {remedy}")
    warn_of_cloud(columns, max_intensity)
    columns[:, 3] = reflectances(columns[:, 3], max_intensity)
    return torch.from_numpy(columns.astype(np.float32))


def warn_of_cloud(columns: Float64[np.ndarray, "num_points 4"], max_intensity: float) -> None:
    """Warn of a cloud of unlikely shape, or of intensities far below the scale."""
    shape = shape_doubt(columns[:, :3])
    if shape is not None:
        warn_user(f"the cloud {shape[0]}; {shape[1]}")
    warn_of_intensities(columns, max_intensity)


def cloud_columns(points: np.ndarray | Tensor) -> Float64[np.ndarray, "num_points 4"]:
    """Extract x, y, z and intensity (0 if missing) unchanged from rows of at least three columns.

    Warns of a missing intensity and of further columns.

    Raises:
        ValueError: There are no such rows, or they are of several clouds.
    """
    plain = points.detach().cpu().numpy() if isinstance(points, Tensor) else np.asarray(points)
    rows = as_point_rows(plain)
    if plain.dtype.names is not None:
        raise ValueError(_structured_array_message(plain.dtype.names))
    if rows is None:
        is_number = plain.dtype.kind in "fiu"
        remedy = "give one row a point" if is_number else "convert them to float32"
        raise ValueError(
            f"the points are {plain.dtype} of shape {plain.shape}, expected numbers in rows of x, "
            f"y, z [m] and perhaps intensity; {remedy}"
        )
    if is_batch_of_clouds(plain):
        raise ValueError(
            f"the points of shape {plain.shape} are {len(plain)} clouds, expected one; give one "
            f"cloud at a time, or points.reshape(-1, {rows.shape[1]}) for parts of one sweep"
        )
    warn_of_columns(rows.shape[1], len(rows))
    warn_of_integers(rows.dtype, len(rows))
    columns = rows[:, :4].astype(np.float64)
    return np.pad(columns, ((0, 0), (0, 4 - columns.shape[1])))


def _structured_array_message(names: Sequence[str]) -> str:
    """Message for a structured array: its fields, and the stack of them that is expected."""
    coordinates = sorted((name for name in names if name.lower() in ("x", "y", "z")), key=str.lower)
    intensity = [name for name in names if name.lower() in _INTENSITY_FIELDS][:1]
    if len(coordinates) != 3:
        coordinates = ["x", "y", "z"]
    expected = ", ".join(map(repr, coordinates + intensity))
    return (
        f"the points are a structured array of fields {', '.join(names[:_MAX_LISTED_FIELDS])}, "
        f"expected numbers in rows; stack them: "
        f"np.stack([points[name] for name in ({expected})], axis=-1)"
    )


def warn_of_view(
    points: Float32[Tensor, "num_points 4"],
    calibration: Calibration,
    image_size: tuple[int, int],
    *,
    camera: str = "camera_matrix",
) -> None:
    """Warn, with the likely cause, if a matrix does not fit the image, or no points fall into it.

    Args:
        points: Points in the LiDAR frame.
        calibration: Calibration given for the points.
        image_size: Height, width [px].
        camera: Name of the argument with the camera's matrix.
    """
    matrix = calibration.image_from_camera.numpy()
    doubt = (
        size_doubt(matrix, image_size)
        or resolution_doubt(matrix, image_size)
        or off_centre_doubt(matrix, image_size)
        or kitti_size_doubt(matrix, image_size)
    )
    if doubt is not None:
        warn_user(f"{camera} {doubt}")
    share = share_in_image(points, calibration, image_size)
    if len(points) and share < MIN_SHARE_IN_IMAGE:
        mount = mount_doubt(calibration.camera_from_lidar.numpy())
        cause = f"check {camera} against the image's size, and that the sweep is of this LiDAR"
        if mount is not None:
            cause = f"camera_from_lidar {mount}"
        elif _share_ahead(points, calibration) < MIN_SHARE_IN_IMAGE:
            cause = (
                "they lie beside or behind the camera: check the rotation of camera_from_lidar, "
                "such as the order of a quaternion's numbers, the axes of the points, and that "
                "the sweep covers this camera's view"
            )
        warn_user(
            f"{100 * share:.2g} % of the {len(points)} points fall into the image of "
            f"{image_size[0]}x{image_size[1]} (height x width): {cause}",
        )


def _share_ahead(points: Float32[Tensor, "num_points 4"], calibration: Calibration) -> float:
    """Share of a sweep's points within 45 degrees of the camera's axis, 0 to 1."""
    x, y, z = transform_points(calibration.camera_from_lidar, points[:, :3]).T
    return float((z > torch.hypot(x, y)).float().mean())


def share_in_image(
    points: Float32[Tensor, "num_points 4"], calibration: Calibration, image_size: tuple[int, int]
) -> float:
    """Share of a sweep's points inside the image, 0 to 1; 0 for an empty sweep."""
    inside = project_points(points[:, :3], calibration).in_image(image_size)
    return float(inside.float().mean()) if len(points) else 0.0
