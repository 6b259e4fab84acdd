"""Measurements on a sweep: the ground, and cars that nothing hides."""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float32

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
            x, y, z = (in_camera - location).T
            own = np.stack((y + size_hwl[0] / 2, sin * x + cos * z, cos * x - sin * z), axis=1)
            inside = (np.abs(own) <= size_hwl / 2).all(axis=1)
            cars.append(FreeCar(float(np.hypot(location[0], location[2])), points[inside, 3]))
    return cars
