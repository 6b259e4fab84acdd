import dataclasses
import math

import pytest
import torch

from sightline.augmentation.sample_changes import rotate_extrinsics
from sightline.geometry.projection import project_points
from sightline.structures.level import level_sample
from sightline.structures.lidar_turn import LidarTurn, undo_turn
from tests.joining.scenes import make_sample

POINTS = [[20.0, 3.0, -1.0, 0.5], [8.0, -2.0, 0.5, 0.1]]
TURN = LidarTurn(yaw_deg=2.0, pitch_deg=-1.0, roll_deg=0.5)


def pixels(sample):
    return project_points(sample.points[:, :3].double(), sample.calibration).pixels


def test_points_of_a_turned_lidar_fall_on_the_same_pixels_once_it_is_undone():
    sample = make_sample(POINTS)
    turned = rotate_extrinsics(sample, 2.0, -1.0, 0.5)
    assert (pixels(turned) - pixels(sample)).abs().max() > 10
    undone = undo_turn(turned, TURN)
    assert undone.points is turned.points
    torch.testing.assert_close(pixels(undone), pixels(sample), atol=1e-3, rtol=0)


def test_a_turn_is_about_the_axes_of_the_level_frame():
    level_from_lidar = torch.tensor(  # a LiDAR that looks to the left
        [[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=torch.float64
    )
    sample = make_sample(POINTS)
    mount = sample.calibration.camera_from_lidar @ level_from_lidar
    mounted = dataclasses.replace(
        sample,
        calibration=dataclasses.replace(sample.calibration, camera_from_lidar=mount),
        level_from_lidar=level_from_lidar,
    )
    undone = level_sample(undo_turn(mounted, TURN)).calibration.camera_from_lidar
    torch.testing.assert_close(undone, undo_turn(sample, TURN).calibration.camera_from_lidar)


def test_no_turn_leaves_the_sample_as_it_is():
    sample = make_sample(POINTS)
    assert undo_turn(sample, LidarTurn()) is sample
    assert not LidarTurn()
    assert LidarTurn(roll_deg=-0.1)


def test_json_holds_the_angles():
    turn = LidarTurn(yaw_deg=1.006, pitch_deg=-0.5)
    assert turn.to_json() == {"yaw_deg": 1.01, "pitch_deg": -0.5, "roll_deg": 0.0}


def test_angles_that_are_not_finite_are_refused():
    with pytest.raises(ValueError, match="a LiDAR turns by finite angles"):
        LidarTurn(yaw_deg=math.nan)
