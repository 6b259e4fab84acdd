"""Whether a camera and a LiDAR can be as they are said to be, and the likely mistake where not.

Without PyTorch, for checks that start at once.
"""

import math
from typing import Final

import numpy as np
from jaxtyping import Float64

MAX_OFFSET_M: Final = 20.0
"""Between two sensors on the longest lorry."""

MAX_RANGE_M: Final = 300.0
"""Beyond every LiDAR on the road; a sweep in millimetres is far beyond."""

LEAST_SHARE_IN_IMAGE: Final = 0.01
"""Of a sweep's points, where camera and LiDAR look the same way."""

_HANDFUL, _HANDFUL_SHARE = 20, 0.05  # points in the image, of a sweep that has many more
_MAX_TILT_DEG = 25.0  # of the camera's vertical against the LiDAR's
_MAX_ASIDE_DEG = 60.0  # of the view against the LiDAR's x axis
_AHEAD_DEG = 5.0  # what is left of any mount that is meant to look ahead
_SWAPPED_DEG = 15.0  # off axes that are only swapped
_SMALL_TURN_DEG = 5.0  # what 90 degrees become that are written in radians: 1.6
_IDENTITY_DEG = 0.01
_OTHER_RESOLUTION = 1.35  # between the image's middle and the principal point, alike in x and y
_ALIKE = 1.2
_LIDAR_DIRECTIONS = ("forward", "left", "up")
_OPPOSITE = {"forward": "backward", "left": "right", "up": "down"}


def mount_doubt(camera_from_lidar: Float64[np.ndarray, "4 4"]) -> str | None:
    """What makes a transform doubtful, with the likely cause; None where nothing does.

    Expected is what conventions say: LiDAR x forward, y left, z up; camera x right, y down,
    z forward; so that both agree on what is up, and the camera looks ahead.

    Returns:
        The rest of a sentence that begins with the transform's name.
    """
    offset_m = float(np.linalg.norm(camera_from_lidar[:3, 3]))
    if offset_m > MAX_OFFSET_M:
        return (
            f"puts the LiDAR {offset_m:.4g} m from the camera, expected up to {MAX_OFFSET_M:.0f} "
            "m: its last column is probably in millimetres; give metres"
        )
    rotation = camera_from_lidar[:3, :3]
    if _tilt_deg(rotation) <= _MAX_TILT_DEG:
        return None  # where the camera looks aside, points are turned: see `turn_ahead`
    turn_deg = _turn_deg(rotation)
    if turn_deg <= _IDENTITY_DEG:
        return (
            "has the identity for its rotation, so that the camera's axes are the LiDAR's "
            "(forward, left, up), expected right, down, forward: give the camera's optical frame"
        )
    if turn_deg <= _SMALL_TURN_DEG:
        return (
            f"turns by only {turn_deg:.2f} degrees: its angles are probably in radians where "
            "degrees were expected, or lead to another frame than the camera's optical one"
        )
    if _tilt_deg(rotation.T) <= _MAX_TILT_DEG and _aside_deg(rotation.T) <= _MAX_ASIDE_DEG:
        return "is probably inverted (lidar_from_camera): give its inverse"
    axes = _as_axes(rotation)
    if axes is not None:
        return (
            f"has its axes swapped: the camera's x, y, z point {', '.join(axes)}, expected right, "
            "down, forward in a LiDAR frame of x forward, y left, z up; where the points are of "
            "another convention as well, convert both, points and transform, never one alone"
        )
    return (
        f"tilts the camera by {_tilt_deg(rotation):.0f} degrees: its angles are probably in "
        "degrees where radians were expected, or it belongs to another pair of sensors"
    )


def is_hardly_shown(num_shown: int, num_points: int) -> bool:
    """Whether an image shows too little of a sweep for both to belong together."""
    share = num_shown / max(num_points, 1)
    is_handful = num_shown < _HANDFUL and share < _HANDFUL_SHARE
    return num_points > 0 and (is_handful or share < LEAST_SHARE_IN_IMAGE)


