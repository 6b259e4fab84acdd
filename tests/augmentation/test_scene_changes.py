import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.augmentation.sample_changes import mirror
from sightline.augmentation.scene_changes import resize, scale_scene, turn_scene
from sightline.geometry.projection import project_points
from sightline.structures.sample import CameraLidarSample
from tests.data.scenes import SIZE, few, sample_of, seeds
from tests.geometry.cameras import kitti_like_calibration


def projected(sample):
    return project_points(sample.points[:, :3].double(), sample.calibration)


def membership(sample):
    """Mask of points in slightly enlarged boxes, so that none is on a face by rounding."""
    objects = sample.objects
    return objects.boxes3d.contain(sample.points[:, :3].double())


def with_points_in_the_box(seed):
    """A scene with points in and around the labelled car."""
    sample = sample_of(seed)
    offsets = torch.rand(200, 3, generator=torch.Generator().manual_seed(seed)) * 4 - 2
    points = sample.points.clone()
    points[:200, :3] = offsets + sample.objects.boxes3d.centers[0].float()
    return replace(sample, points=points)


@few
@given(seeds, st.floats(-400, 400))
def test_a_turned_scene_is_seen_as_before_and_its_boxes_hold_the_same_points(seed, yaw_deg):
    sample = with_points_in_the_box(seed)
    turned = turn_scene(sample, yaw_deg)
    for found, expected in zip(projected(turned), projected(sample), strict=True):
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-2, equal_nan=True)
    assert (membership(turned) != membership(sample)).float().mean() < 0.01
    assert membership(sample)[0].any()
    bearing = torch.atan2(sample.points[:, 1], sample.points[:, 0])
    turned_bearing = torch.atan2(turned.points[:, 1], turned.points[:, 0])
    difference = turned_bearing - bearing - math.radians(yaw_deg)
    assert (torch.remainder(difference + 1, 2 * math.pi) - 1).abs().max() < 1e-3
    assert turned.objects.boxes3d.tensor[1].tolist() == [0] * 7
    assert (turned.objects.boxes3d.yaws.abs() <= math.pi).all()


@few
@given(seeds, st.floats(-180, 180))
def test_a_turned_scene_stands_at_the_same_place_of_the_world(seed, yaw_deg):
    sample = sample_of(seed)
    turned = turn_scene(sample, yaw_deg)
    ones = torch.ones(len(sample.points), 1)
    places = [
        torch.cat((each.points[:, :3], ones), dim=1).double() @ each.world_from_lidar.T
        for each in (sample, turned)
    ]
    torch.testing.assert_close(*places, rtol=0, atol=1e-4)


@few
@given(seeds, st.floats(0.5, 2))
def test_a_scaled_scene_is_seen_as_before_but_farther_away(seed, factor):
    sample = with_points_in_the_box(seed)
    scaled = scale_scene(sample, factor)
    pixels, depths = projected(scaled)
    expected = projected(sample)
    torch.testing.assert_close(pixels, expected.pixels, rtol=1e-4, atol=1e-2, equal_nan=True)
    torch.testing.assert_close(depths, expected.depths * factor, rtol=1e-5, atol=1e-4)
    torch.testing.assert_close(scaled.depth, sample.depth * factor)
    assert (membership(scaled) != membership(sample)).float().mean() < 0.01
    torch.testing.assert_close(scaled.objects.boxes3d.sizes, sample.objects.boxes3d.sizes * factor)
    assert torch.equal(scaled.objects.boxes3d.yaws, sample.objects.boxes3d.yaws)


@pytest.mark.parametrize("factor", [0.0, -1.0, math.inf, math.nan])
def test_a_scene_is_not_scaled_to_nothing(factor):
    with pytest.raises(ValueError, match="positive, finite factor"):
        scale_scene(sample_of(), factor)


@few
@given(seeds, st.integers(1, 300), st.integers(1, 900))
def test_in_a_resized_image_points_and_boxes_stay_where_they_are_on_it(seed, height, width):
    sample = sample_of(seed)
    resized = resize(sample, height, width)
    scale = torch.tensor([width / SIZE[1], height / SIZE[0]], dtype=torch.float64)
    before, after = projected(sample), projected(resized)
    torch.testing.assert_close(after.pixels + 0.5, (before.pixels + 0.5) * scale, equal_nan=True)
    assert torch.equal(after.depths, before.depths)
    boxes = (sample.objects.boxes2d.tensor + 0.5) * scale.repeat(2)
    torch.testing.assert_close(resized.objects.boxes2d.tensor + 0.5, boxes)
    assert resized.image.shape == (3, height, width)
    assert set(resized.depth.flatten().tolist()) <= set(sample.depth.flatten().tolist())


def test_an_image_of_half_the_size_has_the_means_of_its_pixels():
    sample = sample_of()
    half = resize(sample, SIZE[0] // 2, SIZE[1] // 2)
    blocks = sample.image.float().reshape(3, SIZE[0] // 2, 2, SIZE[1] // 2, 2).mean(dim=(2, 4))
    assert (half.image.float() - blocks).abs().max() <= 0.5


def test_an_image_of_fewer_rows_alone_has_their_means():
    sample = sample_of()
    image = torch.zeros_like(sample.image)
    image[:, ::4] = 200
    lower = resize(replace(sample, image=image), SIZE[0] // 4, SIZE[1])
    assert set(lower.image.flatten().tolist()) == {50}


def test_a_depth_of_twice_the_size_repeats_its_pixels():
    sample = sample_of()
    twice = resize(sample, 2 * SIZE[0], 2 * SIZE[1])
    repeated = sample.depth.repeat_interleave(2, dim=0).repeat_interleave(2, dim=1)
    assert torch.equal(twice.depth, repeated)


def test_an_image_without_pixels_is_refused():
    with pytest.raises(ValueError, match="at least 1x1 pixels, got 0x5"):
        resize(sample_of(), 0, 5)


def test_turning_commutes_with_the_mirror():
    sample = sample_of()
    one, other = mirror(turn_scene(sample, 30.0)), turn_scene(mirror(sample), -30.0)
    torch.testing.assert_close(one.points, other.points)
    torch.testing.assert_close(one.objects.boxes3d.tensor, other.objects.boxes3d.tensor)


def test_a_sample_without_parts_can_be_changed():
    bare = CameraLidarSample(
        sample_id="bare", calibration=kitti_like_calibration(), image_size=SIZE
    )
    for changed in (resize(bare, 10, 20), turn_scene(bare, 5.0), scale_scene(bare, 1.1)):
        assert changed.image is changed.points is changed.depth is changed.objects is None
