import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.augmentation.sample_changes import (
    add_outliers,
    crop,
    drop_camera,
    keep_rings,
    mirror,
    points_in_view,
    rotate_extrinsics,
    thin_rings,
)
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.formats.rings import ring_numbers
from sightline.evaluation.held_out_frame import split_rings
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.projection import project_points, sparse_depth_map
from sightline.structures.labels import ObjectLabels
from sightline.structures.sample import CameraLidarSample
from tests.data.scenes import SIZE, few, rotation, sample_of, seeds
from tests.geometry.cameras import kitti_like_calibration


def depth_map(sample):
    return sparse_depth_map(sample.points, sample.calibration, sample.image_size)


def ring_sample(num_rings=40):
    """Rings in KITTI's order, cut to the view: the reflectance is the ring."""
    azimuths = np.radians([5, 20, 35, -35, -20, -5])
    rings = [
        (np.cos(a) * 10, np.sin(a) * 10, math.tan(math.radians(2 - 0.4 * ring)) * 10, ring / 64)
        for ring in range(num_rings)
        for a in azimuths
    ]
    return wide_sample(points=torch.tensor(rings, dtype=torch.float32))


def wide_sample(**parts):
    """Sweep of 40 degrees to either side, like KITTI's camera: rings end where azimuths jump."""
    wide = {"calibration": kitti_like_calibration(), "image_size": (375, 1242)}
    return sample_of(**{**wide, "image": None, "depth": None, **parts})


# Rings


@few
@given(st.integers(1, 9), st.data())
def test_thinning_keeps_every_nth_ring_from_the_first(keep_every, data):
    first = data.draw(st.integers(0, keep_every - 1))
    sample = ring_sample()
    thinned = thin_rings(sample, keep_every=keep_every, first=first).points
    points = sample.points[points_in_view(sample)]
    numbers = ring_numbers(points.numpy())
    expected = [
        point
        for point, ring in zip(points.tolist(), numbers, strict=True)
        if ring >= first and (ring - first) % keep_every == 0
    ]
    assert thinned.tolist() == expected


@pytest.mark.parametrize("keep_every", [1, 2, 4])
def test_a_sensor_of_128_beams_is_thinned_over_all_of_them(monkeypatch, keep_every):
    sample = ring_sample()
    rings = 127 - np.arange(int(points_in_view(sample).sum())) % 128
    name = "sightline.augmentation.sample_changes.rings_of_any_order"
    monkeypatch.setattr(name, lambda _: (rings, 128))
    kept = thin_rings(sample, keep_every=keep_every).points
    assert len(kept) == np.count_nonzero(rings % keep_every == 0)


def test_a_thinned_sweep_has_fewer_rings_and_the_rest_of_the_sample_stays():
    depth = torch.full((375, 1242), 7.0)
    sample = replace(ring_sample(), depth=depth)
    thinned = thin_rings(sample, keep_every=4)
    in_view = points_in_view(sample).sum().item()
    assert len(thinned.points) == pytest.approx(in_view / 4, abs=6)
    assert thinned.image is sample.image
    assert thinned.depth is sample.depth
    assert thinned.objects is sample.objects


def test_rings_are_thinned_as_the_held_out_tables_do(kitti_root):
    sample = KittiObjectDataset(kitti_root)[0]
    frame = split_rings(sample)
    kept = [ring for ring in range(64) if ring % 8 != 4][::4]
    assert torch.equal(
        keep_rings(frame.sample, frame.rings, kept).points, frame.with_beams(16).points
    )
    every = [thin_rings(sample, keep_every=8, first=first).points for first in range(8)]
    in_view = sample.points[points_in_view(sample)]
    assert sorted(map(tuple, torch.cat(every).tolist())) == sorted(map(tuple, in_view.tolist()))
    assert len(every[4]) + len(frame.sample.points) == len(in_view)


@pytest.mark.parametrize(("keep_every", "first"), [(0, 0), (4, 4), (2, -1)])
def test_a_first_ring_that_is_not_below_the_step_is_refused(keep_every, first):
    with pytest.raises(ValueError, match=f"which is {keep_every}; got {first}"):
        thin_rings(ring_sample(), keep_every=keep_every, first=first)


def test_points_out_of_order_cannot_be_thinned_and_the_error_names_the_sample():
    points = sample_of(num_points=3000).points
    with pytest.raises(ValueError, match=r"sample random 0: .*order of KITTI's files"):
        thin_rings(wide_sample(points=points), keep_every=2)


# The LiDAR's pose


@few
@given(*[st.floats(-10, 10)] * 3)
def test_points_turn_about_x_then_y_then_z_and_the_calibration_stays(yaw, pitch, roll):
    sample = sample_of(num_points=20)
    turned = rotate_extrinsics(sample, yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)
    matrix = (
        rotation("z", math.radians(yaw))
        @ rotation("y", math.radians(pitch))
        @ rotation("x", math.radians(roll))
    )
    expected = (matrix @ sample.points[:, :3].double().T).T
    torch.testing.assert_close(turned.points[:, :3].double(), expected, rtol=1e-6, atol=1e-5)
    assert torch.equal(turned.points[:, 3], sample.points[:, 3])
    assert turned.calibration is sample.calibration
    assert turned.depth is sample.depth


