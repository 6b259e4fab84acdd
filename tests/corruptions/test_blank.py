import numpy as np
from hypothesis import given

from sightline.corruptions.blank import CameraBlank, LidarBlank
from sightline.geometry.projection import dhi_image
from tests.corruptions.samples import described


@given(scene=described)
def test_a_blank_camera_is_black_everywhere(scene):
    sample = scene.sample()
    found = CameraBlank().corrupt(sample, np.random.default_rng(0))
    if sample.image is not None:
        assert found.sample.image.shape == sample.image.shape
        assert not found.sample.image.any()
        assert found.camera_mask.all()


@given(scene=described)
def test_a_blank_lidar_sends_sweeps_without_points(scene):
    sample = scene.sample()
    found = LidarBlank().corrupt(sample, np.random.default_rng(0))
    if sample.points is not None:
        assert found.sample.points.shape == (0, 4)
        assert not dhi_image(found.sample.points, sample.calibration, sample.image_size).any()
        assert found.lidar_mask.all()
