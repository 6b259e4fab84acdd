"""Plausibility of a camera's and a LiDAR's calibration, and likely mistakes.

Without PyTorch, for checks that start at once.
"""

import math
from typing import Final

import numpy as np
from jaxtyping import Float64

MAX_OFFSET_M: Final = 20.0
"""Largest distance between two sensors, on the longest lorry."""

MAX_RANGE_M: Final = 300.0
"""Range beyond every LiDAR on the road; a sweep in millimetres is far beyond."""

USUAL_STRETCH: Final = 1.5
"""Usual ratio of fx and fy, at most: 30,292 matrices of KITTI have up to 1.0035, images resized to
KITTI's benchmark sizes up to 1.05, 16:9 squeezed to 4:3 1.33, binning of 2 x 3 pixels 1.5."""

MIN_SHARE_IN_IMAGE: Final = 0.01
"""Smallest share of a sweep's points in the image, if camera and LiDAR face the same way."""

_MIN_FOCAL_PX = 1.0
_MAX_STRETCH = 10.0  # largest aspect ratio of a pixel
_MAX_SKEW_SHARE: Final = 0.01
"""Largest share of the focal length; KITTI has 0, and this moves no pixel of it by over 2 px."""
_HANDFUL, _HANDFUL_SHARE = 20, 0.05  # number and share of points in the image
_MAX_TILT_DEG = 25.0  # between the camera's and the LiDAR's vertical
_MAX_ASIDE_DEG = 60.0  # between the view and the LiDAR's x axis
_MAX_OFFSET_CM = 500.0  # of a LiDAR and a camera on one car, as a number
_AHEAD_DEG = 5.0  # usual error of a mount that faces ahead
_SWAPPED_DEG = 15.0  # from axes that are only swapped
_SMALL_TURN_DEG = 5.0  # 90 degrees in radians, read as degrees, are 1.6
_IDENTITY_DEG = 0.01
_MIN_CENTRE_SHARES: Final = (0.3, 0.2)
"""Smallest shares of width and height from an edge to the principal point; KITTI's have 0.48 and
0.46, nuScenes' 0.48 and 0.42, KITTI's depth benchmark, cropped at the top, 0.49 and 0.42."""
_CENTRAL_SHARE: Final = 0.1
"""Largest distance of the principal point from the middle, as a share of the width, of an image
that has been cropped or extended at its top or bottom only."""
_OTHER_RESOLUTION = 1.35  # ratio of the image's middle and the principal point, similar in x and y
_SIMILAR_RATIO = 1.2
_THIRD_ROW_TOLERANCE = 1e-6  # for a camera matrix computed in float32
_LIDAR_DIRECTIONS = ("forward", "left", "up")
_OPPOSITE = {"forward": "backward", "left": "right", "up": "down"}


