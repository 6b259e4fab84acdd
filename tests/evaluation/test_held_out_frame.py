from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.cli.main import main
from sightline.data.datasets.kitti_depth import points_from_depth_map
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.formats.rings import count_rings
from sightline.data.open import open_dataset
from sightline.depth_completion.examples import ExampleConfig, make_example
from sightline.depth_completion.robustness import HeldOutScoring, SimulatedDepthScoring
from sightline.evaluation.held_out_frame import CROP_SIZE, check_rings, split_depth, split_rings
from sightline.geometry.projection import sparse_depth_map
from sightline.ops.parallax import Parallax
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.sample import CameraLidarSample
from tests.data.trees import write_depth_drive
from tests.evaluation.held_out_sweeps import (
    SMALL,
    WALL_M,
    camera,
    scan,
    turning_sample,
    wall_sample,
)
from tests.reference import geometry as reference_geometry
from tests.reference import rings as reference


def test_rings_4_12_20_and_so_on_are_held_out_and_never_given():
    frame = split_rings(wall_sample())
    assert sorted(set(frame.rings.tolist())) == [ring for ring in range(45) if ring % 8 != 4]
    assert len(frame.sample.points) == len(frame.rings) == 30 * (45 - 6)


@pytest.mark.parametrize(
    ("beams", "rings"),
    [
        (64, [0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 13, 14, 15]),
        (32, [0, 2, 5, 7, 9, 11, 14]),
        (16, [0, 5, 9, 14]),
        (8, [0, 9]),
        (1, [0]),
    ],
)
def test_a_density_keeps_every_so_manieth_of_the_56_other_rings(beams, rings):
    frame = split_rings(wall_sample(num_rings=16))
    kept = frame.with_beams(beams)
    expected = torch.isin(frame.rings, torch.tensor(rings))
    assert torch.equal(kept.points, frame.sample.points[expected])
    assert sorted(set(frame.rings[expected].tolist())) == rings


@pytest.mark.parametrize("beams", [0, -8, 48, 128])
def test_beams_that_do_not_part_64_evenly_are_refused(beams):
    with pytest.raises(
        ValueError, match=f"beams must divide the sensor's 64 evenly .*, got {beams}"
    ):
        split_rings(wall_sample()).with_beams(beams)


scenes = st.integers(0, 2**32 - 1).map(np.random.default_rng)


@settings(max_examples=30)
@given(rng=scenes)
def test_the_truth_is_what_the_protocol_says_pixel_by_pixel(rng):
    image_size = (20, 24)
    ranges = rng.uniform(4, 40, (12, 16)).round(2)
    near = rng.random(12) < 0.5
    ranges[near] = ranges[near].min()
    sample = CameraLidarSample(
        sample_id="scene",
        calibration=camera(image_size, focal_px=22.0, baseline_m=0.3),
        image_size=image_size,
        points=scan(ranges, tangents=(-0.45, 0.45), top=0.3, step=0.05),
    )
    matrices = (
        sample.calibration.image_from_camera.tolist(),
        sample.calibration.camera_from_lidar.tolist(),
    )
    points = sample.points.double().tolist()
    seen = []
    for point in points:
        found = reference_geometry.project(point[:3], *matrices)
        if found and 0 <= found[0] < image_size[1] and 0 <= found[1] < image_size[0]:
            seen.append(point)
    held_out = [
        point
        for point, ring in zip(seen, reference.ring_numbers(seen), strict=True)
        if ring in (4, 12)
    ]
    maps = [
        reference_geometry.sparse_depth_map(some, *matrices, *image_size)
        for some in (held_out, seen)
    ]
    parallax = Parallax.from_calibration(sample.calibration)
    truth = reference.visible_truth(*maps, parallax.base_px_m, parallax.growth_m)
    expected = torch.tensor(truth, dtype=torch.float32)
    if expected.any():
        torch.testing.assert_close(split_rings(sample).truth_m, expected, rtol=1e-6, atol=0)
    else:
        with pytest.raises(ValueError, match="nothing to score"):
            split_rings(sample)


def wall_before(depth_m, baseline_m):
    """A wall at 10 m and, on the held-out ring, returns at `depth_m` right behind it."""
    ranges = np.full((9, 30), WALL_M)
    ranges[4] = depth_m
    return CameraLidarSample(
        sample_id="hidden",
        calibration=camera(SMALL, focal_px=60.0, baseline_m=baseline_m),
        image_size=SMALL,
        points=scan(ranges, tangents=(-0.6, 0.6)),
    )


def test_a_return_behind_a_wall_that_parallax_moves_before_it_is_left_out():
    seen, hidden = (
        int((split_rings(wall_before(30.0, baseline_m=baseline_m)).truth_m > 29).sum())
        for baseline_m in (0.0, 0.3)
    )
    assert seen == 30
    assert hidden <= 3  # at the border


