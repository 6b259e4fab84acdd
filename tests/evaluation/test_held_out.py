from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.evaluation.held_out import evaluate_held_out
from sightline.evaluation.held_out_frame import split_rings
from sightline.geometry.projection import sparse_depth_map
from sightline.structures.predictions import DepthMap
from tests.evaluation.held_out_sweeps import (
    SMALL,
    turning_sample,
    wall_sample,
)
from tests.reference import rings as reference

scenes = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def completed(depth_m):
    depth_m = torch.as_tensor(np.asarray(depth_m), dtype=torch.float32)
    return DepthMap(depth_m=depth_m, valid=depth_m > 0)


def flat(depth_m):
    return lambda sample: completed(np.full(sample.image_size, depth_m))


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


@pytest.mark.parametrize(("num_lasers", "counted"), [(20, 32), (40, 64), (80, 128)])
def test_sensors_of_other_numbers_of_rings_are_told(num_lasers, counted):
    sample = turning_sample(num_lasers, step=0.6 / num_lasers)
    said = f"turn has {num_lasers} rings with returns and is counted as of {counted} beams: "
    with pytest.warns(UserWarning, match=said):
        evaluate_held_out([sample], flat(10))


def test_points_in_a_vehicles_frame_are_told_once():
    samples = [
        replace(turning_sample(16, step=0.0375), sample_id=name, lidar_height_m=0.02)
        for name in ("first", "second")
    ]
    with pytest.warns(UserWarning, match="own frame") as caught:
        evaluate_held_out(samples, flat(10))
    (warning,) = caught
    said = "points of first have their origin 0.02 m above the road, as in a vehicle's frame"
    assert said in str(warning.message)
    evaluate_held_out([replace(each, lidar_height_m=0.4) for each in samples], flat(10))


def test_densities_that_the_sensor_does_not_have_are_refused_with_its_number():
    with pytest.raises(ValueError, match=r"sensor's 32 evenly \(32, 16, 8, 4, ..\), got 64"):
        evaluate_held_out([turning_sample(32)], flat(10), beams=(64,))


def test_frames_of_two_sensors_are_not_scored_as_one():
    samples = [turning_sample(32), turning_sample(16, sample_id="other", step=0.04)]
    with pytest.raises(
        ValueError,
        match=r"sample other .* of 16 beams \(16 rings\), the frames before it by one of 32 "
        r"\(32 rings\); score the sensors one by one, or if they are one, give sweeps in its own",
    ):
        evaluate_held_out(samples, flat(10))


def test_a_cut_sweep_of_fewer_beams_is_not_scored_as_one_of_64():
    sample = turning_sample(32)
    cut = replace(sample, points=sample.points[sample.points[:, 0] > 0])
    with pytest.raises(ValueError, match=r"sample turn: the rings .* degrees apart, too far for"):
        evaluate_held_out([cut], flat(10))


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


def test_frames_of_one_name_are_numbered_in_the_file():
    names = ("wall", "wall", "wall (2)", "wall")
    samples = [replace(wall_sample(), sample_id=name) for name in names]
    content = evaluate_held_out(samples, flat(11), beams=(64,)).to_json()
    assert list(content["per_frame"]) == ["wall", "wall (3)", "wall (2)", "wall (4)"]


def test_a_method_that_is_being_trained_is_scored_as_any():
    def trained(sample):
        answer = flat(11)(sample)
        return replace(answer, depth_m=answer.depth_m.requires_grad_())

    (score,) = evaluate_held_out([wall_sample()], trained, beams=(64,)).scores
    assert score.mae_mm == 1000


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


def test_nearest_neighbour_on_real_frames_scores_what_the_table_in_the_results_says(kitti_root):
    samples = KittiObjectDataset(kitti_root, sample_list="sample_val", parts=("points",))
    table = {64: (3534, 1247), 8: (5851, 2464)}
    report = evaluate_held_out(
        (samples[index] for index in range(len(samples))), nearest_neighbour, beams=(64, 8)
    )
    assert len(report.frames) == 29
    for score in report.scores:
        assert (score.rmse_mm, score.mae_mm) == pytest.approx(table[score.beams], rel=0.005)
