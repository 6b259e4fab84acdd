import json
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from sightline.app.breaking import break_sample, reproducing_commands
from sightline.app.parts import PartMaker, Task
from sightline.app.state import Breakage, FaultChoice, parse_state
from sightline.augmentation.faults import fault_rng
from sightline.cli.main import main
from sightline.corruptions.kinds import find_kind
from sightline.data.formats.kitti_files import read_points, write_points
from sightline.data.open import open_dataset
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.app.makers import dataset

FRAMES = ("000000", "000001")


@pytest.fixture(scope="module")
def sample():
    return dataset()[0]


def test_sound_sensors_stay_as_they_are(sample):
    assert break_sample(sample, Breakage("000000")) is sample


def test_a_fault_is_the_library_s_with_its_seed(sample):
    broken = break_sample(sample, Breakage("000000", (FaultChoice("lidar_beams", 4, 3),)))
    expected = find_kind("lidar_beams").at(4)(sample, fault_rng(sample, 3, "lidar_beams"))
    assert torch.equal(broken.points, expected.points)
    other = break_sample(sample, Breakage("000000", (FaultChoice("lidar_beams", 4, 4),)))
    assert not torch.equal(broken.points, other.points)


def test_the_camera_s_faults_come_first_in_any_order_so_that_fog_sees_the_sound_sweep(sample):
    fog, blank = FaultChoice("camera_fog", 3, 0), FaultChoice("lidar_blank", 5, 0)
    one, other = (
        break_sample(sample, Breakage("000000", faults)) for faults in ((fog, blank), (blank, fog))
    )
    assert torch.equal(one.image, other.image)
    assert len(one.points) == 0


def test_the_yaw_turns_the_points_counter_clockwise(sample):
    broken = break_sample(sample, Breakage("000000", (), 90.0))
    expected = torch.stack((-sample.points[:, 1], sample.points[:, 0]), dim=1)
    assert torch.allclose(broken.points[:, :2], expected, atol=1e-4)
    assert torch.equal(broken.image, sample.image)


def test_the_commands_of_an_object_tree_make_the_same_sensors(tmp_path, monkeypatch, sample):
    monkeypatch.chdir(tmp_path)
    state = parse_state("fault=lidar_beams.4.7&fault=camera_jpeg.2.1", FRAMES)
    lines = reproducing_commands(state, PACKAGED_FRAMES, dataset(), "auto").split(" &&\n")
    assert lines[0] == "printf '%s\\n' 000000 > frame.txt"
    (tmp_path / "frame.txt").write_text("000000\n")
    for line in lines[1:-1]:
        words = shlex.split(line)
        assert words[:2] == ["sightline", "corrupt"]
        assert main(words[1:]) == 0
    words = shlex.split(lines[-1])
    assert words[:2] == ["sightline", "perceive"]
    assert words[words.index("--detection2d") + 1] == "detection2d-fast-cpu"
    made = dataset(tmp_path / words[2])[0]
    expected = break_sample(sample, state.broken)
    assert torch.equal(made.points, expected.points)
    assert np.array_equal(made.image, expected.image)


def test_what_no_command_makes_is_a_script_that_runs_to_the_same_sensors(sample):
    state = parse_state("yaw=3&fault=lidar_fog.2.5", FRAMES)
    script = reproducing_commands(state, PACKAGED_FRAMES, dataset(), "auto")
    before, _, rest = script.partition("perceiver = ")
    assert "detection3d-fast-cpu" in rest
    made: dict = {}
    exec(before, made)
    assert torch.equal(made["sample"].points, break_sample(sample, state.broken).points)


def test_names_with_blanks_and_quotes_are_quoted_for_the_shell():
    state = parse_state("", FRAMES)
    text = reproducing_commands(state, Path("my 'data'; rm -rf x"), dataset(), "auto")
    assert shlex.split(text.splitlines()[-1])[2] == "my 'data'; rm -rf x"


def test_faults_of_a_sensor_that_the_frame_lacks_are_a_script_as_corrupt_refuses_them(tmp_path):
    folder = shutil.copytree(PACKAGED_FRAMES, tmp_path / "frames")
    (folder / "training" / "velodyne" / "000001.bin").unlink()
    data = dataset(folder)
    lacking = parse_state("frame=000001&fault=lidar_blank.5.0", data.sample_ids)
    assert reproducing_commands(lacking, folder, data, "auto").startswith("import sightline")
    for query in ("frame=000001&fault=camera_blank.5.0", "frame=000000&fault=lidar_blank.5.0"):
        state = parse_state(query, data.sample_ids)
        assert "sightline corrupt" in reproducing_commands(state, folder, data, "auto")