def test_a_return_little_behind_its_surroundings_is_truth_whatever_the_parallax():
    assert split_rings(wall_before(11.0, baseline_m=0.5)).truth_m.max() == pytest.approx(11.0)


def test_the_crop_is_at_the_bottom_centre_and_takes_image_and_calibration_along():
    size = (CROP_SIZE[0] + 23, CROP_SIZE[1] + 8)
    image = torch.arange(3 * size[0] * size[1]).reshape(3, *size).to(torch.uint8)
    whole = replace(wall_sample(size), image=image, calibration=camera(size, focal_px=900.0))
    frame = split_rings(whole)
    assert frame.sample.image_size == CROP_SIZE == tuple(frame.truth_m.shape)
    assert torch.equal(frame.sample.image, image[:, 23:, 4:-4])
    points = frame.sample.points
    uncropped = sparse_depth_map(points, whole.calibration, size)
    cropped = sparse_depth_map(points, frame.sample.calibration, CROP_SIZE)
    assert cropped.count_nonzero() > 100
    assert torch.equal(cropped, uncropped[23:, 4:-4])


@pytest.mark.parametrize("size", [SMALL, (352, 100), (377, 1242), (375, 1243), (900, 1600)])
def test_an_image_smaller_than_the_crop_or_larger_than_kittis_is_kept_whole(size):
    sample = replace(wall_sample(size), calibration=camera(size, focal_px=0.75 * size[1]))
    assert split_rings(sample).sample.image_size == size


def test_rings_of_another_sensor_are_numbered_by_laser_before_the_cut():
    frame = split_rings(turning_sample(16, step=0.05))
    laser = (8 - frame.sample.points[:, 2].double() / (WALL_M * 0.05)).round().long()
    assert torch.equal(frame.rings, laser)
    assert set(laser.tolist()) == set(range(16)) - {4, 12}
    assert set(frame.rings[torch.isin(frame.rings, torch.tensor([0, 5, 9, 14]))].tolist())
    half = split_rings(turning_sample(16, step=0.05)).with_beams(4).points
    assert len(half) == len(frame.sample.points) * 4 / 14


def test_a_sensor_of_64_beams_is_scored_as_kittis_whether_its_sweeps_are_whole_or_cut():
    whole = turning_sample(64, step=0.008)
    cut = replace(whole, points=whole.points[whole.points[:, 0] > 0])
    assert count_rings(whole.points.numpy()) == 64
    assert torch.equal(split_rings(whole).truth_m, split_rings(cut).truth_m)
    assert torch.equal(split_rings(whole).rings, split_rings(cut).rings)


def test_the_method_gets_neither_labels_nor_depth():
    sample = replace(wall_sample(), depth=torch.ones(SMALL))
    assert split_rings(sample).sample.depth is None


def test_returns_that_the_camera_does_not_see_change_nothing():
    sample = wall_sample()
    beside = torch.tensor([[WALL_M, -20.0, 0.0, 0.5]])  # right of the image
    points = torch.cat((beside, sample.points))
    frame = split_rings(replace(sample, points=points))
    assert torch.equal(frame.truth_m, split_rings(sample).truth_m)
    assert torch.equal(frame.sample.points, split_rings(sample).sample.points)


def test_above_the_highest_return_of_the_columns_around_nothing_is_scored():
    sample = replace(wall_sample(), depth=torch.full(SMALL, 20.0))
    sparse_m = sparse_depth_map(sample.points, sample.calibration, SMALL)
    found = split_rings(sample, truth="depth_in_reach").truth_m > 0
    height, width = SMALL
    for row in range(height):
        for column in range(width):
            around = sparse_m[: row + 1, max(column - 15, 0) : column + 16]
            assert found[row, column] == bool((around > 0).any())
    assert found.any()
    assert not found.all()


def test_without_rings_the_whole_sweep_is_the_input_and_the_depth_in_reach_the_truth():
    sample = replace(wall_sample(), depth=torch.full(SMALL, 20.0))
    given, truth_m = split_depth(sample)
    expected = split_rings(sample, truth="depth_in_reach")
    assert torch.equal(truth_m, expected.truth_m)
    shuffled = sample.points[torch.randperm(len(sample.points))]
    again, same_m = split_depth(replace(sample, points=shuffled))
    assert torch.equal(again.points, shuffled)
    assert torch.equal(same_m, truth_m)
    assert given.depth is None
    with pytest.raises(ValueError, match="no depth up to 80 m below the highest return"):
        split_depth(replace(sample, points=torch.tensor([[-9.0, 0, 0, 0]])))


@pytest.mark.parametrize("points", [None, torch.zeros(0, 4)])
def test_a_frame_without_points_is_refused(points):
    with pytest.raises(ValueError, match="sample wall has no points"):
        split_rings(replace(wall_sample(), points=points))