def mount_doubt(camera_from_lidar: Float64[np.ndarray, "4 4"]) -> str | None:
    """Find a doubt about a transform, with the likely cause; None if there is none.

    Expected conventions: LiDAR x forward, y left, z up; camera x right, y down, z forward. So both
    agree on the vertical, and the camera faces ahead.

    Returns:
        The rest of a sentence that begins with the transform's name.
    """
    offset_m = float(np.linalg.norm(camera_from_lidar[:3, 3]))
    if offset_m > MAX_OFFSET_M:
        unit = "millimetres" if offset_m > _MAX_OFFSET_CM else "millimetres or centimetres"
        return (
            f"puts the LiDAR {offset_m:.4g} m from the camera, expected up to {MAX_OFFSET_M:.0f} "
            f"m: its last column is probably in {unit}; give metres, or if points are in a "
            "map's or world's frame, both in the LiDAR's own frame"
        )
    rotation = camera_from_lidar[:3, :3]
    if _tilt_deg(rotation) <= _MAX_TILT_DEG:
        return None  # for a camera that faces aside, points are turned: see `turn_ahead`
    turn_deg = _turn_deg(rotation)
    if turn_deg <= _IDENTITY_DEG:
        return (
            "has the identity for its rotation, so the camera's axes equal the LiDAR's "
            "(forward, left, up), expected right, down, forward: give the camera's optical frame; "
            "if the points have the camera's axes, convert both, points and transform"
        )
    if turn_deg <= _SMALL_TURN_DEG:
        return (
            f"turns by only {turn_deg:.2f} degrees, so the camera's axes are about the LiDAR's "
            "(forward, left, up), expected right, down, forward: give the camera's optical frame, "
            "not its body's (ROS: camera_link), or angles in degrees if they are in radians; if "
            "the points have the camera's axes, convert both, points and transform"
        )
    if _tilt_deg(rotation.T) <= _MAX_TILT_DEG and _aside_deg(rotation.T) <= _MAX_ASIDE_DEG:
        return "is probably inverted (lidar_from_camera): give its inverse"
    axes = _as_axes(rotation)
    if axes is not None:
        return (
            f"has its axes swapped: the camera's x, y, z point {', '.join(axes)}, expected right, "
            "down, forward in a LiDAR frame of x forward, y left, z up; if the points have "
            "another convention, too, convert both, points and transform"
        )
    return (
        f"tilts the camera by {_tilt_deg(rotation):.0f} degrees: its angles are probably in "
        "degrees where radians were expected, or it belongs to another pair of sensors; if the "
        "LiDAR is upside down or on its side, convert both, points and transform"
    )


def camera_fault(camera_matrix: Float64[np.ndarray, "3 columns"]) -> str | None:
    """Find numbers that no camera matrix has, with the likely cause; None if there is no fault.

    Returns:
        The rest of a sentence that begins with the matrix's name.
    """
    if np.abs(camera_matrix[2, :3] - (0, 0, 1)).max() > _THIRD_ROW_TOLERANCE:
        hint = ": it is probably transposed" if not camera_matrix[:2, 2].any() else ""
        return f"has the third row {camera_matrix[2].tolist()}, expected 0 0 1{hint}"
    return focal_fault(camera_matrix)


def focal_fault(camera_matrix: Float64[np.ndarray, "3 columns"]) -> str | None:
    """Find focal lengths that no camera has, with the likely cause; None if there is no fault.

    Returns:
        The rest of a sentence that begins with the matrix's name.
    """
    focal_px = np.diag(camera_matrix)[:2]
    if (focal_px <= 0).any():
        x, y = focal_px
        return f"has focal lengths of {x:.6g} and {y:.6g} px, expected both above 0"
    if (focal_px < _MIN_FOCAL_PX).any() or _stretch(focal_px) > _MAX_STRETCH:
        return (
            f"has focal lengths of {focal_px[0]:.6g} and {focal_px[1]:.6g} px, expected both alike "
            f"and at least {_MIN_FOCAL_PX:g}: they are probably in millimetres or shares of the "
            "image; give pixels"
        )
    return None


def stretch_doubt(camera_matrix: Float64[np.ndarray, "3 columns"]) -> str | None:
    """Find focal lengths (above 0) that are less alike than square pixels' are; None if alike.

    Returns:
        The rest of a sentence that begins with the matrix's name.
    """
    focal_px = np.diag(camera_matrix)[:2]
    stretch = _stretch(focal_px)
    if stretch <= USUAL_STRETCH:
        return None
    return (
        f"has focal lengths of {focal_px[0]:.6g} and {focal_px[1]:.6g} px, one {stretch:.2g} times "
        "the other, expected both alike, as pixels are squares; unless images were stretched so, "
        "correct fx or fy"
    )