def turn_ahead(
    camera_from_lidar: Float64[np.ndarray, "4 4"],
) -> tuple[Float64[np.ndarray, "4 4"], float]:
    """A LiDAR frame turned about its z axis so that x points where the camera looks.

    That is what detectors, KITTI's files and pictures from above expect. nuScenes' LiDAR has x to
    the right, a camera may look aside, and a LiDAR may be mounted as its plug wants it.

    Returns:
        new_from_old, and the angle [deg], counter-clockwise, from the old x axis to the new; the
        identity and 0 where the camera looks ahead (within 5 degrees), or is not upright.
    """
    rotation = camera_from_lidar[:3, :3]
    angle = _aside_rad(rotation)
    is_upright = _tilt_deg(rotation) <= _MAX_TILT_DEG
    new_from_old = np.eye(4)
    if not is_upright or abs(np.degrees(angle)) <= _AHEAD_DEG:
        return new_from_old, 0.0
    cos, sin = np.cos(angle), np.sin(angle)
    new_from_old[:2, :2] = [[cos, sin], [-sin, cos]]
    return new_from_old, float(np.degrees(angle))


def resolution_doubt(
    camera_matrix: Float64[np.ndarray, "3 columns"], image_size: tuple[int, int]
) -> str | None:
    """That a camera matrix is of other images; None where it may be of these.

    Where both coordinates of the principal point are off the middle by one factor, it is hardly
    that of a camera that was cropped; where it is in the middle of images as wide as these are
    high, height and width were taken for each other.

    Args:
        camera_matrix: In pixels.
        image_size: Height, width [px].

    Returns:
        The rest of a sentence that begins with the matrix's name.
    """
    calibrated = 2 * camera_matrix[1::-1, 2] + 1  # height, width
    if (calibrated <= 0).any():
        return None
    seen = (
        f"has its principal point in the middle of an image of {calibrated[0]:.0f}x"
        f"{calibrated[1]:.0f} (height x width), but images are {image_size[0]}x{image_size[1]}: "
    )
    turned = calibrated[::-1] / np.array(image_size)
    # an image so much longer than high is not alike both ways
    is_long = max(image_size) > _ALIKE**2 * min(image_size)
    if is_long and (np.abs(np.log(turned)) < math.log(_ALIKE)).all():
        return (
            f"{seen}height and width are probably swapped, or images turned by 90 degrees; give "
            "the height first, or turn them back"
        )
    factors = calibrated / np.array(image_size)
    is_other = (factors > _OTHER_RESOLUTION).all() or (factors < 1 / _OTHER_RESOLUTION).all()
    if not is_other or factors.max() > _ALIKE * factors.min():
        return None
    return (
        f"{seen}it is probably that of another resolution; scale its first two rows, or the images"
    )


def _tilt_deg(rotation: Float64[np.ndarray, "3 3"]) -> float:
    """Between what is up for the LiDAR (z) and for the camera (-y)."""
    return _angle_deg(-rotation[1, 2])


def _aside_deg(rotation: Float64[np.ndarray, "3 3"]) -> float:
    """From the LiDAR's x axis to the camera's view, seen from above."""
    return abs(float(np.degrees(_aside_rad(rotation))))


def _aside_rad(rotation: Float64[np.ndarray, "3 3"]) -> float:
    """The same with its sign, counter-clockwise."""
    return float(np.arctan2(rotation[2, 1], rotation[2, 0]))


def _turn_deg(rotation: Float64[np.ndarray, "3 3"]) -> float:
    # By the chord, which has digits left where the angle is small.
    chord = np.linalg.norm(rotation - np.eye(3)) / np.sqrt(8)
    return float(2 * np.degrees(np.arcsin(min(chord, 1.0))))


def _angle_deg(cosine: float) -> float:
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _as_axes(rotation: Float64[np.ndarray, "3 3"]) -> tuple[str, str, str] | None:
    """Where the camera's axes point in the LiDAR's; None where they are oblique."""
    nearest = np.argmax(np.abs(rotation), axis=1)
    swapped = np.zeros((3, 3))
    swapped[range(3), nearest] = np.sign(rotation[range(3), nearest])
    if len(set(nearest.tolist())) < 3 or _turn_deg(rotation @ swapped.T) > _SWAPPED_DEG:
        return None
    first, second, third = (
        _LIDAR_DIRECTIONS[axis] if row[axis] > 0 else _OPPOSITE[_LIDAR_DIRECTIONS[axis]]
        for row, axis in zip(rotation, nearest.tolist(), strict=True)
    )
    return first, second, third
