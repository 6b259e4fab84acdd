"""Calibration file of a recording: YAML or JSON, written by hand or by an import."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from jaxtyping import Float64

from sightline.data.formats.image_header import MAX_PIXELS
from sightline.data.formats.kitti_calibration import CalibrationMatrices
from sightline.data.formats.undistortion import (
    COEFFICIENTS,
    LENS_REMEDY,
    LensModel,
    check_lens,
    is_straight,
    lens_fault,
    lens_model,
    without_filling,
)
from sightline.files.plain_text import read_text, shortened
from sightline.files.plain_yaml import read_yaml
from sightline.files.problem import FileError
from sightline.geometry.mount import camera_fault, has_exchanged_size
from sightline.geometry.road_height import (
    MAX_LIDAR_HEIGHT_M,
    MAX_TILT_DEG,
    MIN_LIDAR_HEIGHT_M,
)
from sightline.geometry.rotations import rotation_fault
from sightline.geometry.tilt import Tilt

_KEYS: Final = (
    "camera_matrix",
    "camera_from_lidar",
    "clouds_from_source",
    "image_size",
    "lens",
    "lidar_height_m",
    "lidar_tilt_deg",
    "max_intensity",
)
_OTHER_FORMATS: Final = {
    "OpenCV": r"^%YAML:1\.0|opencv-matrix|<opencv_storage>",
    "KITTI": r"^(?:P[0-3]|P_rect_0\d|R0_rect|Tr\w*|R|T):",
    "Kalibr": r"^cam\d:",
    "ROS": r"^(?:camera_name|distortion_model|projection_matrix|rectification_matrix):",
}
"""How the files of other formats begin a line."""
_LIMIT = 1e9
_EXCHANGED_RATIO: Final = 1.1  # KITTI's principal points are off the middle by up to 1.09
_REMEDY = "see docs/recordings.md for an example"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Lens:
    """Distorting lens, whose pictures are undistorted when they are read."""

    model: LensModel
    coefficients: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RecordingCalibration:
    """Contents of the calibration file."""

    matrices: CalibrationMatrices
    image_size: tuple[int, int] | None = None
    """Height, width [px]; needed only without images."""
    lens: Lens | None = None
    """Lens; None: the pictures are not distorted."""
    max_intensity: float = 1.0
    """Intensity of a reflectance of 1 in the clouds."""
    lidar_height_m: float | None = None
    """Height of the LiDAR above the road [m]; None: estimated from the clouds."""
    lidar_tilt: Tilt | None = None
    """Tilt of the LiDAR against the road; None: estimated from the clouds."""
    clouds_from_source: Float64[np.ndarray, "3 3"] | None = None
    """Rotation of the clouds against those of the bag that they were imported from; None: none."""


def read_recording_calibration(path: Path | str) -> RecordingCalibration:
    """Read a calibration file in YAML or JSON, which is a subset of YAML.

    Raises:
        FileError: The file is no calibration, lacks a matrix, or contains invalid values.
    """
    try:
        content = read_yaml(path, _REMEDY)
    except FileError:
        _refuse_other_format(path)
        raise
    if not isinstance(content, dict):
        raise FileError(path, "holds no mapping of names to values", _REMEDY)
    unknown = [str(key) for key in content if key not in _KEYS]
    if unknown:
        _refuse_other_format(path)
        raise FileError(
            path,
            f"has the unknown entry {shortened(unknown[0], 40)!r}, expected {', '.join(_KEYS)}",
            _REMEDY,
        )
    try:
        calibration = RecordingCalibration(
            matrices=_matrices(content),
            image_size=_image_size(content.get("image_size")),
            lens=_lens(content.get("lens")),
            max_intensity=_max_intensity(content.get("max_intensity", 1.0)),
            lidar_height_m=_lidar_height(content.get("lidar_height_m")),
            lidar_tilt=_lidar_tilt(content.get("lidar_tilt_deg")),
            clouds_from_source=_clouds_from_source(content),
        )
        require_usable(calibration)
    except ValueError as error:
        raise FileError(path, str(error), _REMEDY) from error
    return calibration


def _refuse_other_format(path: Path | str) -> None:
    """Refuse another program's file by its name, unless it has a recording's extrinsics."""
    text = read_text(path)
    if "camera_from_lidar" in text:
        return
    for program, pattern in _OTHER_FORMATS.items():
        if re.search(pattern, text, re.MULTILINE):
            raise FileError(
                path,
                f"is a calibration in the format of {program}",
                "write its intrinsics as camera_matrix and its extrinsics as camera_from_lidar, "
                "each a list of rows; " + _REMEDY,
            )


def require_usable(
    calibration: RecordingCalibration, image_size: tuple[int, int] | None = None
) -> None:
    """Check a calibration, read or about to be written, by the rules of all readers.

    Args:
        calibration: Calibration of a recording.
        image_size: Height, width [px] of its images. None: the calibration's size, if given.

    Raises:
        ValueError: A matrix or number is invalid, or the lens folds the picture; the message
            continues a sentence about the source.
    """
    camera = calibration.matrices.image_from_camera
    checked_matrices(camera, calibration.matrices.camera_from_lidar)
    _max_intensity(calibration.max_intensity)
    _lidar_height(calibration.lidar_height_m)
    _refuse_exchanged_size(calibration)
    size = image_size or calibration.image_size
    if size is not None:
        _image_size({"height": size[0], "width": size[1]})
    if calibration.lens is not None:
        check_lens(calibration.lens.model, calibration.lens.coefficients)
        if size is not None:
            lens = calibration.lens
            fault = lens_fault(lens.model, lens.coefficients, camera, size)
            if fault is not None:
                raise ValueError(f"lens {fault}; {LENS_REMEDY}")


def _refuse_exchanged_size(calibration: RecordingCalibration) -> None:
    size = calibration.image_size
    camera = calibration.matrices.image_from_camera
    if size is not None and has_exchanged_size(camera, size, max_ratio=_EXCHANGED_RATIO):
        height, width = size
        raise ValueError(
            f"image_size has width {width} and height {height}, but camera_matrix has its "
            f"principal point in the middle of an image {height} wide and {width} high: exchange "
            "width and height, or, if images have this size, turn them as when the camera was "
            "calibrated"
        )


def recording_calibration_text(calibration: RecordingCalibration) -> str:
    """Write the text of a calibration file, exact to the last bit.

    Raises:
        ValueError: Readers would refuse it; see `require_usable`.
    """
    require_usable(calibration)
    camera = calibration.matrices.image_from_camera
    content: dict[str, Any] = {
        "camera_matrix": (camera if camera[:, 3].any() else camera[:, :3]).tolist(),
        "camera_from_lidar": calibration.matrices.camera_from_lidar.tolist(),
    }
    if calibration.image_size is not None:
        height, width = calibration.image_size
        content["image_size"] = {"width": width, "height": height}
    if calibration.lens is not None:
        content["lens"] = {
            "model": calibration.lens.model,
            "coefficients": list(calibration.lens.coefficients),
            "undistort": True,
        }
    if calibration.max_intensity != 1:
        content["max_intensity"] = calibration.max_intensity
    if calibration.lidar_height_m is not None:
        content["lidar_height_m"] = calibration.lidar_height_m
    if calibration.lidar_tilt is not None:
        tilt = calibration.lidar_tilt
        content["lidar_tilt_deg"] = {"roll": tilt.roll_deg, "pitch": tilt.pitch_deg}
    if calibration.clouds_from_source is not None:
        content["clouds_from_source"] = calibration.clouds_from_source.tolist()
    # One line per row, as in a handwritten matrix.
    text: str = yaml.safe_dump(content, default_flow_style=None, sort_keys=False)
    return text


def checked_matrices(
    camera: Float64[np.ndarray, "3 columns"], rigid: Float64[np.ndarray, "rows 4"]
) -> CalibrationMatrices:
    """Check and convert the matrices of a recording's calibration file.

    Args:
        camera: camera_matrix, 3x3 or 3x4 [px].
        rigid: camera_from_lidar, 4x4 or 3x4 [m].

    Raises:
        ValueError: A matrix is invalid; the message continues a sentence about the source.
    """
    for name, matrix in (("camera_matrix", camera), ("camera_from_lidar", rigid)):
        if not (np.abs(matrix) < _LIMIT).all():  # NaN compares false
            raise ValueError(f"{name} holds NaN, infinite or absurdly large values")
    if not camera.any():
        raise ValueError("camera_matrix holds only zeros: the camera is not calibrated")
    fault = camera_fault(camera)
    if fault is not None:
        raise ValueError(f"camera_matrix {fault}")
    if np.linalg.matrix_rank(camera[:, :3]) < 3:
        raise ValueError("camera_matrix is singular in its left 3x3 part, so no pixel has a ray")
    if len(rigid) == 4 and np.abs(rigid[3] - (0, 0, 0, 1)).max() > 1e-9:
        hint = ": it is probably transposed" if not rigid[:3, 3].any() else ""
        raise ValueError(
            f"camera_from_lidar has the last row {rigid[3].tolist()}, expected 0 0 0 1{hint}"
        )
    fault = rotation_fault(rigid[:3, :3])
    if fault is not None:
        raise ValueError(f"camera_from_lidar holds no rotation: {fault}")
    return CalibrationMatrices(
        image_from_camera=np.pad(camera, ((0, 0), (0, 4 - camera.shape[1]))),
        camera_from_lidar=np.vstack((rigid[:3], (0.0, 0.0, 0.0, 1.0))),
    )


def _matrices(content: Mapping[str, object]) -> CalibrationMatrices:
    return checked_matrices(
        _matrix(content, "camera_matrix", ((3, 3), (3, 4))),
        _matrix(content, "camera_from_lidar", ((4, 4), (3, 4))),
    )


def _matrix(
    content: Mapping[str, object], name: str, shapes: tuple[tuple[int, int], ...]
) -> Float64[np.ndarray, "rows columns"]:
    expected = " or ".join(f"{rows}x{columns}" for rows, columns in shapes)
    if name not in content:
        raise ValueError(f"lacks {name}, expected a matrix of {expected}")
    rows = content[name]
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows):
        raise ValueError(f"{name} is invalid, expected a matrix of {expected} numbers")
    values = [[_number(value, name) for value in row] for row in rows]
    if (len(values), *{len(row) for row in values}) not in shapes:
        raise ValueError(f"{name} is invalid, expected a matrix of {expected} numbers")
    return np.array(values, dtype=np.float64)


def _clouds_from_source(content: Mapping[str, object]) -> Float64[np.ndarray, "3 3"] | None:
    if "clouds_from_source" not in content:
        return None
    rotation = _matrix(content, "clouds_from_source", ((3, 3),))
    fault = rotation_fault(rotation)
    if fault is not None:
        raise ValueError(f"clouds_from_source holds no rotation: {fault}")
    return rotation


def _number(value: object, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        quoted = shortened(repr(value), 40)
        raise ValueError(f"{name} holds {quoted}, expected numbers, such as -0.5, without quotes")
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _image_size(value: object) -> tuple[int, int] | None:
    if value is None:
        return None
    if not isinstance(value, dict) or set(value) != {"width", "height"}:
        raise ValueError("image_size is invalid, expected {width: .., height: ..}")
    height, width = value["height"], value["width"]
    if not all(type(each) is int and 0 < each <= MAX_PIXELS for each in (height, width)):
        raise ValueError(
            "image_size is invalid, expected width and height in whole pixels, no quotes"
        )
    if height * width > MAX_PIXELS:
        raise ValueError(f"image_size is {height}x{width}, more than {MAX_PIXELS} pixels")
    return height, width


def _lens(value: object) -> Lens | None:
    """Parse the lens; None: it has no distortion, or the pictures are already undistorted."""
    if value is None:
        return None
    if not isinstance(value, dict) or not {"coefficients"} <= set(value) <= {
        "model",
        "coefficients",
        "undistort",
    }:
        raise ValueError(
            "lens is invalid, expected {model: .., coefficients: [..], undistort: true}"
        )
    if not isinstance(value["coefficients"], list):
        raise ValueError("lens has invalid coefficients, expected a list of numbers")
    coefficients = tuple(_number(each, "lens: coefficients") for each in value["coefficients"])
    name = str(value.get("model", "plumb_bob"))
    if is_straight(name, coefficients):
        return None
    model = lens_model(name, len(coefficients))
    if model is None:
        raise ValueError(
            f"lens has the unknown model {name[:40]!r}, expected one of "
            f"{', '.join(COEFFICIENTS)} (also radtan, equi, fisheye)"
        )
    coefficients = without_filling(model, coefficients)
    check_lens(model, coefficients)
    if value.get("undistort") is not True:
        raise ValueError(
            "lens has distortion, but images must be undistorted: write `undistort: true` beside "
            "the coefficients to undistort images when they are read, or undistort them yourself "
            "and remove the lens"
        )
    return Lens(model=model, coefficients=coefficients)


def _lidar_height(value: object) -> float | None:
    if value is None:
        return None
    height_m = _number(value, "lidar_height_m")
    if not MIN_LIDAR_HEIGHT_M <= height_m <= MAX_LIDAR_HEIGHT_M:
        raise ValueError(
            f"lidar_height_m is {str(value)[:40]}, expected the LiDAR's height above the road, "
            f"{MIN_LIDAR_HEIGHT_M:g} to {MAX_LIDAR_HEIGHT_M:g} m"
        )
    return height_m


def _lidar_tilt(value: object) -> Tilt | None:
    if value is None:
        return None
    given = value if isinstance(value, dict) and set(value) == {"roll", "pitch"} else {}
    angles = {name: _number(angle, "lidar_tilt_deg") for name, angle in given.items()}
    if not angles or not all(abs(angle) <= MAX_TILT_DEG for angle in angles.values()):
        raise ValueError(
            f"lidar_tilt_deg is {str(value)[:60]}, expected {{roll: .., pitch: ..}}, the LiDAR's "
            f"tilt against the road in degrees, each from {-MAX_TILT_DEG:g} to {MAX_TILT_DEG:g}"
        )
    return Tilt(roll_deg=angles["roll"], pitch_deg=angles["pitch"])


def _max_intensity(value: object) -> float:
    intensity = _number(value, "max_intensity")
    if not 0 < intensity < _LIMIT:
        raise ValueError(
            f"max_intensity is {str(value)[:40]}, expected a number above 0, below 1e9"
        )
    return intensity
