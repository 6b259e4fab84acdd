"""Undistortion of pictures by OpenCV's lens models."""

import math
import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Final, Literal, SupportsFloat

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from sightline.geometry.given_arrays import given_array, plain_numbers
from sightline.geometry.mount import camera_fault
from sightline.geometry.wrong_types import named_arguments
from sightline.structures.arrays import image_remedy

LensModel = Literal["plumb_bob", "rational_polynomial", "equidistant"]
"""ROS's names of OpenCV's models with 5 or 8 coefficients, and of its fisheye model with 4."""

COEFFICIENTS: Final[dict[LensModel, tuple[int, ...]]] = {
    "plumb_bob": (4, 5),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
}
"""Possible numbers of coefficients of each model."""

_LENS_NAMES: Final[dict[str, LensModel]] = {
    **dict.fromkeys(("plumbbob", "radtan", "radialtangential"), "plumb_bob"),
    "rationalpolynomial": "rational_polynomial",
    **dict.fromkeys(("equidistant", "equi", "fisheye", "kannalabrandt", "kb4"), "equidistant"),
}
"""Names of the models in ROS, OpenCV and Kalibr, lower case, letters and digits alone."""

_STRAIGHT_NAMES: Final = (
    *("none", "pinhole", "perspective"),
    *("brown_conrady", "inverse_brown_conrady", "modified_brown_conrady"),  # of RealSense
)
"""Names of models that do not distort with zeros alone, or at all."""

LENS_REMEDY: Final = (
    "give the coefficients in the order of the model (k1, k2, p1, p2, k3 ..), as calibrated for "
    "this camera matrix"
)
_MIN_FILLED_SHARE = 0.25  # smallest share of the undistorted picture that must be filled
_MAX_COEFFICIENT = 1e6
_MAX_TANGENT = 100.0  # tangent of the farthest ray of a picture: 89 degrees
_GRID = 33  # lines in each direction of the grid for checking the map

_Row = tuple[float, ...]


@named_arguments
def undistort(
    image: np.ndarray,
    camera_matrix: Sequence[Sequence[SupportsFloat]] | np.ndarray,
    distortion: Sequence[SupportsFloat] | np.ndarray,
    *,
    model: LensModel = "plumb_bob",
) -> UInt8[np.ndarray, "height width 3"]:
    """Undistort a picture, so that `camera_matrix` alone describes it; empty pixels are black.

    Examples:
        >>> import numpy as np, sightline
        >>> image = np.zeros((60, 80, 3), np.uint8)
        >>> image[:, 5] = 255  # near the left edge a barrel-shaped lens bends a line
        >>> camera_matrix = [[70, 0, 39.5], [0, 70, 29.5], [0, 0, 1]]
        >>> straight = sightline.undistort(image, camera_matrix, [-0.2, 0.05, 0, 0, 0])
        >>> straight.shape, bool(straight[30, :5].any())  # it has moved outwards
        ((60, 80, 3), True)

    Args:
        image: Height, width, 3; distorted RGB picture of 8 bits.
        camera_matrix: 3x3 [px], for the distorted picture and the result.
        distortion: k1, k2, p1, p2 (, k3 (, k4, k5, k6 ..)), or k1 to k4 of a fisheye lens.
        model: Lens model.

    Raises:
        ValueError: The image or the matrix is invalid, the number of coefficients does not fit the
            model, they are not finite, or fold or lose the picture (see `lens_fault`).
    """
    image = given_array("the image", image)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(
            f"the image is {image.dtype} of shape {image.shape}, expected uint8 of height, width, "
            f"3; {image_remedy(image)}"
        )
    camera = plain_numbers("camera_matrix", camera_matrix)
    if camera.shape not in ((3, 3), (3, 4)) or not np.isfinite(camera).all():
        raise ValueError(
            f"camera_matrix is of shape {camera.shape}, expected 3x3 finite numbers; give [[fx, 0, "
            "cx], [0, fy, cy], [0, 0, 1]] in pixels"
        )
    fault = camera_fault(camera)
    if fault is not None:
        raise ValueError(f"camera_matrix {fault}")
    coefficients = without_filling(model, plain_numbers("distortion", distortion).ravel().tolist())
    check_lens(model, coefficients)
    fault = lens_fault(model, coefficients, camera, (image.shape[0], image.shape[1]))
    if fault is not None:
        raise ValueError(f"the lens {fault}; {LENS_REMEDY}")
    rows = tuple(map(tuple, camera[:, :3].tolist()))
    columns_px, rows_px = _maps(rows, coefficients, model, (image.shape[0], image.shape[1]))
    straight = cv2.remap(image, columns_px, rows_px, cv2.INTER_LINEAR)
    return straight.astype(np.uint8, copy=False)


