"""Measurements on a sweep: the ground, and cars that nothing hides."""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float32, Float64

from sightline.data.calibration_text import CalibrationMatrices
from sightline.data.kitti_labels import KittiObjects

_GROUND_M: Final = (5.0, 40.0)
"""How far ahead the ground is looked at."""
_HALF_WIDTH_M: Final = 5.0
_CELL_M: Final = 1.0
_MIN_CELLS: Final = 50
_ROUNDS: Final = 30
_SCALES_M: Final = (1.0, 0.05)
"""Residuals above which a cell counts less, in the first rounds and the last ones."""
_GROUND_ENDS_M: Final = 0.5
"""Points farther from the plane are not ground."""
_FACES_M: Final = (0.25, 1.1)
"""How high above a car's bottom its ends and flanks are looked at: above the road, below the
windows."""
_FLANK_M: Final = 0.3
"""Points so near to the nearer side are on the flank."""
_MIN_ON_FLANK: Final = 15
_LEAST_SINE: Final = 0.1
"""Of the angle between a flank and the line of sight, for a flank that is seen."""
_MIRRORS_M: Final = ((0.06, 0.35), (0.75, 1.25))
"""How far beyond the label's sides door mirrors are looked for, and how high."""
_MIRROR_PLACES: Final = (0.0, 0.7)
"""How far ahead of the middle, as a share of half the length."""


class Ground(NamedTuple):
    """The plane that fits the road ahead best, and how badly it fits."""

    pitch_deg: float
    roll_deg: float
    """Slope of the ground ahead and to the left, LiDAR frame."""
    residual_m: float
    residual_90_m: float
    """Median and 90 % quantile of how far the ground is off the plane."""


class FreeCar(NamedTuple):
    """A car that is neither truncated nor occluded."""

    distance_m: float
    reflectances: Float32[np.ndarray, " num_points"]
    """Of the points in its box."""
    beyond_flank_m: float | None
    """How far the label reaches beyond the last points of the flank, on the far side; None: the
    flank is not seen well."""
    shows_mirrors: bool
    """Whether points lie where mirrors stand out beyond the label."""


def fit_ground(points: Float32[np.ndarray, "num_points 4"]) -> Ground | None:
    """The plane through the lowest points of 1 m cells, 5 to 40 m ahead and 5 m to either side.

    By weighted least squares, where a cell counts less the farther off it is (Cauchy's weights,
    ever stricter), so that objects on the ground do not lift it. None: too few cells.
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
    """The labelled cars that are whole in the image and not occluded."""
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
    """`FreeCar.beyond_flank_m`; coordinates are down from the middle, to the right and ahead."""
    height, width, length = size_hwl
    _, side, end = np.where(camera < 0, -1, 1)
    down, right, ahead = own.T
    far_end = (-end * length / 2, side * width / 2)
    line_of_sight = np.array(far_end) - camera[[2, 1]]
    if side * -line_of_sight[1] < _LEAST_SINE * np.hypot(*line_of_sight):
        return None
    up = height / 2 - down
    on_flank = (up > _FACES_M[0]) & (up < _FACES_M[1])
    on_flank &= np.abs(side * right - width / 2) < _FLANK_M
    reach = -end * ahead[on_flank]
    reach = reach[(reach > _FLANK_M - length / 2) & (reach < length / 2 + 2 * _FLANK_M)]
    if len(reach) < _MIN_ON_FLANK:
        return None
    return float(length / 2 - np.sort(reach)[-2])  # the last may be a stray one


def _shows_mirrors(
    own: Float64[np.ndarray, "num_points 3"], size_hwl: Float64[np.ndarray, "3"]
) -> bool:
    """`FreeCar.shows_mirrors`; coordinates as in `_beyond_flank`."""
    height, width, length = size_hwl
    down, right, ahead = own.T
    values = np.abs(right) - width / 2, height / 2 - down, ahead / (length / 2)
    ranges = *_MIRRORS_M, _MIRROR_PLACES
    inside = [
        (value > low) & (value < high) for value, (low, high) in zip(values, ranges, strict=True)
    ]
    return bool(np.logical_and.reduce(inside).any())