def test_a_sweep_in_another_order_is_refused_by_name():
    points = wall_sample().points
    shuffled = points[torch.randperm(len(points), generator=torch.Generator().manual_seed(0))]
    with pytest.raises(ValueError, match=r"sample wall: .* elevations do not separate into rings"):
        split_rings(replace(wall_sample(), points=shuffled))


@pytest.mark.parametrize("num_lasers", [16, 32, 64, 128])
@pytest.mark.parametrize("order", ["by firing", "shuffled", "clockwise"])
def test_sweeps_in_another_order_than_kittis_are_scored_as_those_in_it(num_lasers, order):
    in_order = turning_sample(num_lasers, step=0.008)
    points = in_order.points
    if order == "by firing":
        points = points.reshape(num_lasers, -1, 4).transpose(0, 1).flip(1).reshape(-1, 4)
    elif order == "shuffled":
        points = points[torch.randperm(len(points), generator=torch.Generator().manual_seed(0))]
    else:
        points = points.reshape(num_lasers, -1, 4).flip(1).reshape(-1, 4)
    expected, found = split_rings(in_order), split_rings(replace(in_order, points=points))
    check_rings(found)
    assert found.sensor_beams == num_lasers
    assert torch.equal(found.truth_m, expected.truth_m)
    pairs = [
        sorted(zip(frame.rings.tolist(), map(tuple, frame.sample.points.tolist()), strict=True))
        for frame in (found, expected)
    ]
    assert pairs[0] == pairs[1]


def test_in_a_view_too_narrow_for_kittis_order_rings_of_firings_keep_their_lasers_numbers():
    in_order = turning_sample(64, step=0.008)
    narrow = replace(in_order, calibration=camera(SMALL, focal_px=4.0 * SMALL[1]))
    with pytest.raises(ValueError, match="as in zigzag scans"):
        split_rings(narrow)
    by_firing = in_order.points.reshape(64, -1, 4).transpose(0, 1).flip(1).reshape(-1, 4)
    frame = split_rings(replace(narrow, points=by_firing))
    lasers = (32 - frame.sample.points[:, 2].double() / (WALL_M * 0.008)).round().long()
    assert torch.equal(frame.rings, lasers)


def test_a_whole_sweep_of_64_beams_far_apart_is_scored_as_its_beams_are_counted():
    sample = turning_sample(64, step=0.024)  # 88 degrees in all, as an OS0-64 has
    found = split_rings(sample)
    check_rings(found)
    assert found.sensor_beams == 64
    cut = replace(sample, points=sample.points[sample.points[:, 0] > 5])
    with pytest.raises(
        ValueError,
        match="too far for the 64 beams that are assumed for a sweep cropped to the image",
    ):
        check_rings(split_rings(cut))


def test_whole_sweeps_and_those_cut_to_the_image_score_alike(kitti_root):
    samples = KittiObjectDataset(kitti_root, sample_list=["000000", "000006"], parts=("points",))
    for cut in (samples[0], samples[1]):
        values = np.fromfile(kitti_root / "full_sweeps" / f"{cut.sample_id}.bin", "<f4")
        whole = replace(cut, points=torch.from_numpy(values.reshape(-1, 4)))
        a, b = split_rings(cut), split_rings(whole)
        assert torch.equal(a.truth_m, b.truth_m)
        assert torch.equal(a.rings, b.rings)
        assert torch.equal(a.sample.points, b.sample.points)


def test_points_of_depth_maps_have_no_rings(tmp_path):
    sample = open_dataset(PACKAGED_FRAMES)[0]
    depth_m = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
    depth_m[:, ::2] = depth_m[:, ::2].roll(3, dims=0)  # real rings are not so even, either
    of_map = replace(sample, points=points_from_depth_map(depth_m, sample.calibration))
    with pytest.raises(ValueError, match="those of a depth map, row by row, which has no rings"):
        split_rings(of_map)
    of_map = replace(of_map, depth=depth_m)
    for config in (ExampleConfig(truth="depth", beams=(16,)), ExampleConfig(truth="held_out")):
        with pytest.raises(
            ValueError, match=r"no rings; .* set --data\S+truth depth and --data\S+beams "
        ):
            make_example(of_map, config, np.random.default_rng(0), training=False)
    write_depth_drive(tmp_path, tmp_path)
    tree = open_dataset(tmp_path)
    for dataset in (tree, open_dataset(tmp_path, sample_list=list(tree.sample_ids))):
        with pytest.raises(ValueError, match=r"is a depth completion tree, .* have no rings: give"):
            HeldOutScoring().check(dataset)
        SimulatedDepthScoring().check(dataset)
    assert main(["evaluate", "held-out", str(tmp_path), "--method", "linear"]) == 2