def is_straight(name: str, coefficients: Sequence[float]) -> bool:
    """Check whether a lens does not distort, by its model's name in ROS, OpenCV or Kalibr."""
    is_known = lens_model(name, len(coefficients)) in ("plumb_bob", "rational_polynomial")
    return (is_known or name.lower() in _STRAIGHT_NAMES) and not any(coefficients)


def lens_model(name: str, num_coefficients: int) -> LensModel | None:
    """Find a lens model by its name in ROS, OpenCV or Kalibr, in any spelling; None: unknown.

    Both polynomials have the same coefficients in the same order: their number tells which it is.
    """
    model = _LENS_NAMES.get(re.sub("[^a-z0-9]", "", name.lower()))
    if model in (None, "equidistant"):
        return model
    polynomials: tuple[LensModel, ...] = ("plumb_bob", "rational_polynomial")
    return next((each for each in polynomials if num_coefficients in COEFFICIENTS[each]), model)


def without_filling(model: LensModel, coefficients: Sequence[float]) -> tuple[float, ...]:
    """Remove zeros behind a model's last coefficient, with which drivers fill longer lists up."""
    last = COEFFICIENTS[model][-1] if model in COEFFICIENTS else len(coefficients)
    return tuple(coefficients if any(coefficients[last:]) else coefficients[:last])


def check_lens(model: LensModel, coefficients: Sequence[float]) -> None:
    """Refuse invalid coefficients of a model.

    Raises:
        ValueError: There is no such model, or the number of coefficients is wrong, or they are not
            finite.
    """
    if model not in COEFFICIENTS:
        raise ValueError(
            f"there is no lens model {model}; give one of {', '.join(COEFFICIENTS)}, or undistort "
            "the pictures yourself"
        )
    is_sound = (np.abs(np.array(coefficients, dtype=np.float64)) <= _MAX_COEFFICIENT).all()
    if len(coefficients) not in COEFFICIENTS[model] or not is_sound:  # NaN compares false
        counts = " or ".join(map(str, COEFFICIENTS[model]))
        raise ValueError(
            f"the lens has {len(coefficients)} distortion coefficients, expected {counts} "
            f"finite numbers for the model {model}, at most {_MAX_COEFFICIENT:g}"
        )


def distorts(model: LensModel, coefficients: Sequence[float]) -> bool:
    """Check whether a lens distorts; an equidistant (fisheye) lens does even with zeros alone."""
    return model == "equidistant" or any(coefficients)


def lens_fault(
    model: LensModel,
    coefficients: Sequence[float],
    camera_matrix: Float64[np.ndarray, "3 columns"],
    size: tuple[int, int],
) -> str | None:
    """Fault of a lens that folds the picture or moves most of it outside; None: valid.

    With a valid lens, pixels farther out in the undistorted picture are farther out in the
    distorted one, everywhere in the image.

    Args:
        model: Model of the coefficients.
        coefficients: Finite coefficients, valid for `check_lens`.
        camera_matrix: 3x3 or 3x4 [px], focal lengths above 0.
        size: Height, width [px].

    Returns:
        The rest of a sentence that begins with the lens.
    """
    if not distorts(model, coefficients):
        return None
    camera = np.ascontiguousarray(camera_matrix[:, :3], dtype=np.float64)
    height, width = size
    columns, rows = np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID))
    pixels = np.stack((columns, rows, np.ones_like(rows)), axis=-1)
    rays = (pixels @ np.linalg.inv(camera).T)[..., :2]
    farthest = float(np.linalg.norm(rays, axis=-1).max())
    if not np.isfinite(farthest) or farthest > _MAX_TANGENT:
        return f"covers {farthest:.4g} focal lengths from the axis in an image of {height}x{width}"
    turn = _first_turn(model, coefficients, farthest)
    moved = _distorted(model, coefficients, camera, rays)
    across, down = np.diff(moved, axis=1)[:-1], np.diff(moved, axis=0)[:, :-1]
    areas = across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0]
    if turn is not None or not (areas > 0).all():
        place = "" if turn is None else f", from {100 * turn / farthest:.0f} % of the way out on"
        return f"folds the picture of {height}x{width} over itself{place}"
    inside = (moved >= 0) & (moved <= (width - 1, height - 1))
    share = float(inside.all(axis=-1).mean())
    if share < _MIN_FILLED_SHARE:
        return (
            f"fills only {100 * share:.0f} % of the picture of {height}x{width}, the rest is black"
        )
    return None