def skew_doubt(camera_matrix: Float64[np.ndarray, "3 columns"]) -> str | None:
    """Find pixel axes that are not at right angles, as a rectified camera's are; None if they are.

    Returns:
        The rest of a sentence that begins with the matrix's name.
    """
    skews_px = camera_matrix[(0, 1), (1, 0)]
    if (np.abs(skews_px) <= _MAX_SKEW_SHARE * np.abs(np.diag(camera_matrix)[:2])).all():
        return None
    return (
        f"has skewed pixel axes ({skews_px[0]:.6g} and {skews_px[1]:.6g} px), expected 0 for a "
        "rectified camera"
    )


def pixel_doubt(camera_matrix: Float64[np.ndarray, "3 columns"]) -> str | None:
    """Find pixels that are no squares, by `stretch_doubt` and `skew_doubt`; None if they are."""
    return stretch_doubt(camera_matrix) or skew_doubt(camera_matrix)


def size_doubt(
    camera_matrix: Float64[np.ndarray, "3 columns"], image_size: tuple[int, int]
) -> str | None:
    """Find focal lengths or a principal point that no image of a size has; None if they fit.

    Args:
        camera_matrix: In pixels.
        image_size: Height, width [px].

    Returns:
        The rest of a sentence that begins with the matrix's name.
    """
    focal_px, principal_px = np.diag(camera_matrix)[:2], camera_matrix[:2, 2]
    width_height = np.array(image_size[::-1])
    size = f"an image of {image_size[0]}x{image_size[1]} (height x width)"
    is_short = bool((100 * focal_px < width_height).any())
    if is_short or (np.abs(focal_px) > 100 * width_height).any():
        cause = ": they are probably in millimetres, expected pixels" if is_short else ""
        return (
            f"has focal lengths of {focal_px[0]:.6g} and {focal_px[1]:.6g} px, which do not fit "
            f"{size}{cause}"
        )
    # The principal point of a cropped camera stays within a few image sizes.
    if (np.abs(principal_px - width_height / 2) > 3 * width_height).any():
        return (
            f"has its principal point at ({principal_px[0]:.6g}, {principal_px[1]:.6g}), far from "
            f"{size}"
        )
    return None


def _stretch(focal_px: Float64[np.ndarray, "2"]) -> float:
    return float(focal_px.max() / focal_px.min())


def has_too_few_in_image(num_in_image: int, num_points: int) -> bool:
    """Check if too few of a sweep's points are in the image for both to belong together."""
    share = num_in_image / max(num_points, 1)
    is_handful = num_in_image < _HANDFUL and share < _HANDFUL_SHARE
    return num_points > 0 and (is_handful or share < MIN_SHARE_IN_IMAGE)


