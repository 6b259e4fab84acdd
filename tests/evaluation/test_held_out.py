from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from sightline.data.kitti_object import KittiObjectDataset
from sightline.data.rings import count_beams
from sightline.evaluation.held_out import evaluate_held_out
from sightline.evaluation.held_out_frame import CROP_SIZE, split_rings
from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import sparse_depth_map
from sightline.structures.predictions import DepthMap
from sightline.structures.sample import CameraLidarSample
from tests.reference import geometry as reference_geometry
from tests.reference import rings as reference

WALL_M = 10.0
SMALL = (60, 80)


def camera(image_size, *, focal_px=300.0, baseline_m=0.0):
    """Looks along x; its pixels are square. Sits `baseline_m` right of the LiDAR."""
    height, width = image_size
    intrinsics = [[focal_px, 0, width / 2, 0], [0, focal_px, height / 2, 0], [0, 0, 1, 0]]
    mount = [[0, -1, 0, -baseline_m], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
    return Calibration(
        image_from_camera=torch.tensor(intrinsics, dtype=torch.float64),
        camera_from_lidar=torch.tensor(mount, dtype=torch.float64),
    )


def scan(ranges_m, *, tangents=(-0.13, 0.13), top=0.09, step=0.004):
    """One row of depths for each ring, from the top; from the right edge to the left."""
    num_rings, num_points = ranges_m.shape
    across = np.linspace(*tangents, num_points)
    down = top - step * np.arange(num_rings)
    left, up = across * ranges_m, down[:, None] * ranges_m
    points = np.stack((ranges_m, left, up, np.full_like(ranges_m, 0.5)), axis=-1)
    return torch.from_numpy(points.reshape(-1, 4).astype(np.float32))


def wall_sample(image_size=SMALL, *, num_rings=45, depth_m=WALL_M):
    # azimuths beyond 15 degrees on both sides, so that each ring ends with a jump back
    ranges = np.full((num_rings, 30), depth_m)
    return CameraLidarSample(
        sample_id="wall",
        calibration=camera(image_size, focal_px=60.0),
        image_size=image_size,
        points=scan(ranges, tangents=(-0.6, 0.6)),
    )


def completed(depth_m):
    depth_m = torch.as_tensor(np.asarray(depth_m), dtype=torch.float32)
    return DepthMap(depth_m=depth_m, valid=depth_m > 0)


def flat(depth_m):
    return lambda sample: completed(np.full(sample.image_size, depth_m))


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
    expected = torch.tensor(reference.visible_truth(*maps), dtype=torch.float32)
    if expected.any():
        torch.testing.assert_close(split_rings(sample).truth_m, expected, rtol=1e-6, atol=0)
    else:
        with pytest.raises(ValueError, match="nothing to score"):
            split_rings(sample)


def hidden_at(depth_m):
    """A wall at 10 m and, on the held-out ring, returns at `depth_m` right behind it."""
    ranges = np.full((9, 30), WALL_M)
    ranges[4] = depth_m
    return CameraLidarSample(
        sample_id="hidden",
        calibration=camera(SMALL, focal_px=60.0),
        image_size=SMALL,
        points=scan(ranges, tangents=(-0.6, 0.6)),
    )


def test_a_return_up_to_15_percent_and_half_a_metre_behind_its_surroundings_is_truth():
    assert split_rings(hidden_at(11.99)).truth_m.max() == pytest.approx(11.99)


def test_a_return_farther_behind_is_hidden_from_the_camera_and_left_out():
    with pytest.raises(ValueError, match="sample hidden has no return of a held-out ring in view"):
        split_rings(hidden_at(12.01))


def point_at(row, column, depth_m, *, focal_px=60.0, image_size=SMALL):
    """The point that `camera` sees there."""
    height, width = image_size
    left, up = -(column - width / 2) / focal_px, -(row - height / 2) / focal_px
    return (depth_m, left * depth_m, up * depth_m, 0.5)


@pytest.mark.parametrize(
    ("rows", "columns", "hides"),
    [
        (0, 0, True),
        (7, 0, True),
        (-7, 0, True),
        (0, 3, True),
        (0, -3, True),
        (7, -3, True),
        (8, 0, False),
        (-8, 0, False),
        (0, 4, False),
        (0, -4, False),
    ],
)
def test_only_points_within_15_rows_and_7_columns_hide_a_return(rows, columns, hides):
    rings = [[point_at(2, 77, WALL_M), point_at(2, 2, WALL_M)] for _ in range(5)]
    rings[3].insert(1, point_at(30 + rows, 40 + columns, WALL_M))
    rings[4].insert(1, point_at(30, 40, 30.0))
    points = torch.tensor([point for ring in rings for point in ring])
    truth = split_rings(replace(wall_sample(), points=points)).truth_m
    assert truth[30, 40] == (0 if hides else 30)
    assert truth[2, 77] == WALL_M


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


def turning_sample(num_lasers, *, image_size=SMALL, sample_id="turn", step=0.02):
    """A whole sweep of the inside of a cylinder, of lasers around the horizon."""
    azimuth = np.radians(np.arange(0.5, 360, 2.0))
    up = step * (num_lasers / 2 - np.arange(num_lasers))
    sweep = [(np.cos(azimuth), np.sin(azimuth), np.full_like(azimuth, each)) for each in up]
    xyz = WALL_M * np.stack(sweep).transpose(0, 2, 1).reshape(-1, 3)
    points = np.concatenate((xyz, np.full((len(xyz), 1), 0.5)), axis=1).astype(np.float32)
    return replace(wall_sample(image_size), sample_id=sample_id, points=torch.from_numpy(points))


@pytest.mark.parametrize(
    ("num_lasers", "beams"), [(16, (16, 8, 4, 2)), (31, (32, 16, 8, 4)), (128, (128, 64, 32, 16))]
)
def test_the_beams_of_another_sensor_are_counted_and_printed(num_lasers, beams):
    sample = turning_sample(num_lasers, step=0.6 / num_lasers)
    report = evaluate_held_out([sample], flat(10))
    assert tuple(score.beams for score in report.scores) == beams
    assert report.sensor_beams == report.to_json()["sensor_beams"] == beams[0]
    assert report.to_json()["image_sizes"] == [list(SMALL)]
    assert f"a sensor of {beams[0]} beams, images of 80x60" in report.table().title


def test_rings_of_another_sensor_are_numbered_by_laser_before_the_cut():
    frame = split_rings(turning_sample(16, step=0.05))
    laser = (8 - frame.sample.points[:, 2].double() / (WALL_M * 0.05)).round().long()
    assert torch.equal(frame.rings, laser)
    assert set(laser.tolist()) == set(range(16)) - {4, 12}
    assert set(frame.rings[torch.isin(frame.rings, torch.tensor([0, 5, 9, 14]))].tolist())
    half = split_rings(turning_sample(16, step=0.05)).with_beams(4).points
    assert len(half) == len(frame.sample.points) * 4 / 14


def test_densities_that_the_sensor_does_not_have_are_refused_with_its_number():
    with pytest.raises(ValueError, match=r"sensor's 32 evenly \(32, 16, 8, 4, ..\), got 64"):
        evaluate_held_out([turning_sample(32)], flat(10), beams=(64,))


def test_frames_of_two_sensors_are_not_scored_as_one():
    samples = [turning_sample(32), turning_sample(16, sample_id="other", step=0.04)]
    with pytest.raises(
        ValueError, match=r"sample other .* of 16 beams, the frames before it by one"
    ):
        evaluate_held_out(samples, flat(10))


def test_a_cut_sweep_of_fewer_beams_is_not_scored_as_one_of_64():
    sample = turning_sample(32)
    cut = replace(sample, points=sample.points[sample.points[:, 0] > 0])
    with pytest.raises(ValueError, match=r"sample turn: the rings .* degrees apart, too far for"):
        evaluate_held_out([cut], flat(10))


def test_a_sensor_of_64_beams_is_scored_as_kittis_whether_its_sweeps_are_whole_or_cut():
    whole = turning_sample(64, step=0.008)
    cut = replace(whole, points=whole.points[whole.points[:, 0] > 0])
    assert count_beams(whole.points.numpy()) == 64
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


def test_a_perfect_completion_has_no_error_and_one_that_is_off_by_a_metre_has_1000_mm():
    assert all(score.rmse_mm == 0 for score in evaluate_held_out([wall_sample()], flat(10)).scores)
    report = evaluate_held_out([wall_sample()], flat(11), beams=(32,))
    (score,) = report.scores
    assert (score.beams, score.rmse_mm, score.mae_mm, score.coverage) == (32, 1000, 1000, 1)
    assert score.median_mm == 1000


def test_simulated_frames_can_be_scored_on_their_dense_depth():
    depth_m = torch.full(SMALL, 20.0)
    depth_m[0], depth_m[1] = 0, 81  # none, and too far
    sample = replace(wall_sample(), depth=depth_m)
    report = evaluate_held_out([sample], flat(17), truth="depth")
    assert [score.median_mm for score in report.scores] == [3000] * 4
    assert report.to_json()["truth"] == "depth"
    frame = split_rings(sample, truth="depth")
    assert torch.equal(frame.truth_m, torch.where(depth_m <= 80, depth_m, 0.0))
    assert torch.equal(frame.sample.points, split_rings(sample).sample.points)
    with pytest.raises(ValueError, match="sample wall has no depth map to be scored on"):
        evaluate_held_out([wall_sample()], flat(17), truth="depth")


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


def test_scores_are_means_over_frames_and_not_over_pixels():
    half = wall_sample(num_rings=8)  # one held-out ring where the other frame has six
    report = evaluate_held_out([wall_sample(), replace(half, sample_id="half")], flat(13))
    assert report.scores[0].mae_mm == 3000
    truths = {"wall": 12.0, "half": 14.0}  # errors of 2 and 4 m
    report = evaluate_held_out(
        [wall_sample(), replace(half, sample_id="half")],
        lambda sample: completed(np.full(sample.image_size, truths[sample.sample_id])),
        beams=(64,),
    )
    assert report.scores[0].rmse_mm == pytest.approx(3000)


@settings(max_examples=10)
@given(rng=scenes)
def test_pixels_without_prediction_take_the_nearest_one(rng):
    truth = split_rings(wall_sample(num_rings=8)).truth_m.double().numpy()
    depth = np.where(rng.random(SMALL) < 0.03, rng.uniform(5, 20, SMALL), 0).astype(np.float32)
    errors = [
        [abs(near - truth[row, column]) for near in reference.nearest_depths(depth, row, column)]
        for row, column in np.argwhere(truth > 0)
    ]
    sample = wall_sample(num_rings=8)
    (score,) = evaluate_held_out([sample], lambda _: completed(depth), beams=(64,)).scores
    lowest, highest = (1e3 * np.mean([pick(ties) for ties in errors]) for pick in (min, max))
    assert lowest * 0.999999 <= score.mae_mm <= highest * 1.000001
    assert score.coverage == pytest.approx((depth > 0)[truth > 0].mean())


def test_the_report_names_frames_and_densities():
    report = evaluate_held_out([wall_sample()], flat(11), beams=(64, 8))
    content = report.to_json()
    assert content["frames"] == 1
    assert list(content["beams"]) == list(content["per_frame"]["wall"]) == ["64", "8"]
    assert content["beams"]["8"]["mae_mm"] == content["beams"]["8"]["median_mm"] == 1000
    assert report.table().row_count == 2


@pytest.mark.parametrize(
    ("complete", "message"),
    [
        (lambda _: completed(np.ones((3, 4))), "3x4 for sample wall with 64 beams, expected 60x80"),
        (flat(np.nan), "not finite for sample wall with 64 beams"),
        (flat(0), "no depth at all for sample wall with 64 beams"),
    ],
)
def test_a_bad_answer_of_the_method_names_the_sample(complete, message):
    with pytest.raises(ValueError, match=message):
        evaluate_held_out([wall_sample()], complete)


@pytest.mark.parametrize("points", [None, torch.zeros(0, 4)])
def test_a_frame_without_points_is_refused(points):
    with pytest.raises(ValueError, match="sample wall has no points"):
        split_rings(replace(wall_sample(), points=points))


def test_a_sweep_in_another_order_is_refused_by_name():
    points = wall_sample().points
    shuffled = points[torch.randperm(len(points), generator=torch.Generator().manual_seed(0))]
    with pytest.raises(ValueError, match="sample wall: the azimuth of the sweep starts again"):
        split_rings(replace(wall_sample(), points=shuffled))


def test_nothing_to_score_is_an_error():
    with pytest.raises(ValueError, match="there is no frame to score"):
        evaluate_held_out([], flat(1))
    with pytest.raises(ValueError, match="beams is empty"):
        evaluate_held_out([wall_sample()], flat(1), beams=())


def nearest_neighbour(sample):
    sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size).numpy()
    rows, columns = ndimage.distance_transform_edt(
        sparse == 0, return_distances=False, return_indices=True
    )
    return completed(sparse[rows, columns])


def test_nearest_neighbour_on_real_frames_scores_what_the_published_table_says(kitti_root):
    samples = KittiObjectDataset(kitti_root, sample_list="sample_val", parts=("points",))
    table = {64: (3050, 1029), 8: (5204, 2130)}
    report = evaluate_held_out(
        (samples[index] for index in range(len(samples))), nearest_neighbour, beams=(64, 8)
    )
    assert len(report.frames) == 29
    for score in report.scores:
        assert (score.rmse_mm, score.mae_mm) == pytest.approx(table[score.beams], rel=0.005)


def test_whole_sweeps_and_those_cut_to_the_image_score_alike(kitti_root):
    samples = KittiObjectDataset(kitti_root, sample_list=["000000", "000006"], parts=("points",))
    for cut in (samples[0], samples[1]):
        values = np.fromfile(kitti_root / "full_sweeps" / f"{cut.sample_id}.bin", "<f4")
        whole = replace(cut, points=torch.from_numpy(values.reshape(-1, 4)))
        a, b = split_rings(cut), split_rings(whole)
        assert torch.equal(a.truth_m, b.truth_m)
        assert torch.equal(a.rings, b.rings)
        assert torch.equal(a.sample.points, b.sample.points)
