"""Distances of rigs from training: exact numbers, their line, and silence where nothing differs."""

import json
import math

import pytest

from sightline.cli.main import main
from sightline.files.weights_header import shipped_names
from sightline.inference import rig_distance as module
from sightline.inference.rig_distance import (
    TRAINED_RIGS,
    camera_numbers,
    compare,
    lidar_numbers,
    rig_distance,
)
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.simulation.rigs import named_rig
from sightline.tasks import find_task, task_names

TABLE = json.loads(TRAINED_RIGS.read_text())
ALL = list(TABLE["designs"].values())
FACTOR = {"lidar": {"range_m": {"trained": [60, 100], "factor": 2, "suffers": "far objects"}}}
STEP = {"camera": {"pitch_deg": {"trained": [-1, 1], "step": 5, "suffers": "near objects"}}}


def numbers_of(name):
    rig = named_rig(name)
    return [("camera", camera_numbers(rig.camera)), ("lidar", lidar_numbers(rig.lidar))]


@pytest.mark.parametrize(
    ("value", "distance"), [(30.0, 1.0), (15.0, 2.0), (200.0, 1.0), (100 * math.sqrt(2), 0.5)]
)
def test_a_factor_of_two_beyond_the_range_counts_as_one(value, distance):
    found = compare([("lidar", {"range_m": value})], [FACTOR])
    assert found.of_sensor("lidar") == pytest.approx(distance)
    assert found.of_sensor("camera") == 0


@pytest.mark.parametrize(("value", "distance"), [(6.0, 1.0), (-11.0, 2.0)])
def test_a_step_beyond_the_range_counts_as_one(value, distance):
    found = compare([("camera", {"pitch_deg": value})], [STEP])
    assert found.of_sensor("camera") == pytest.approx(distance)


@pytest.mark.parametrize("value", [60.0, 80.0, 100.0, 110.0])
def test_numbers_in_the_range_or_near_it_are_silent(value):
    assert compare([("lidar", {"range_m": value})], [FACTOR]) is None


def test_a_number_that_costs_on_one_side_only_is_silent_on_the_other():
    one_sided = {"lidar": {"range_m": {**FACTOR["lidar"]["range_m"], "side": "low"}}}
    assert compare([("lidar", {"range_m": 400.0})], [one_sided]) is None
    assert compare([("lidar", {"range_m": 15.0})], [one_sided]).of_sensor("lidar") == 2


def test_numbers_of_a_sensor_add_up_as_squares_and_the_farthest_network_counts():
    nearer = {"lidar": {"range_m": {**FACTOR["lidar"]["range_m"], "factor": 4, "suffers": "depth"}}}
    roll = {"lidar": {"roll_deg": {"trained": [0, 0], "step": 1, "suffers": "boxes"}}}
    found = compare(
        [("lidar", {"range_m": 400.0, "roll_deg": 1.5, "height_m": 9.0})], [nearer, FACTOR, roll]
    )
    assert found.of_sensor("lidar") == pytest.approx(2.5)
    farthest, tilt = found.departures
    assert (farthest.name, farthest.distance) == ("range_m", pytest.approx(2))
    assert farthest.suffers == ("far objects", "depth")
    assert tilt.suffers == ("boxes",)


def test_of_several_cameras_the_farthest_counts():
    found = compare([("camera", {"pitch_deg": each}) for each in (0.0, 11.0, 6.0)], [STEP])
    assert [each.value for each in found.departures] == [11.0]


def test_the_line_names_both_distances_numbers_ranges_and_results():
    focal = {"trained": [690, 750], "factor": 2, "suffers": "the sizes of objects"}
    pitch = {"trained": [-1.5, 1.5], "step": 5, "suffers": "far objects"}
    line = str(
        compare(numbers_of("os1-128"), [{"camera": {"focal_px": focal, "pitch_deg": pitch}}])
    )
    assert "\n" not in line
    for part in (
        "(distance: camera 1.5, LiDAR 0.0; 0: as trained, 1: costs much)",
        "camera's focal length 1900 px (trained 690 to 750)",
        "camera's pitch 5 degrees (trained -1.5 to 1.5)",
        "expect losses in the sizes of objects, far objects",
        "docs/guides/own_rig.md",
    ):
        assert part in line