def turn_ahead(
    camera_from_lidar: Float64[np.ndarray, "4 4"],
) -> tuple[Float64[np.ndarray, "4 4"], float]:
    """Turn a LiDAR frame about its z axis so that x points along the camera's view.

    Detectors, KITTI's files and pictures from above expect this. nuScenes' LiDAR has x to the
    right, a camera may face aside, and a LiDAR may be mounted in any rotation.

    Returns:
        new_from_old, and the angle [deg], counter-clockwise, from the old x axis to the new; the
        identity and 0 if the camera faces ahead (within 5 degrees), or is not upright.
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
    """Find evidence that a camera matrix belongs to other images; None if it may fit these.

    If both coordinates of the principal point are off the middle by the same factor, the camera is
    hardly a cropped one. If it is in the middle of an image with height and width exchanged, they
    were swapped.

    Args:
        camera_matrix: In pixels.
        image_size: Height, width [px].

    Returns:
        The rest of a sentence that begins with the matrix's name.
    """
    calibrated = 2 * camera_matrix[1::-1, 2] + 1  # height, width
    if (calibrated <= 0).any():
        return None
    problem = (
        f"has its principal point in the middle of an image of {calibrated[0]:.0f}x"
        f"{calibrated[1]:.0f} (height x width), but images are {image_size[0]}x{image_size[1]}: "
    )
    if has_exchanged_size(camera_matrix, image_size):
        return (
            f"{problem}height and width are probably swapped, or images turned by 90 degrees; give "
            "the height first, or turn them back"
        )
    factors = calibrated / np.array(image_size)
    is_scaled = (factors > _OTHER_RESOLUTION).all() or (factors < 1 / _OTHER_RESOLUTION).all()
    if not is_scaled or factors.max() > _SIMILAR_RATIO * factors.min():
        return None
    return f"{problem}it is for another resolution; scale its first two rows, or the images"


def has_exchanged_size(
    camera_matrix: Float64[np.ndarray, "3 columns"],
    image_size: tuple[int, int],
    *,
    max_ratio: float = _SIMILAR_RATIO,
) -> bool:
    """Check if the principal point is in the middle of an image with height and width exchanged.

    Args:
        camera_matrix: In pixels.
        image_size: Height, width [px].
        max_ratio: Largest ratio of the exchanged size and that of which the point is the middle.
    """
    calibrated = 2 * camera_matrix[:2, 2] + 1  # width, height
    # the ratios of such a wide image are not similar in x and y
    is_elongated = max(image_size) > _SIMILAR_RATIO**2 * min(image_size)
    if not is_elongated or (calibrated <= 0).any():
        return False
    return bool((np.abs(np.log(calibrated / np.array(image_size))) < math.log(max_ratio)).all())


def off_centre_doubt(
    camera_matrix: Float64[np.ndarray, "3 columns"], image_size: tuple[int, int]
) -> str | None:
    """Find a principal point far from the image's centre; None: it is near, or it was moved there.

    An image that was resized or cropped without its matrix keeps the principal point of a larger
    image, in whose middle it is. So a point above the upper part, midway between the sides, is of
    an image whose top was cropped with its matrix. A point below the lower part that is farther
    from the top than the focal length would be the middle of a view of more than 90 degrees, which
    no such lens has: the image was extended at the top, as the simulator does.

    Args:
        camera_matrix: In pixels.
        image_size: Height, width [px].

    Returns:
        The rest of a sentence that begins with the matrix's name.
    """
    x, y = camera_matrix[:2, 2]
    shares = np.array((x, y)) / image_size[::-1]
    if (np.minimum(shares, 1 - shares) >= _MIN_CENTRE_SHARES).all():
        return None
    is_central = abs(shares[0] - 0.5) <= _CENTRAL_SHARE
    if is_central and (shares[1] < 0.5 or y > camera_matrix[1, 1]):
        return None
    return (
        f"has its principal point at ({x:.6g}, {y:.6g}), away from the centre of an image of "
        f"{image_size[0]}x{image_size[1]} (height x width), probably because images were resized "
        "or cropped without it"
    )


def _tilt_deg(rotation: Float64[np.ndarray, "3 3"]) -> float:
    """Angle between the verticals of the LiDAR (z) and the camera (-y)."""
    return _angle_deg(-rotation[1, 2])


def _aside_deg(rotation: Float64[np.ndarray, "3 3"]) -> float:
    """Angle from the LiDAR's x axis to the camera's view, seen from above, unsigned."""
    return abs(float(np.degrees(_aside_rad(rotation))))


def _aside_rad(rotation: Float64[np.ndarray, "3 3"]) -> float:
    """Signed angle from the LiDAR's x axis to the camera's view, counter-clockwise."""
    return float(np.arctan2(rotation[2, 1], rotation[2, 0]))


def _turn_deg(rotation: Float64[np.ndarray, "3 3"]) -> float:
    # From the chord, which keeps precision at small angles.
    chord = np.linalg.norm(rotation - np.eye(3)) / np.sqrt(8)
    return float(2 * np.degrees(np.arcsin(min(chord, 1.0))))


def _angle_deg(cosine: float) -> float:
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _as_axes(rotation: Float64[np.ndarray, "3 3"]) -> tuple[str, str, str] | None:
    """Directions of the camera's axes in the LiDAR's frame; None if they are oblique."""
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
