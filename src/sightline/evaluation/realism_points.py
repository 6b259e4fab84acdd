"""Measurements on a sweep: the ground, and unoccluded cars."""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float32, Float64

from sightline.data.formats.kitti_calibration import CalibrationMatrices
from sightline.data.formats.kitti_labels import KittiObjects

_GROUND_M: Final = (5.0, 40.0)
"""Range ahead in which the ground is measured."""
_HALF_WIDTH_M: Final = 5.0
_CELL_M: Final = 1.0
_MIN_CELLS: Final = 50
_ROUNDS: Final = 30
_SCALES_M: Final = (1.0, 0.05)
"""Residuals above which a cell has less weight, in the first rounds and the last ones."""
_GROUND_ENDS_M: Final = 0.5
"""Maximum distance of ground points from the plane."""
_FACES_M: Final = (0.25, 1.1)
"""Heights above a car's bottom for its ends and flanks: above the road, below the windows."""
_FLANK_M: Final = 0.3
"""Maximum distance of flank points from the nearer side."""
_MIN_ON_FLANK: Final = 15
_MIN_SINE: Final = 0.1
"""Minimum sine of the angle between a visible flank and the line of sight."""
_MIRRORS_M: Final = ((0.06, 0.35), (0.75, 1.25))
"""Distances beyond the label's sides, and heights, of door mirrors."""
_MIRROR_PLACES: Final = (0.0, 0.7)
"""Positions of mirrors ahead of the middle, as shares of half the length."""


class Ground(NamedTuple):
    """Best-fit plane of the road ahead, with its residuals."""

    pitch_deg: float
    roll_deg: float
    """Slopes of the ground ahead and to the left, LiDAR frame."""
    residual_m: float
    residual_90_m: float
    """Median and 90 % quantile of the ground's distance from the plane."""


class FreeCar(NamedTuple):
    """A car that is neither truncated nor occluded."""

    distance_m: float
    reflectances: Float32[np.ndarray, " num_points"]
    """Reflectances of the points in its box."""
    beyond_flank_m: float | None
    """Distance from the last points of the flank to the label's end, on the far side; None: the
    flank is not well visible."""
    shows_mirrors: bool
    """Whether there are points at the places of mirrors beyond the label."""


def fit_ground(points: Float32[np.ndarray, "num_points 4"]) -> Ground | None:
    """Fit a plane to the lowest points of 1 m cells, 5 to 40 m ahead and 5 m to either side.

    Weighted least squares reduce the weight of cells far off the plane (Cauchy's weights, ever
    stricter), so that objects on the ground do not lift the plane. None: too few cells.
    """
    x, y, z = points[:, :3].astype(np.float64).T
    ahead = (x > _GROUND_M[0]) & (x < _GROUND_M[1]) & (np.abs(y) < _HALF_WIDTH_M)
    x, y, z = x[ahead], y[ahead], z[ahead]
    cells = np.floor(np.stack((x, y)) / _CELL_M).astype(int)
    order = np.lexsort((z, *cells))
    _, lowest = np.unique(cells[:, order], axis=1, return_index=True)
    x, y, z = (values[order][lowest] for values in (x, y, z))
    if len(z) < _MIN_CELLS:
        return None
    terms = np.column_stack((x, y, np.ones(len(x))))
    plane = np.array([0.0, 0.0, np.median(z)])
    for scale in np.geomspace(*_SCALES_M, _ROUNDS):
        weights = 1 / np.hypot(1, (z - terms @ plane) / scale)
        plane = np.linalg.lstsq(terms * weights[:, None], z * weights, rcond=None)[0]
    off = np.abs(z - terms @ plane)
    median, most = np.quantile(off[off < _GROUND_ENDS_M], (0.5, 0.9))
    pitch, roll = np.degrees(np.arctan(plane[:2]))
    return Ground(float(pitch), float(roll), float(median), float(most))


def free_cars(
    points: Float32[np.ndarray, "num_points 4"],
    matrices: CalibrationMatrices,
    objects: KittiObjects,
) -> list[FreeCar]:
    """Select the labelled cars that are whole in the image and not occluded."""
    points = points[points[:, 0] > 0]
    rotation, offset = matrices.camera_from_lidar[:3, :3], matrices.camera_from_lidar[:3, 3]
    in_camera = points[:, :3] @ rotation.T + offset
    cars = []
    for index, name in enumerate(objects.class_names):
        if name == "Car" and objects.occlusion[index] == 0 and objects.truncation[index] <= 0:
            location, size_hwl = objects.locations[index], objects.dimensions_hwl[index]
            cos, sin = np.cos(objects.rotation_y[index]), np.sin(objects.rotation_y[index])
            to_own = np.array([[0.0, 1, 0], [sin, 0, cos], [cos, 0, -sin]])
            own = (in_camera - location) @ to_own.T + (size_hwl[0] / 2, 0, 0)
            camera = -to_own @ location
            inside = (np.abs(own) <= size_hwl / 2).all(axis=1)
            cars.append(
                FreeCar(
                    float(np.hypot(location[0], location[2])),
                    points[inside, 3],
                    _beyond_flank(own, camera, size_hwl),
                    _shows_mirrors(own, size_hwl),
                )
            )
    return cars


def _beyond_flank(
    own: Float64[np.ndarray, "num_points 3"],
    camera: Float64[np.ndarray, "3"],
    size_hwl: Float64[np.ndarray, "3"],
) -> float | None:
    """Compute `FreeCar.beyond_flank_m`; coordinates are down from the middle, right and ahead."""
    height, width, length = size_hwl
    _, side, end = np.where(camera < 0, -1, 1)
    down, right, ahead = own.T
    far_end = (-end * length / 2, side * width / 2)
    line_of_sight = np.array(far_end) - camera[[2, 1]]
    if side * -line_of_sight[1] < _MIN_SINE * np.hypot(*line_of_sight):
        return None
    up = height / 2 - down
    on_flank = (up > _FACES_M[0]) & (up < _FACES_M[1])
    on_flank &= np.abs(side * right - width / 2) < _FLANK_M
    reach = -end * ahead[on_flank]
    reach = reach[(reach > _FLANK_M - length / 2) & (reach < length / 2 + 2 * _FLANK_M)]
    if len(reach) < _MIN_ON_FLANK:
        return None
    return float(length / 2 - np.sort(reach)[-2])  # the last may be a stray point


def _shows_mirrors(
    own: Float64[np.ndarray, "num_points 3"], size_hwl: Float64[np.ndarray, "3"]
) -> bool:
    """Compute `FreeCar.shows_mirrors`; coordinates as in `_beyond_flank`."""
    height, width, length = size_hwl
    down, right, ahead = own.T
    values = np.abs(right) - width / 2, height / 2 - down, ahead / (length / 2)
    ranges = *_MIRRORS_M, _MIRROR_PLACES
    inside = [
        (value > low) & (value < high) for value, (low, high) in zip(values, ranges, strict=True)
    ]
    return bool(np.logical_and.reduce(inside).any())