def test_a_lidar_without_rings_is_named_as_such():
    found = compare(numbers_of("livox-horizon"), ALL)
    assert "LiDAR without rings" in str(found)
    assert found.of_sensor("lidar") >= 1
    assert compare([("lidar", {"ring_step_deg": None})], [TABLE["designs"]["image"]]) is None


def test_a_sparser_lidar_lies_farther_away():
    far = [
        compare([("lidar", {"ring_step_deg": step})], ALL).of_sensor("lidar")
        for step in (0.8, 1.33, 2.0)
    ]
    assert far == sorted(far)
    assert far[0] > 0


def test_kittis_rig_is_silent_for_all_default_weights():
    names = [find_task(name).default_weights for name in task_names()]
    assert rig_distance(PACKAGED_FRAMES, names) is None


def test_unknown_weights_and_unreadable_data_are_passed_over(tmp_path):
    assert rig_distance(PACKAGED_FRAMES, ["mine.safetensors", "nearest"]) is None
    assert rig_distance(tmp_path, ["detection3d-best"]) is None


def test_the_table_holds_all_shipped_weights():
    assert set(TABLE["weights"]) == set(shipped_names())
    assert set(TABLE["weights"].values()) == set(TABLE["designs"])
    for sensors in ALL:
        for limit in (each for limits in sensors.values() for each in limits.values()):
            assert limit["trained"][0] < limit["trained"][1]
            assert len({"factor", "step"} & set(limit)) == 1


@pytest.fixture
def far_away(monkeypatch):
    """Weights that were trained on a camera of 10 px."""
    limit = {"trained": [9, 10], "factor": 2, "suffers": "everything"}
    far = {"camera": {"focal_px": limit}}
    table = {**TABLE, "designs": dict.fromkeys(TABLE["designs"], far)}
    monkeypatch.setattr(module, "_trained_rigs", lambda: table)


@pytest.mark.usefixtures("far_away")
def test_predict_and_perceive_say_it_once_on_standard_error(tmp_path, capsys):
    data = str(PACKAGED_FRAMES)
    commands = (
        ["predict", "detection3d", data, "a", "--weights", "detection3d-fast-cpu"],
        ["perceive", data, "b", "--detection3d=none", "--detection2d=none",
         "--depth-completion=depth-fast-cpu"],
    )  # fmt: skip
    for command in commands:
        arguments = [str(tmp_path / each) if len(each) == 1 else each for each in command]
        assert main([*arguments, "--workers=1", "--engine=torch"]) == 0
        lines = capsys.readouterr().err.splitlines()
        assert sum("expect losses in everything" in line for line in lines) == 1


@pytest.mark.usefixtures("far_away")
def test_check_says_it_and_writes_it(tmp_path, capsys):
    assert main(["check", str(PACKAGED_FRAMES), "--json", str(tmp_path / "check.json")]) == 0
    assert "distance: camera 6.2, LiDAR 0.0" in capsys.readouterr().out
    written = json.loads((tmp_path / "check.json").read_text())
    assert written["problems"] == []
    assert written["data"][0]["frames"] == 2
    (departure,) = written["rig"]["camera"]["departures"]
    assert departure["number"] == "focal_px"
    assert departure["distance"] == pytest.approx(math.log2(72.15377), abs=1e-3)
    assert written["rig"]["lidar"] == {"distance": 0.0, "departures": []}


def test_check_is_silent_on_kittis_rig_and_lists_problems(tmp_path, capsys):
    report = tmp_path / "check.json"
    assert main(["check", str(PACKAGED_FRAMES), "--json", str(report)]) == 0
    assert "trained" not in capsys.readouterr().out
    assert json.loads(report.read_text())["rig"] is None
    (tmp_path / "empty").mkdir()
    assert main(["check", str(tmp_path / "empty"), "--json", str(report)]) == 1
    (problem,) = json.loads(report.read_text())["problems"]
    assert set(problem) == {"path", "problem", "remedy"}
