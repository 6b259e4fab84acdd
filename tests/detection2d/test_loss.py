import pytest
import torch

from sightline.detection2d.loss import CELL_PX, health, known_by_points, pooled_health


def test_health_is_the_share_of_each_cell_that_is_left_and_unknown_beyond_the_image():
    broken = torch.zeros(2 * CELL_PX, 3 * CELL_PX - 3, dtype=torch.bool)
    broken[: CELL_PX // 2, :CELL_PX] = True
    broken[CELL_PX:, 2 * CELL_PX :] = True
    found = health(broken, (2 * CELL_PX, 4 * CELL_PX), nothing_left=True)
    expected = torch.tensor([[[0.5, 1, 1, torch.nan], [1, 1, 0, torch.nan]]])
    torch.testing.assert_close(found, expected, equal_nan=True)


def test_health_is_unknown_where_something_is_left_of_what_is_broken():
    broken = torch.zeros(CELL_PX, 2 * CELL_PX, dtype=torch.bool)
    broken[:, : CELL_PX + 4] = True
    found = health(broken, (CELL_PX, 2 * CELL_PX), nothing_left=False)
    torch.testing.assert_close(found, torch.tensor([[[torch.nan, 1.0]]]), equal_nan=True)


def test_the_health_of_a_lidar_is_unknown_where_no_point_would_be():
    lidar = torch.zeros(3, CELL_PX, 3 * CELL_PX)
    lidar[1, 2, 2] = lidar[0, 0, -1] = 0.1
    found = known_by_points(torch.tensor([[[0.0, 0.5, 1.0]]]), lidar)
    torch.testing.assert_close(found, torch.tensor([[[0.0, torch.nan, 1.0]]]), equal_nan=True)


def test_pooled_health_is_the_mean_of_what_is_known():
    of_cells = torch.tensor(
        [[[[1.0, 0.5, torch.nan, torch.nan], [0.0, torch.nan] + [torch.nan] * 2]]]
    )
    found = pooled_health(of_cells, 1, 2)
    assert found[0, 0, 0, 0] == pytest.approx(0.5)
    assert found[0, 0, 0, 1].isnan()