def test_convention_a_positive_yaw_error_moves_the_projected_points_to_the_left():
    sample = sample_of(points=torch.tensor([[20.0, 0.0, 0.0, 0.5]]))
    turned = rotate_extrinsics(sample, yaw_deg=1.0)
    before, after = (
        project_points(one.points[:, :3], one.calibration).pixels[0, 0] for one in (sample, turned)
    )
    # one degree at a focal length of 721.5 px; the camera sits 0.27 m further ahead
    assert (after - before).item() == pytest.approx(-12.76, abs=0.05)


# Sensors that fail


def test_a_dropped_camera_leaves_the_sweep_the_truth_and_the_labels():
    sample = sample_of()
    dropped = drop_camera(sample)
    assert dropped.image is None
    assert dropped.points is sample.points
    assert dropped.depth is sample.depth
    assert dropped.objects is sample.objects


@few
@given(seeds, st.floats(0, 1))
def test_outliers_are_the_share_of_the_returns_and_lie_on_their_rays(seed, share):
    sample = sample_of(seed)
    broken = add_outliers(sample, share=share, rng=np.random.default_rng(seed))
    before, after = sample.points.double(), broken.points.double()
    moved = (before != after).any(dim=1)
    assert moved.sum().item() == round(share * len(before))
    ranges = after[moved, :3].norm(dim=1)
    assert ((ranges > 1.499) & (ranges < 80.001)).all()
    directions = [one[:, :3] / one[:, :3].norm(dim=1, keepdim=True) for one in (before, after)]
    torch.testing.assert_close(*directions, rtol=0, atol=1e-6)
    assert torch.equal(before[:, 3], after[:, 3])


def test_outliers_spread_evenly_over_the_ranges_and_the_seed_decides_them():
    sample = sample_of(num_points=4000)
    first, again = (
        add_outliers(sample, share=1.0, rng=np.random.default_rng(5), nearest_m=10.0).points
        for _ in range(2)
    )
    counts = torch.histc(first[:, :3].norm(dim=1), bins=7, min=10, max=80)
    assert torch.equal(first, again)
    assert counts.sum() == 4000
    assert (abs(counts - 4000 / 7) < 100).all()


def test_a_return_at_the_origin_has_no_ray_and_stays():
    sample = sample_of(points=torch.zeros(3, 4))
    broken = add_outliers(sample, share=1.0, rng=np.random.default_rng(0))
    assert torch.equal(broken.points, sample.points)


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
def test_a_share_that_is_none_is_refused(share):
    with pytest.raises(ValueError, match=f"between 0 and 1, got {share}"):
        add_outliers(sample_of(), share=share, rng=np.random.default_rng(0))


# Mirror


@few
@given(seeds)
def test_the_depth_map_of_a_mirrored_sample_is_the_mirrored_depth_map(seed):
    sample = sample_of(seed)
    mirrored = mirror(sample)
    assert depth_map(sample).any()
    assert torch.equal(depth_map(mirrored), depth_map(sample).flip(-1))
    assert torch.equal(mirrored.image, sample.image.flip(-1))
    assert torch.equal(mirrored.depth, sample.depth.flip(-1))


@few
@given(seeds)
def test_mirrored_twice_is_the_sample_again(seed):
    sample = sample_of(seed)
    twice = mirror(mirror(sample))
    assert torch.equal(twice.points, sample.points)
    assert torch.equal(twice.image, sample.image)
    assert torch.equal(twice.world_from_lidar, sample.world_from_lidar)
    for name in ("image_from_camera", "camera_from_lidar"):
        pair = (getattr(one.calibration, name) for one in (twice, sample))
        torch.testing.assert_close(*pair, rtol=0, atol=1e-9)
    for name in ("boxes2d", "boxes3d"):
        pair = (getattr(one.objects, name).tensor for one in (twice, sample))
        torch.testing.assert_close(*pair, rtol=0, atol=1e-12)
    torch.testing.assert_close(twice.objects.alpha, sample.objects.alpha)


def test_mirrored_boxes_hold_the_mirrored_corners():
    sample = sample_of()
    mirrored = mirror(sample)
    corners, flipped = (one.objects.boxes3d.corners()[0] for one in (sample, mirrored))
    # left and right change places: front left becomes front right, rear right becomes rear left
    expected = corners[[1, 0, 3, 2, 5, 4, 7, 6]] * torch.tensor([1.0, -1, 1])
    torch.testing.assert_close(flipped, expected)
    assert mirrored.objects.boxes2d.tensor[0].tolist() == [399 - 220, 150, 399 - 100, 200]
    assert not mirrored.objects.boxes3d.tensor[1].any()


def test_the_observation_angle_of_a_mirrored_object_fits_its_box():
    objects = mirror(sample_of()).objects
    # straight ahead in the middle: no bearing, so alpha is rotation_y = -yaw - pi / 2
    ahead = replace(sample_of().objects, alpha=torch.tensor([-0.4 - math.pi / 2, -10.0]).double())
    alpha = mirror(sample_of(objects=ahead)).objects.alpha
    yaw = objects.boxes3d.yaws[0].item()
    assert alpha[0].item() == pytest.approx(-yaw - math.pi / 2)
    assert alpha[1].item() == -10.0


