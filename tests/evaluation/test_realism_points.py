import numpy as np
import pytest

from sightline.evaluation.realism_points import fit_ground


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
