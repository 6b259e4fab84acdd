import numpy as np
import pytest

from sightline.data.formats.kitti_calibration import CalibrationMatrices
from sightline.data.formats.kitti_labels import KittiObjects
from sightline.evaluation.realism_points import FreeCar, fit_ground, free_cars

AHEAD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""Camera from LiDAR, both in one place."""


def sweep(height, seed: int = 0, count: int = 6000) -> np.ndarray:
    """Points 5 to 40 m ahead and 5 m to either side, as high as a function of x and y says."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(5, 40, count), rng.uniform(-5, 5, count)
    return np.column_stack((x, y, height(x, y), np.zeros(count))).astype(np.float32)


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.03, -0.02), (-0.05, 0.04)])
def test_a_tilted_plane_is_found_whatever_stands_on_it(slopes: tuple[float, float]):
    points = sweep(lambda x, y: slopes[0] * x + slopes[1] * y - 1.7)
    x, y = points[:, 0], points[:, 1]
    in_wall = (x > 15) & (x < 19) & (y > 1) & (y < 4)
    points[in_wall, 2] += np.random.default_rng(1).uniform(0.4, 2, in_wall.sum())
    ground = fit_ground(points)
    assert np.tan(np.radians((ground.pitch_deg, ground.roll_deg))) == pytest.approx(
        slopes, abs=0.002
    )
    assert ground.residual_m < 0.01


def test_what_is_off_the_plane_is_measured():
    waves = [fit_ground(sweep(lambda x, y: high * np.sin(x) + 0 * y)) for high in (0.05, 0.1)]  # noqa: B023
    # Half of a wave's length is higher or lower than sin(45 degrees) of its height.
    assert [one.residual_m for one in waves] == pytest.approx([0.035, 0.07], rel=0.4)
    assert all(one.residual_m < one.residual_90_m for one in waves)


def test_too_little_ground_is_none():
    assert fit_ground(sweep(lambda x, y: 0 * x * y, count=30)) is None
    assert fit_ground(np.zeros((0, 4), np.float32)) is None


def look_at_car(own: np.ndarray, turn: float, middle: tuple[float, float] = (12.0, 4.0)) -> FreeCar:
    """A car 4 x 1.6 x 1.5 m on the level of the LiDAR, with points (ahead, left, up) of its own."""
    cos, sin = np.cos(turn), np.sin(turn)
    points = np.zeros((len(own), 4), np.float32)
    points[:, :2] = own[:, :2] @ np.array([[cos, sin], [-sin, cos]]) + middle
    points[:, 2] = own[:, 2]
    car = KittiObjects(
        class_names=("Car",),
        truncation=np.zeros(1),
        occlusion=np.zeros(1),
        alpha=np.zeros(1),
        boxes2d=np.zeros((1, 4)),
        dimensions_hwl=np.array([[1.5, 1.6, 4.0]]),
        locations=np.array([[-middle[1], 0.0, middle[0]]]),
        rotation_y=np.array([-turn - np.pi / 2]),
    )
    matrices = CalibrationMatrices(image_from_camera=np.eye(3, 4), camera_from_lidar=AHEAD)
    return free_cars(points, matrices, car)[0]


def flank(first: float, last: float, left: float, count: int = 40) -> np.ndarray:
    """Points along a line."""
    return np.column_stack((np.linspace(first, last, count), *np.full((2, count), [[left], [0.6]])))


@pytest.mark.parametrize(("turn", "near_side"), [(0.0, -0.75), (np.pi, 0.75)])
def test_how_far_a_label_reaches_beyond_the_flank_is_measured_on_the_far_side(turn, near_side):
    ahead = 1.0 if turn == 0.0 else -1.0
    shown = flank(-1.9 * ahead, 1.7 * ahead, near_side)
    above, behind = (flank(-1.9 * ahead, 2.0 * ahead, left) for left in (near_side, -near_side))
    above[:, 2] = 1.3
    stray = np.array([[2.1 * ahead, near_side, 0.6]])
    car = look_at_car(np.vstack((shown, above, behind, stray)), turn)
    assert car.beyond_flank_m == pytest.approx(0.3, abs=1e-4)
    assert car.distance_m == pytest.approx(np.hypot(12, 4))


def test_a_flank_that_shows_too_little_says_nothing():
    assert look_at_car(flank(-1.9, 1.7, -0.75, count=14), 0.0).beyond_flank_m is None
    assert look_at_car(flank(-2.0, -1.8, -0.75), 0.0).beyond_flank_m is None
    straight_ahead = look_at_car(flank(-1.9, 1.7, -0.75), 0.0, middle=(12.0, 1.0))
    assert straight_ahead.beyond_flank_m is None


@pytest.mark.parametrize("left", [-0.95, 0.95])
@pytest.mark.parametrize("turn", [0.0, 2.0])
def test_mirrors_are_points_beyond_the_sides_beside_the_windscreen(left: float, turn: float):
    assert look_at_car(np.array([[0.7, left, 1.0]]), turn).shows_mirrors
    for elsewhere in ([0.7, left, 0.5], [-0.7, left, 1.0], [1.7, left, 1.0], [0.7, 0.8, 1.0]):
        assert not look_at_car(np.array([elsewhere]), turn).shows_mirrors