def _first_turn(model: LensModel, coefficients: Sequence[float], farthest: float) -> float | None:
    """Distance [focal lengths] below `farthest` at which the radial part starts to decrease."""
    radial = list(coefficients)
    if model != "equidistant":  # k1, k2, p1, p2, k3, then the denominator's coefficients
        radial = [*radial[:2], *radial[4:5]]
    numerator, denominator = np.polynomial.Polynomial([0.0, 1.0]), np.polynomial.Polynomial([1.0])
    for power, value in enumerate(radial, start=1):
        numerator += value * np.polynomial.Polynomial([0.0] * (2 * power + 1) + [1.0])
    for power, value in enumerate(coefficients[5:8] if model != "equidistant" else (), start=1):
        denominator += value * np.polynomial.Polynomial([0.0] * (2 * power) + [1.0])
    slope = numerator.deriv() * denominator - numerator * denominator.deriv()
    limit = math.atan(farthest) if model == "equidistant" else farthest
    roots = np.concatenate([_real_roots(slope), _real_roots(denominator)])
    within = roots[(roots > 0) & (roots <= limit)]
    if not len(within):
        return None
    first = float(within.min())
    return math.tan(first) if model == "equidistant" else first


def _real_roots(polynomial: np.polynomial.Polynomial) -> Float64[np.ndarray, " num_roots"]:
    roots = polynomial.trim().roots()
    real: Float64[np.ndarray, " num_roots"] = roots[np.abs(np.imag(roots)) < 1e-9].real
    return real


def _distorted(
    model: LensModel,
    coefficients: Sequence[float],
    camera: Float64[np.ndarray, "3 3"],
    rays: Float64[np.ndarray, "rows columns 2"],
) -> Float64[np.ndarray, "rows columns 2"]:
    """Pixels in the distorted picture of rays in the undistorted one."""
    lens = np.array(coefficients)
    flat = rays.reshape(-1, 1, 2)
    if model == "equidistant":
        angles = np.arctan(np.linalg.norm(flat, axis=-1, keepdims=True))
        scale = np.where(angles > 0, angles / np.maximum(np.tan(angles), 1e-12), 1.0)
        powers = angles ** np.array([2, 4, 6, 8])
        bent = flat * scale * (1 + (powers * lens).sum(axis=-1, keepdims=True))
        moved = bent * np.diag(camera)[:2] + camera[:2, 2]
    else:
        points = np.concatenate((flat, np.ones_like(flat[..., :1])), axis=-1)
        moved, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera, lens)
    shaped: Float64[np.ndarray, "rows columns 2"] = np.nan_to_num(moved, nan=-1.0).reshape(
        rays.shape
    )
    return shaped


@lru_cache(maxsize=8)
def _maps(
    camera_matrix: tuple[_Row, ...], coefficients: _Row, model: LensModel, size: tuple[int, int]
) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
    """Maps of each result pixel's position in the distorted picture: column and row [px]."""
    camera, lens = np.array(camera_matrix), np.array(coefficients)
    make = (
        cv2.fisheye.initUndistortRectifyMap
        if model == "equidistant"
        else cv2.initUndistortRectifyMap
    )
    columns_px, rows_px = make(camera, lens, np.eye(3), camera, size[::-1], cv2.CV_32FC1)
    return np.asarray(columns_px, np.float32), np.asarray(rows_px, np.float32)
