"""3D detection all around: turning a sweep turns the detections, each object is found once."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.cli.main import main
from sightline.data.datasets.recording import RecordingDataset
from sightline.data.formats.rings import covers_turn
from sightline.data.open import open_dataset
from sightline.detection3d.all_around import (
    _turned,
    join_quarters,
    quarter_sweeps,
    search_range_m,
    wide_config,
    wide_network,
)
from sightline.detection3d.config import Detection3DConfig
from sightline.detection3d.files import read_detections, write_results
from sightline.detection3d.network_task import NETWORK_TASK
from sightline.detection3d.points.config import ProposalNetworkConfig
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.geometry.boxes3d import Boxes3D
from sightline.inference.network import load_network
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.predictions import Detections3D
from tests.data.recordings import POINTS, write_cloud_file, write_recording

CONFIG = Detection3DConfig()
_SIZES = (4.0, 1.8, 1.5)


def detections(*boxes, scores=None, name="Car"):
    rows = [(x, y, 0.0, *_SIZES, yaw) for x, y, yaw in boxes]
    return Detections3D(
        class_names=(name,) * len(rows),
        boxes=Boxes3D(torch.tensor(rows, dtype=torch.float32).reshape(-1, 7)),
        scores=torch.tensor(scores or [0.5] * len(rows), dtype=torch.float32),
    )


NONE = detections()


@given(
    x=st.floats(4, 60, width=32),
    share=st.floats(-1, 1, width=32),
    yaw=st.floats(-3, 3, width=32),
    quarter=st.integers(0, 3),
)
def test_a_box_of_a_quarter_comes_back_turned_at_every_yaw(x, share, yaw, quarter):
    y = x * share
    found = [detections((x, y, yaw)) if number == quarter else NONE for number in range(4)]
    (box,) = join_quarters(found, CONFIG).boxes.tensor.tolist()
    turn = quarter * math.pi / 2
    assert box[0] == pytest.approx(x * math.cos(turn) - y * math.sin(turn), abs=1e-4)
    assert box[1] == pytest.approx(x * math.sin(turn) + y * math.cos(turn), abs=1e-4)
    assert math.cos(box[6] - yaw - turn) == pytest.approx(1, abs=1e-5)
    assert abs(box[6]) <= math.pi + 1e-6
    assert tuple(box[3:6]) == pytest.approx(_SIZES)


def test_an_object_on_a_seam_that_two_quarters_find_is_kept_once_with_the_better_score():
    ahead = detections((20.0, 20.3, 0.2), scores=[0.6])
    left = detections((20.3, -20.0, 0.2 - math.pi / 2), scores=[0.8])  # the same, turned
    joined = join_quarters([ahead, left, NONE, NONE], CONFIG)
    assert joined.scores.tolist() == pytest.approx([0.8])
    assert joined.boxes.tensor[0, :2].tolist() == pytest.approx([20.0, 20.3], abs=1e-5)


def test_a_quarter_does_not_answer_for_the_next_one():
    assert not len(join_quarters([detections((10.0, 12.0, 0.0)), NONE, NONE, NONE], CONFIG).scores)
    assert not len(join_quarters([NONE, NONE, NONE, NONE], CONFIG).scores)


@pytest.mark.parametrize(
    ("x", "y", "is_kept"), [(0.5, 0.3, False), (2.4, 1.3, False), (3, 0, True)]
)
def test_the_car_that_carries_the_lidar_is_no_detection(x, y, is_kept):
    found = [detections((float(x), float(y), 0.0)), NONE, NONE, NONE]
    assert len(join_quarters(found, CONFIG).scores) == is_kept


def test_quarters_are_sorted_together_by_score():
    found = [
        detections((10.0 + number, 0.0, 0.0), scores=[0.2 * number + 0.1]) for number in range(4)
    ]
    assert join_quarters(found, CONFIG).scores.tolist() == pytest.approx([0.7, 0.5, 0.3, 0.1])


def test_four_quarters_see_every_point_in_reach_ahead():
    angles = torch.arange(0, 360, 7.5) * math.pi / 180
    far = 69.0 * torch.stack((angles.cos(), angles.sin()), dim=1)
    points = torch.cat((far, torch.zeros(len(far), 2)), dim=1).float()
    config = wide_config(CONFIG, 70.4)
    seen = [_turned(each, k) for k, each in enumerate(quarter_sweeps(points, config))]
    assert {tuple(row) for each in seen for row in each.tolist()} == {
        tuple(row) for row in points.tolist()
    }


@pytest.mark.parametrize(("range_m", "ahead", "aside"), [(70.4, 352, 512), (100.0, 504, 720)])
def test_the_grid_of_a_quarter_reaches_as_far_to_its_corners(range_m, ahead, aside):
    grid = wide_config(CONFIG, range_m).pillars.grid
    assert (grid.rows, grid.columns) == (ahead, aside)
    assert grid.y_m[1] >= range_m * math.sin(math.pi / 4) + 1


@pytest.mark.parametrize(("far", "range_m"), [(0, 70.4), (1, 70.4), (2, 100.8)])
def test_more_than_a_thousandth_of_far_points_makes_the_search_longer(far, range_m):
    points = torch.zeros(1000, 4)
    points[:, 0] = 70.0
    points[:far, 1] = 60.0
    assert search_range_m(points) == range_m


def test_networks_of_points_have_no_grid():
    points = replace(
        CONFIG,
        pillars=None,
        regions=None,
        points=ProposalNetworkConfig(),
        input=replace(CONFIG.input, num_points=256),
    )
    with pytest.raises(ValueError, match="only networks of pillars"):
        wide_config(points, 70.4)


def test_a_wide_network_has_the_same_weights():
    loaded = load_network(NETWORK_TASK, "detection3d-fast-cpu")
    wide = wide_network(loaded, 70.4)
    before, after = loaded.network.state_dict(), wide.network.state_dict()
    assert all(torch.equal(before[name], after[name]) for name in before)
    assert loaded.network.config.pillars.grid.columns == 400


@pytest.fixture(scope="module")
def predictor():
    return Detection3DPredictor.load("detection3d-fast-cpu")


@pytest.fixture(scope="module")
def sample():
    return replace(open_dataset(PACKAGED_FRAMES)[0], all_around=True)


def test_turning_the_sweep_by_right_angles_turns_the_detections(predictor, sample):
    turned = replace(sample, points=_turned(sample.points, 1))
    first, second = predictor(sample), predictor(turned)
    assert len(first.scores) > 3
    assert second.class_names == first.class_names
    assert second.scores.tolist() == pytest.approx(first.scores.tolist(), abs=1e-6)
    expected = _turned(first.boxes.tensor, 1)
    assert torch.allclose(second.boxes.tensor[:, :6], expected[:, :6], atol=1e-4)
    turns = second.boxes.tensor[:, 6] - first.boxes.tensor[:, 6] - math.pi / 2
    assert torch.allclose(turns.cos(), torch.ones(len(turns)), atol=1e-5)


def test_a_sweep_without_points_has_no_objects(predictor, sample):
    assert not len(predictor(replace(sample, points=torch.zeros(0, 4))).scores)


def ring_of(start_deg, end_deg):
    angles = torch.arange(start_deg, end_deg, 1.0) * math.pi / 180
    xy = 20 * torch.stack((angles.cos(), angles.sin()), dim=1)
    return torch.cat((xy, torch.zeros(len(xy), 2)), dim=1).float().numpy()


@pytest.mark.parametrize(
    ("start_deg", "end_deg", "is_turn"),
    [(0, 360, True), (-180, 150, True), (-180, 120, False), (-45, 45, False)],
)
def test_a_turn_is_whole_with_points_in_nine_of_ten_directions(start_deg, end_deg, is_turn):
    assert covers_turn(ring_of(start_deg, end_deg)) is is_turn


def test_recordings_are_searched_all_around_where_their_sweeps_are_and_kittis_trees_never(tmp_path):
    turns = [_turned(torch.from_numpy(POINTS), quarter).numpy() for quarter in range(4)]
    for name, points in (("turn", np.concatenate(turns)), ("ahead", POINTS)):
        write_recording(tmp_path / name, lidar_height_m=1.73, max_intensity=255)
        for place in (tmp_path / name / "points").iterdir():
            write_cloud_file(place, points)
        samples = RecordingDataset(tmp_path / name, needs=())
        assert [each.all_around for each in samples] == [name == "turn"] * 2
    assert not open_dataset(PACKAGED_FRAMES)[0].all_around


def test_result_files_keep_boxes_outside_the_image_of_whole_turns_alone(tmp_path, sample):
    found = detections((20.0, 0.0, 0.1), (-20.0, 5.0, 2.0), scores=[0.9, 0.8])
    path = tmp_path / "000000.txt"
    write_results(path, replace(sample, all_around=False), found)
    assert len(read_detections(path, sample).scores) == 1
    write_results(path, sample, found)
    lines = path.read_text().splitlines()
    assert lines[1].split()[4:8] == ["-1.00"] * 4
    read = read_detections(path, sample)
    assert read.scores.tolist() == pytest.approx([0.9, 0.8])
    assert torch.allclose(read.boxes.tensor.float(), found.boxes.tensor, atol=0.02)


def test_the_command_searches_kittis_trees_ahead_and_all_around_where_asked(tmp_path):
    command = ["predict", "detection3d", str(PACKAGED_FRAMES)]
    options = ["--weights", "detection3d-fast-cpu", "--engine=torch", "--workers=1"]
    given = {"plain": [], "no": ["--around=no"], "yes": ["--around=yes"]}
    for name, more in given.items():
        assert main([*command, str(tmp_path / name), *options, *more]) == 0
    texts = {name: (tmp_path / name / "000000.txt").read_text() for name in given}
    assert texts["plain"] == texts["no"]
    assert "-1.00 -1.00 -1.00 -1.00" not in texts["plain"]
    manifests = {
        name: json.loads((tmp_path / name / "sightline.json").read_text()) for name in given
    }
    assert [manifests[name].get("around") for name in given] == [None, False, True]