def test_a_script_prints_the_line_that_perceive_writes(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    weights = "depth-completion=nearest&detection2d=none&detection3d=none"
    turned, sound = (parse_state(f"{weights}&yaw={yaw}", FRAMES) for yaw in (3, 0))
    texts = [reproducing_commands(s, PACKAGED_FRAMES, dataset(), "auto") for s in (turned, sound)]
    exec(texts[0], {})
    printed = capsys.readouterr().out
    (tmp_path / "frame.txt").write_text("000000\n")
    assert main(shlex.split(texts[1].splitlines()[-1])[1:]) == 0
    line = (tmp_path / "found" / "perception.jsonl").read_text()
    assert json.loads(printed).keys() == json.loads(line).keys()
    assert json.loads(printed)["tasks"] == {"depth-completion": {"by": "nearest"}}


def page_objects(maker, state):
    found = tuple(
        maker.make(Task(part=p, state=state)).found for p in ("detection2d", "detection3d")
    )
    return maker.make(Task(part="joined", state=state, found=found)).content["objects"]


@pytest.mark.filterwarnings("ignore:.*there are no point clouds for 1 of 1 frames")
@pytest.mark.parametrize(
    "query",
    ["", "frame=000001", "detection3d=none", "frame=000001&detection2d=none", "frame=000001&yaw=3"],
    ids=["both", "without_sweep", "without_3d", "without_2d_and_sweep", "turned_without_sweep"],
)
def test_the_page_s_objects_are_those_of_the_command_that_it_shows(tmp_path, monkeypatch, query):
    monkeypatch.chdir(tmp_path)
    folder = shutil.copytree(PACKAGED_FRAMES, tmp_path / "frames")
    (folder / "training" / "velodyne" / "000001.bin").unlink()
    data = dataset(folder)
    state = parse_state(f"depth-completion=nearest&{query}", data.sample_ids)
    (tmp_path / "frame.txt").write_text(f"{state.broken.frame}\n")
    command = reproducing_commands(state, folder, data, "torch").splitlines()[-1]
    assert main(shlex.split(command)[1:]) == 0
    line = json.loads((tmp_path / "found" / "perception.jsonl").read_text())
    objects = page_objects(PartMaker(data, folder, "torch"), state)
    assert objects == line["objects"]
    assert bool(objects) == ("none" not in query)


@pytest.fixture
def reduced_tree(tmp_path):
    """A tree with whole sweeps, and with every second point of them."""
    folder = shutil.copytree(PACKAGED_FRAMES, tmp_path / "tree")
    for path in (folder / "training" / "velodyne").iterdir():
        write_points(folder / "training" / "velodyne_reduced" / path.name, read_points(path)[::2])
    return folder


@pytest.mark.parametrize("fault", ["", "lidar_beams.4.7"])
def test_commands_read_the_sweeps_of_the_page(reduced_tree, tmp_path, monkeypatch, fault):
    monkeypatch.chdir(tmp_path)
    data = open_dataset(reduced_tree, velodyne="velodyne_reduced")
    state = parse_state(f"fault={fault}" if fault else "", FRAMES)
    lines = reproducing_commands(state, reduced_tree, data, "auto").split(" &&\n")
    (tmp_path / "frame.txt").write_text("000000\n")
    for line in lines[1:-1]:
        assert main(shlex.split(line)[1:]) == 0
    words = shlex.split(lines[-1])
    chosen = words[words.index("--velodyne") + 1]
    made = open_dataset(words[2], sample_list=["000000"], velodyne=chosen)[0]
    assert torch.equal(made.points, break_sample(data[0], state.broken).points)


def test_a_script_reads_the_sweeps_and_uses_the_engine_of_the_page(reduced_tree):
    data = open_dataset(reduced_tree, velodyne="velodyne_reduced")
    state = parse_state("yaw=3", FRAMES)
    before, _, rest = reproducing_commands(state, reduced_tree, data, "torch").partition(
        "perceiver = "
    )
    assert "engine='torch')" in rest
    made: dict = {}
    exec(before, made)
    assert torch.equal(made["sample"].points, break_sample(data[0], state.broken).points)


def test_commands_name_an_engine_only_if_it_was_chosen_and_sweeps_only_beside_others(reduced_tree):
    shutil.rmtree(reduced_tree / "training" / "velodyne")
    data, state = open_dataset(reduced_tree), parse_state("", FRAMES)
    assert "--engine torch" in reproducing_commands(state, reduced_tree, data, "torch")
    text = reproducing_commands(state, reduced_tree, data, "auto")
    assert "--engine" not in text
    assert "--velodyne" not in text