def test_a_mirrored_drive_is_driven_on_the_other_side():
    sample = sample_of()
    mirrored = mirror(sample)
    in_world, flipped = (
        one.points[:, :3].double() @ one.world_from_lidar[:3, :3].T + one.world_from_lidar[:3, 3]
        for one in (sample, mirrored)
    )
    torch.testing.assert_close(flipped, in_world * torch.tensor([1.0, -1, 1]).double())


def test_real_frames_mirror_exactly(kitti_root):
    for index in (0, 40, 80):
        sample = KittiObjectDataset(kitti_root)[index]
        assert torch.equal(depth_map(mirror(sample)), depth_map(sample).flip(-1))


def test_a_sample_without_parts_can_be_mirrored_and_cropped():
    bare = CameraLidarSample(
        sample_id="bare", calibration=kitti_like_calibration(), image_size=SIZE
    )
    for changed in (mirror(bare), crop(bare, top=1, left=2, height=100, width=300)):
        assert changed.image is changed.points is changed.depth is changed.objects is None


# Crop


@few
@given(seeds, st.data())
def test_a_crop_shows_a_part_of_the_image_the_truth_and_the_projected_points(seed, data):
    sample = sample_of(seed)
    top, left = data.draw(st.integers(0, SIZE[0] - 1)), data.draw(st.integers(0, SIZE[1] - 1))
    height = data.draw(st.integers(1, SIZE[0] - top))
    width = data.draw(st.integers(1, SIZE[1] - left))
    part = crop(sample, top=top, left=left, height=height, width=width)
    window = (..., slice(top, top + height), slice(left, left + width))
    assert torch.equal(part.image, sample.image[window])
    assert torch.equal(part.depth, sample.depth[window])
    assert torch.equal(depth_map(part), depth_map(sample)[window])


def labelled(boxes, truncation):
    """A sample with so many cars."""
    rows = torch.tensor([[20.0, 6, -1, 4, 1.6, 1.5, 0.4]] * len(boxes)).double()
    objects = ObjectLabels(
        class_names=tuple(f"Car{number}" for number in range(len(boxes))),
        boxes2d=Boxes2D(torch.tensor(boxes).double()),
        boxes3d=Boxes3D(rows),
        truncation=torch.tensor(truncation).double(),
        occlusion=torch.zeros(len(boxes), dtype=torch.long),
        alpha=torch.zeros(len(boxes)).double(),
    )
    return sample_of(objects=objects)


def test_a_crop_cuts_the_boxes_and_drops_what_it_does_not_show():
    boxes = [[10.0, 20, 30, 40], [50, 30, 90, 50], [200, 20, 300, 60], [70, 30, 110, 50]]
    part = crop(labelled(boxes, [0.0, 0.0, 0.5, -1.0]), top=10, left=40, height=51, width=51)
    assert part.objects.class_names == ("Car1", "Car3")
    assert part.objects.boxes2d.tensor.tolist() == [[10, 20, 50, 40], [30, 20, 50, 40]]
    assert part.objects.truncation.tolist() == [0.0, -1.0]
    assert len(part.objects.boxes3d) == 2


@few
@given(seeds, st.floats(0, 1), st.integers(0, 300), st.integers(1, 100))
def test_truncation_grows_by_the_share_of_the_box_that_a_crop_takes(seed, truncation, left, width):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 300), rng.uniform(0, 60)
    box = [x, y, x + rng.uniform(1, 90), y + rng.uniform(1, 50)]
    part = crop(labelled([box], [truncation]), top=0, left=left, height=SIZE[0], width=width)
    visible_width = min(box[2], left + width - 1) - max(box[0], left)
    if visible_width <= 0:
        assert len(part.objects) == 0
    else:
        expected = 1 - (1 - truncation) * visible_width / (box[2] - box[0])
        assert part.objects.truncation.item() == pytest.approx(expected)


@pytest.mark.parametrize(
    "window",
    [(-1, 0, 10, 10), (0, 0, 121, 10), (115, 0, 6, 10), (0, 398, 10, 3), (0, 0, 0, 10)],
)
def test_a_crop_beyond_the_image_is_refused(window):
    top, left, height, width = window
    with pytest.raises(ValueError, match=r"does not lie within sample random 0.*120x400"):
        crop(sample_of(), top=top, left=left, height=height, width=width)


# Requirements of all changes


@pytest.mark.parametrize(
    "change",
    [
        lambda sample: thin_rings(sample, keep_every=2),
        lambda sample: rotate_extrinsics(sample, yaw_deg=1.0),
        lambda sample: add_outliers(sample, share=0.1, rng=np.random.default_rng(0)),
    ],
)
def test_what_changes_the_sweep_refuses_a_sample_without_one(change):
    with pytest.raises(ValueError, match="sample random 0 has no sweep to change"):
        change(sample_of(points=None))
