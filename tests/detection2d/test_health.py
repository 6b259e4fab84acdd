import pytest
import torch

from sightline.detection2d.health import CELL_PX, camera_health, lidar_health, pooled_health


def test_health_is_the_share_of_what_is_left_and_unknown_where_there_was_nothing():
    before = torch.zeros(3, 2 * CELL_PX, 3 * CELL_PX)
    before[0, :CELL_PX, : 2 * CELL_PX] = 0.5
    after = before.clone()
    after[:, : CELL_PX // 2, :CELL_PX] = 0
    expected = torch.full((1, 2, 3), torch.nan)
    expected[0, 0, :2] = torch.tensor([0.5, 1.0])
    for health in (camera_health, lidar_health):
        found = health(before, after)
        torch.testing.assert_close(found, expected, equal_nan=True)


def test_a_sweep_that_is_gone_is_known_to_be_gone_everywhere():
    before = torch.zeros(3, CELL_PX, 2 * CELL_PX)
    before[1, 0, 0] = 0.1
    assert lidar_health(before, torch.zeros_like(before)).tolist() == [[[0, 0]]]
    assert lidar_health(torch.zeros_like(before), torch.zeros_like(before)).isnan().all()


def test_what_a_fault_adds_does_not_count():
    before = torch.zeros(3, CELL_PX, CELL_PX)
    before[:, :, 0] = 1
    after = torch.ones_like(before)
    assert camera_health(before, after).tolist() == [[[1]]]


def test_pooled_health_is_the_mean_of_what_is_known():
    health = torch.tensor(
        [[[[1.0, 0.5, torch.nan, torch.nan], [0.0, torch.nan] + [torch.nan] * 2]]]
    )
    found = pooled_health(health, 1, 2)
    assert found[0, 0, 0, 0] == pytest.approx(0.5)
    assert found[0, 0, 0, 1].isnan()
