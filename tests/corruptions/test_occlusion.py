from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.corruptions.occlusion import (
    CameraOcclusion,
    LidarOcclusion,
    occlude_image,
    occlude_points,
)
from sightline.corruptions.pixel_box import BoxDrawing, PixelBox
from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import sparse_depth_map
from tests.corruptions.samples import ANYWHERE, LABELS, described, objects_at
from tests.data.scenes import SIZE, sample_of, seeds
from tests.geometry.cameras import kitti_like_calibration
from tests.reference import corruptions as reference

DRAWING = BoxDrawing()
SHARES = ((0.2, 0.6), (0.3, 0.65))  # width, height: half of it and more, as the picture shows


@st.composite
def boxes(draw, size=SIZE):
    rows = sorted(draw(st.tuples(st.integers(0, size[0]), st.integers(0, size[0]))))
    columns = sorted(draw(st.tuples(st.integers(0, size[1]), st.integers(0, size[1]))))
    return PixelBox(columns[0], rows[0], columns[1], rows[1])


def centres_of(sample):
    """Centres of the objects on which a box may be drawn."""
    if sample.objects is None or "DontCare" in sample.objects.class_names:
        return []
    boxes2d = sample.objects.boxes2d.tensor.tolist()
    return [((x_min + x_max) / 2, (y_min + y_max) / 2) for x_min, y_min, x_max, y_max in boxes2d]


@given(scene=described, seed=seeds, drawing=st.sampled_from([DRAWING, ANYWHERE]))
def test_a_drawn_box_keeps_to_the_rule(scene, seed, drawing):
    sample = scene.sample()
    box = drawing.draw(sample, np.random.default_rng(seed))
    height, width = sample.image_size
    on_objects = centres_of(sample) if drawing.placement == "object" else []
    assert any(
        reference.can_be_drawn(box.left, box.right, width, SHARES[0], x)
        and reference.can_be_drawn(box.top, box.bottom, height, SHARES[1], y)
        for x, y in on_objects or [(None, None)]
    )


def test_sizes_are_drawn_evenly_over_their_whole_range():
    sample = sample_of(image=None, depth=None, image_size=(3000, 9000), objects=None)
    middle = replace(sample, objects=objects_at((4400, 1400, 4600, 1600)))
    rng = np.random.default_rng(0)
    drawn = [DRAWING.draw(middle, rng) for _ in range(2000)]
    for sizes, (low, high) in (
        (np.array([box.right - box.left for box in drawn]) / 9000, SHARES[0]),
        (np.array([box.bottom - box.top for box in drawn]) / 3000, SHARES[1]),
    ):
        counts, _ = np.histogram(sizes, bins=10, range=(low - 1e-3, high + 1e-3))
        assert counts.sum() == 2000
        assert counts.min() > 150  # of 200 expected: 4 standard deviations less are 146
        assert counts.max() < 255


def test_each_object_is_as_likely_as_any_other_and_dont_care_regions_are_none():
    sample = sample_of(objects=LABELS[3])  # centres at x 25 and 380
    dont_care = replace(sample, objects=replace(LABELS[3], class_names=("DontCare", "Cyclist")))
    rng = np.random.default_rng(0)
    left = [DRAWING.draw(sample, rng).left == 0 for _ in range(1000)]
    assert 430 < sum(left) < 570
    assert all(DRAWING.draw(dont_care, rng).right == SIZE[1] for _ in range(100))


def test_without_objects_the_box_is_anywhere():
    sample = sample_of(objects=None)
    rng = np.random.default_rng(0)
    drawn = [DRAWING.draw(sample, rng) for _ in range(1000)]
    covered = torch.stack([box.mask(SIZE) for box in drawn]).double().mean(dim=0)
    # The mean shares of the sides multiplied; in a corner a quarter of it.
    assert covered[SIZE[0] // 2, SIZE[1] // 2].item() == pytest.approx(0.19, abs=0.04)
    assert covered[0, 0].item() == pytest.approx(0.19 / 4, abs=0.02)
    assert covered[-1, -1].item() == pytest.approx(0.19 / 4, abs=0.02)


@given(box=boxes((8, 11)), seed=seeds)
def test_an_image_is_occluded_as_loops_say(box, seed):
    image = np.random.default_rng(seed).integers(0, 256, (3, 8, 11), dtype=np.uint8)
    found = occlude_image(torch.from_numpy(image), box)
    corners = (box.left, box.top, box.right, box.bottom)
    assert found.tolist() == reference.occluded_image(image.tolist(), *corners)


@given(seed=seeds, box=boxes())
def test_points_are_occluded_as_loops_say(seed, box):
    sample = sample_of(seed, num_points=60)
    calibration = sample.calibration
    found = occlude_points(sample.points, calibration, box)
    expected = reference.points_beside(
        sample.points.tolist(),
        calibration.image_from_camera.tolist(),
        calibration.camera_from_lidar.tolist(),
        *(box.left, box.top, box.right, box.bottom),
    )
    assert found.tolist() == expected


def test_a_point_on_the_border_of_two_pixels_is_on_the_latter_as_in_depth_maps():
    camera_from_lidar = torch.tensor(
        [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=torch.float64
    )
    plain = Calibration(
        image_from_camera=torch.eye(3, 4, dtype=torch.float64), camera_from_lidar=camera_from_lidar
    )
    point = torch.tensor([[1.0, -2.5, -3.5, 0.0]])  # of pixel (2.5, 3.5)
    assert sparse_depth_map(point, plain, (9, 9))[4, 3] == 1
    for box in (PixelBox(0, 0, 3, 9), PixelBox(0, 0, 9, 4)):
        assert len(occlude_points(point, plain, box)) == 1
    for box in (PixelBox(3, 0, 9, 9), PixelBox(0, 4, 9, 9)):
        assert len(occlude_points(point, plain, box)) == 0


def test_points_behind_and_beside_the_camera_stay():
    behind = torch.tensor([[-10.0, 0.0, 0.0, 0.5], [0.0, 9.0, 0.0, 0.5], [20.0, 0.0, 0.0, 0.5]])
    everything = PixelBox(0, 0, 1242, 375)
    found = occlude_points(behind, kitti_like_calibration(), everything)
    assert torch.equal(found, behind[:2])


@pytest.mark.parametrize("corruption", [CameraOcclusion(), LidarOcclusion()], ids=str)
@given(seed=seeds)
def test_the_mask_is_the_recorded_box_and_where_the_sensor_sees_nothing(corruption, seed):
    white = torch.full((3, *SIZE), 255, dtype=torch.uint8)
    sample = sample_of(image=white)
    found = corruption.corrupt(sample, np.random.default_rng(seed))
    mask = found.camera_mask if corruption.sensors == ("camera",) else found.lidar_mask
    assert torch.equal(mask, PixelBox(*found.record.parameters["box_px"]).mask(SIZE))
    if corruption.sensors == ("camera",):
        assert torch.equal(mask, (found.sample.image == 0).all(dim=0))
        assert torch.equal(~mask, (found.sample.image == 255).all(dim=0))


def test_camera_and_lidar_are_occluded_independently():
    sample = sample_of()
    boxes_of = [
        [kind.corrupt(sample, np.random.default_rng(s)).record.parameters["box_px"] for s in (1, 2)]
        for kind in (CameraOcclusion(), LidarOcclusion())
    ]
    assert boxes_of[0] == boxes_of[1]  # the same rule
    assert boxes_of[0][0] != boxes_of[0][1]
