import json
from dataclasses import replace

import pytest
import torch

from benchmarks.rig_runs import FrameSet, named_network, run_network, score_depth
from benchmarks.rigs import OTHERS, frame_sets, joined_rigs
from benchmarks.table_rigs import cost, depth, detection2d
from sightline.structures.predictions import DepthMap
from tests.joining.scenes import make_sample


def test_a_network_is_named_by_its_weights_or_its_method():
    assert named_network("new=detection3d-best").task == "detection3d"
    assert named_network("filter=classical").is_method
    with pytest.raises(ValueError, match="give NAME=WEIGHTS"):
        named_network("detection2d-best")
    with pytest.raises(ValueError, match="there are no weights"):
        named_network("new=detection9d-best")


@pytest.fixture
def sets(tmp_path):
    (tmp_path / "views" / "labels").mkdir(parents=True)
    (tmp_path / "views" / "labels" / "front.txt").touch()
    lists = tmp_path / "kitti" / "ImageSets"
    lists.mkdir(parents=True)
    (lists / "sample_val.txt").write_text("000005\n")
    (lists / "sample_train.txt").write_text("000000\n000003\n")
    return frame_sets(tmp_path / "simulated", tmp_path / "views", tmp_path / "kitti", frames=25)


def test_frames_of_a_rig_are_those_of_its_place_in_turn(sets):
    by_name = {each.name: each for each in sets}
    assert by_name["kitti"].frames == ("000000", "000012", "000024")
    assert by_name["waymo"].frames == ("000002", "000014")
    assert by_name["nuScenes' views"].frames == ("front",)
    assert by_name["sample_train"].frames == ("000000", "000003")


def test_the_joined_set_has_all_simulated_frames_but_those_of_the_trained_rig(sets):
    others = joined_rigs(sets)
    assert others.name == OTHERS
    assert len(others.frames) == len(set(others.frames)) == 25 - 3


def test_a_run_that_is_kept_is_read_and_not_repeated(tmp_path):
    frames = FrameSet(
        name="kitti",
        group="simulated",
        data=tmp_path / "there is no data",
        labels=tmp_path,
        frames=("000000",),
    )
    kept = {"ms": {"000000": 3.0}, "peak_mib": None, "depth": {}}
    (tmp_path / "classical").mkdir()
    (tmp_path / "classical" / "simulated-kitti-1.json").write_text(json.dumps(kept))
    assert run_network(named_network("old=classical"), frames, tmp_path, "torch") == kept


def test_depth_is_scored_below_the_highest_return_and_gaps_count_as_no_depth():
    sample = make_sample([[20.0, 0.0, 0.0, 0.5]])
    truth_m = torch.full(sample.image_size, 20.0)
    depth_m = truth_m.clone()
    depth_m[-1] = 0.0
    rated = torch.zeros(sample.image_size, dtype=torch.bool)
    scores = score_depth(replace(sample, depth=truth_m), DepthMap(depth_m=depth_m, valid=rated))
    assert scores["median_mm"] == 0.0
    assert 0 < 1 - scores["coverage"] < 0.1
    assert scores["mae_mm"] == pytest.approx(20_000 * (1 - scores["coverage"]))


def car_row(name, network, **numbers):
    score = {"class": "Car", "metric": "bbox", "iou": 0.7, "objects": 12, **numbers}
    return {
        "set": name,
        "network": network,
        "task": "detection2d",
        "frames": 10,
        "ms": 120.4,
        "peak_mib": 900.6,
        "scores": [score],
    }


def test_rows_have_both_networks_and_the_first_less_the_second():
    results = [
        car_row("waymo", "best", ap=81.2, ap_95=[70.1, 92.8], ap_r40=79.6),
        car_row("waymo", "rigs", ap=90.6, ap_95=[80.0, 97.0], ap_r40=90.1),
    ]
    less = {"class": "Car", "metric": "bbox", "iou": 0.7, "difference": 9.4}
    differences = [
        {
            "set": "waymo",
            "first": "rigs",
            "second": "best",
            "scores": [{**less, "difference_95": [2.0, 15.0]}],
        }
    ]
    head, row = detection2d({"results": results, "differences": differences})
    assert head == [
        "rig",
        "frames",
        "objects",
        "best: cars, 0.7",
        "rigs: cars, 0.7",
        "rigs less best: cars, 0.7",
    ]
    assert row == [
        "`waymo`", "10", "12; 0", "81 [70, 93]; 80", "91 [80, 97]; 90", "+9.4 [+2, +15]"
    ]  # fmt: skip


def test_a_rig_without_counted_objects_has_no_score_and_few_frames_no_interval():
    results = [car_row("once", "best"), car_row("waymo", "best", ap=50.0, ap_95=None, ap_r40=48.0)]
    rows = detection2d({"results": results, "differences": []})
    assert [row[-1] for row in rows[1:]] == ["-", "50; 48"]


def test_depth_and_cost_are_whole_numbers_by_rig():
    errors = {"rmse_mm": 3201.4, "mae_mm": 811.6, "median_mm": 70.2}
    row = {"set": "all but kitti", "network": "adaptive", "task": "depth-completion", "frames": 44}
    results = [{**row, **errors, "ms": 80.2, "peak_mib": 512.3}, car_row("waymo", "best")]
    record = {"results": results, "differences": []}
    assert depth(record)[1:] == [["all but kitti", "44", "3201 / 812 / 70"]]
    assert cost(record) == [
        ["rig", "adaptive", "best"],
        ["all but kitti", "80; 512", ""],
        ["`waymo`", "", "120; 901"],
    ]
