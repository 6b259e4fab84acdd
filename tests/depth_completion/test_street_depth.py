from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.data.open import open_dataset
from sightline.depth_completion.street_depth import LARGEST_SCALE, street_depth, to_focal_length
from sightline.geometry.calibration import Calibration
from sightline.geometry.transforms import rotation_about_axes
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.sample import CameraLidarSample
from tests.reference import street_depth as reference

MOUNT = torch.tensor(
    [[0, -1, 0, 0.1], [0, 0, -1, -0.4], [1, 0, 0, -0.3], [0, 0, 0, 1]], dtype=torch.float64
)


def rig(*, focal_px=40.0, size=(24, 36), tilt=(0.0, 0.0, 0.0), height_m=None):
    """Make a sample of a small camera, with a LiDAR that is tilted (yaw, pitch, roll)."""
    matrix = torch.tensor(
        [[focal_px, 0, 17.0, 2.0], [0, 1.1 * focal_px, 10.0, -1.0], [0, 0, 1, 0.0]],
        dtype=torch.float64,
    )
    level_from_lidar = torch.eye(4, dtype=torch.float64)
    level_from_lidar[:3, :3] = torch.as_tensor(rotation_about_axes(*tilt))
    return CameraLidarSample(
        sample_id="rig",
        calibration=Calibration(
            image_from_camera=matrix, camera_from_lidar=MOUNT @ level_from_lidar
        ),
        image_size=size,
        image=torch.zeros(3, *size, dtype=torch.uint8),
        level_from_lidar=level_from_lidar if any(tilt) else None,
        lidar_height_m=height_m,
    )


@pytest.mark.parametrize(
    ("sample", "height_m"),
    [
        (rig(), 1.73),
        (rig(height_m=2.4), 2.4),
        (rig(tilt=(0.0, 8.0, -3.0), height_m=0.2), 0.2),
        (rig(height_m=-3.0), -3.0),
    ],
)
def test_the_depth_is_that_of_the_rays_followed_one_by_one(sample, height_m):
    expected = reference.street_depth(
        sample.calibration.image_from_camera[:, :3].numpy(),
        MOUNT.numpy(),
        sample.image_size,
        height_m,
    )
    np.testing.assert_allclose(street_depth(sample), expected, rtol=1e-5)


def test_the_depth_of_a_simulated_level_road_is_close_below_the_camera():
    sample = open_dataset(PACKAGED_FRAMES, parts={"image", "points", "depth"})[0]
    truth_m, depth_m = sample.depth[-20:], street_depth(sample)[-20:]
    inverse = 1 / depth_m - 1 / 30
    is_road = truth_m > 0
    ratio = (1 / inverse)[is_road] / truth_m[is_road]
    assert abs(float(ratio.median()) - 1) < 0.05


def test_resizing_to_a_focal_length_changes_scale_not_directions():
    sample = rig(focal_px=80.0, size=(48, 72))
    small = to_focal_length(sample, 40.0)
    assert small.image_size == (22, 36)  # fy is 1.1 times fx
    matrix = small.calibration.image_from_camera
    assert matrix[0, 0] == pytest.approx(40.0)
    assert matrix[1, 1] == pytest.approx(40.0, rel=0.02)
    centre, small_centre = street_depth(sample)[23:25, 35:37].mean(), street_depth(small)
    assert float(small_centre[10:12, 17:19].mean()) == pytest.approx(float(centre), rel=0.05)


def test_images_are_not_enlarged_without_bound_and_stay_where_nothing_is_asked():
    sample = rig(focal_px=10.0)
    height, width = to_focal_length(sample, 4000.0).image_size
    assert (height, width) == tuple(int(LARGEST_SCALE * side) for side in sample.image_size)
    assert to_focal_length(sample, None) is sample
    assert to_focal_length(replace(sample, image_size=(1, 1), image=None), 1.0).image_size == (1, 1)
