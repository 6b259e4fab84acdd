"""Points in a vehicle's frame are told from those of a low LiDAR, and seen from a usual height."""

from dataclasses import replace

import pytest
import torch

from sightline.data.formats.lidar_origin import seen_from_lidar, vehicle_frame_doubt
from sightline.geometry.tilt import Tilt
from sightline.geometry.transforms import transform_points
from sightline.structures.level import level_sample
from tests.data.recordings import SAMPLE

LEVEL = Tilt(roll_deg=0.0, pitch_deg=0.0)
TILTED = Tilt(roll_deg=3.0, pitch_deg=12.0)


def lifted(height_m):
    """The sample in a frame below its LiDAR."""
    points = SAMPLE.points.clone()
    points[:, 2] += height_m
    return replace(SAMPLE, points=points)


@pytest.mark.parametrize("tilt", [LEVEL, TILTED])
def test_an_origin_on_the_road_moves_up_to_a_lidars_height(tilt):
    sample = replace(
        lifted(1.7),
        level_from_lidar=None if tilt.is_level else torch.from_numpy(tilt.level_from_lidar),
        lidar_height_m=0.03,
    )
    seen = seen_from_lidar(sample)
    assert seen.lidar_height_m == 1.73
    lowered = level_sample(sample).points[:, :3] - level_sample(seen).points[:, :3]
    torch.testing.assert_close(
        lowered, torch.tensor([0, 0, 1.7]).expand_as(lowered), rtol=0, atol=1e-4
    )
    torch.testing.assert_close(
        transform_points(seen.calibration.camera_from_lidar, seen.points[:, :3]),
        transform_points(sample.calibration.camera_from_lidar, sample.points[:, :3]),
        rtol=0,
        atol=1e-4,
    )
    for kept in (replace(sample, lidar_height_m=0.3), replace(sample, points=None), SAMPLE):
        assert seen_from_lidar(kept) is kept


@pytest.mark.parametrize(
    ("sample", "height_m", "is_vehicles"),
    [
        (SAMPLE, 0.1, False),
        (SAMPLE, 0.29, False),
        (lifted(1.44), 0.1, True),
        (lifted(1.44), 0.29, True),
        (lifted(1.43), 0.3, False),
        (replace(SAMPLE, points=None), 0.2, True),
    ],
)
def test_a_low_lidar_is_known_by_its_rings(sample, height_m, is_vehicles):
    doubt = vehicle_frame_doubt(replace(sample, lidar_height_m=height_m))
    assert (doubt is not None) is is_vehicles
