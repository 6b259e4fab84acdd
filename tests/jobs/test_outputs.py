"""Outputs never change the inputs or each other."""

from pathlib import Path

import pytest

from sightline.jobs.output_dirs import (
    MANIFEST_NAME,
    check_outputs,
    check_outside_dataset,
    finished_names,
)


@pytest.fixture
def tree(tmp_path):
    """Data set with a picture, a linked folder, a linked picture, and results."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "000001.png").write_text("picture")
    split = tmp_path / "KITTI" / "training"
    (split / "calib").mkdir(parents=True)
    (split / "image_2").symlink_to(elsewhere)
    (split / "velodyne").mkdir()
    (tmp_path / "one.bin").write_text("sweep")
    (split / "velodyne" / "000001.bin").symlink_to(tmp_path / "one.bin")
    (split / "calib" / "000001.txt").write_text("P2")
    (tmp_path / "found").mkdir()
    (tmp_path / "found" / "000001.txt").write_text("Car")
    (tmp_path / "alias").symlink_to(tmp_path / "KITTI" / "training")
    return tmp_path


@pytest.mark.parametrize(
    "output",
    [
        "KITTI",
        "KITTI/new.json",
        "KITTI/training/calib/000001.txt",
        "KITTI/training/image_2/000001.png",
        "elsewhere/000001.png",
        "elsewhere/new.png",
        "one.bin",
        "alias/calib/new.txt",
        "found/../KITTI/report.json",
    ],
)
@pytest.mark.parametrize("data", ["KITTI", "KITTI/training", "KITTI/training/label_2", "alias"])
def test_nothing_is_written_into_a_data_set_however_it_is_named(tree, data, output):
    with pytest.raises(ValueError, match="would change the data set"):
        check_outputs({"--out": tree / output}, data=[tree / data])


def test_nothing_is_written_among_the_shards_of_which_one_is_given(tmp_path):
    for name in ("000000.tar", "000000.json"):
        (tmp_path / name).write_text("shard")
    with pytest.raises(ValueError, match="would change the data set"):
        check_outputs({"--json": tmp_path / "000001.json"}, data=[tmp_path / "000000.tar"])


@pytest.mark.parametrize("output", ["report.json", "KITTI-report", "found/report.json", "two.bin"])
def test_what_lies_beside_a_data_set_may_be_written(tree, output):
    check_outputs({"--out": tree / output, "--json": None}, data=[tree / "KITTI", None])


def test_a_file_that_is_read_is_not_replaced(tree):
    (tree / "weights").write_text("")
    (tree / "link").symlink_to(tree / "weights")
    with pytest.raises(ValueError, match=r"would change the file .*weights.*place beside"):
        check_outside_dataset(tree / "weights", [tree / "link"])


def test_a_report_may_stand_beside_results_and_take_the_place_of_none(tree):
    results = [tree / "found"]
    check_outputs({"--json": tree / "found" / "report.json"}, data=[], results=results)
    check_outputs({"--csv": tree / "found" / "report.txt"}, data=[], results=results)
    (tree / "found" / MANIFEST_NAME).write_text("{}")
    for taken in ("found", "found/000001.txt", f"found/{MANIFEST_NAME}"):
        with pytest.raises(ValueError, match=r"--csv .* is among the input results"):
            check_outputs({"--csv": tree / taken}, data=[], results=results)


def test_two_outputs_are_never_the_same_file(tree):
    (tree / "again").symlink_to(tree / "a.json")
    with pytest.raises(ValueError, match=r"--json and --csv are both .*again"):
        check_outputs({"--json": tree / "a.json", "--csv": tree / "again"}, data=[])


@pytest.mark.parametrize(
    "command",
    [
        ["show", "KITTI", "000001", "--out", "KITTI/training/image_2/000001.png"],
        ["health", "KITTI", "--picture", "KITTI/training/image_2/000001.png"],
        ["health", "KITTI", "--json", "a.png", "--picture", "a.png"],
        ["health-limits", "KITTI", "KITTI/limits.json"],
        ["evaluate", "objects", "found", "KITTI/training/label_2", "--json",
         "KITTI/training/calib/000001.txt"],
        ["evaluate", "objects", "found", "KITTI/training/label_2", "--plots", "KITTI/plots"],
        ["evaluate", "proposals", "found", "KITTI/training/label_2", "--json", "KITTI/a.json"],
        ["evaluate", "calibration", "found", "KITTI/training/label_2", "--out", "KITTI/out"],
        ["evaluate", "depth", "found", "KITTI/training", "--json", "KITTI/a.json"],
        ["evaluate", "objects", "found", "KITTI/training/label_2", "--sample-list", "one.bin",
         "--json", "one.bin"],
        ["health", "KITTI", "--sample-list", "one.bin", "--json", "one.bin"],
        ["evaluate", "held-out", "KITTI", "--json", "KITTI/a.json"],
        ["evaluate", "realism", "KITTI", "alias", "--json", "KITTI/a.json"],
        ["import", "KITTI", "KITTI/out"],
        ["import", "KITTI", "out", "--calibration", "out/calibration.yaml"],
        ["perceive", "KITTI", "out", "--rerun", "KITTI/a.rrd"],
        ["perceive", "KITTI", "out", "--video", "KITTI/a.mp4"],
        ["predict", "depth-completion", "KITTI", "KITTI/out", "--method", "nearest"],
        ["reproduce", "shift-conv", "--data", "KITTI", "--json", "KITTI/a.json"],
        ["reproduce", "gated-fusion", "--data", "KITTI", "--figures", "KITTI/figures"],
        ["robustness", "--compare", "a.json", "b.json", "--page", "a.json"],
        ["submission", "found", "found"],
        ["corrupt", "KITTI", "KITTI/out"],
    ],
    ids=" ".join,
)  # fmt: skip
def test_every_command_refuses_outputs_among_its_inputs(tree, monkeypatch, capsys, command):
    from sightline.cli.main import main

    monkeypatch.chdir(tree)
    Path("a.json").write_text("{}")
    before = sorted(tree.rglob("*"))
    assert main(command) == 2
    error = capsys.readouterr().err
    assert any(each in error for each in ("would change", "are both", "lies in", "among the"))
    assert sorted(tree.rglob("*")) == before


def test_empty_files_are_results_only_where_nothing_was_found(tmp_path):
    for name in ("none.txt", "some.txt", "empty.png", "whole.png"):
        (tmp_path / name).write_text("" if name in ("none.txt", "empty.png") else "x")
    (tmp_path / "folder.png").mkdir()
    assert finished_names(tmp_path, ".txt") == {"none", "some"}
    assert finished_names(tmp_path, ".png") == {"whole"}
    assert finished_names(tmp_path / "missing", ".png") == set()


@pytest.mark.parametrize("name", ["000000.tar", "000000.json", "shards.json"])
def test_a_report_replaces_no_file_of_packed_results(tmp_path, name):
    for each in ("000000.tar", "000000.json", "shards.json", "report.json"):
        (tmp_path / each).write_text("")
    with pytest.raises(ValueError, match="is among the input results"):
        check_outputs({"--json": tmp_path / name}, data=[], results=[tmp_path])
    check_outputs({"--json": tmp_path / "report.json"}, data=[], results=[tmp_path])


@pytest.mark.parametrize(
    ("part", "beside", "root"),
    [
        ("Q/labels", "calibration.yaml images/a.png", "Q"),
        ("Q/depth", "calibration.json points/a.pcd", "Q"),
        ("Q/labels", "calibration/a.yaml images/a.png", "Q"),
        ("Q/labels", "shards.json", "Q"),
        ("K/label_2", "calib/000000.txt velodyne/000000.bin", "K"),
        ("S/groundtruth_depth", "intrinsics/a.txt velodyne_raw/a.png", "S"),
        ("D/val/drive/proj_depth/groundtruth/image_02", "../velodyne_raw/image_02/5.png", "D/val"),
        ("D/drive/proj_depth/groundtruth/image_02", "../velodyne_raw/image_02/5.png", "D/drive"),
    ],
)
def test_nothing_is_written_into_a_data_set_of_which_one_part_is_named(
    tmp_path, part, beside, root
):
    data = tmp_path / part
    data.mkdir(parents=True)
    others = [data.parent / each for each in beside.split()]
    for other in others:
        other.parent.mkdir(parents=True, exist_ok=True)
        other.write_text("input")
    for output in (*others, tmp_path / root / "new.json", data / "new.json"):
        with pytest.raises(ValueError, match=f"would change the data set {tmp_path / root}, which"):
            check_outputs({"--json": output}, data=[data])
    check_outputs({"--json": (tmp_path / root).parent / "new.json"}, data=[data])


def test_folders_of_usual_names_are_no_data_set(tmp_path):
    for name in ("drive", "labels", "depth", "calibration"):
        (tmp_path / name).mkdir()
    for name in ("labels", "depth"):
        check_outputs({"--json": tmp_path / "results" / "new.json"}, data=[tmp_path / name])
    (tmp_path / "images").mkdir()
    check_outputs({"--json": tmp_path / "new.json"}, data=[tmp_path / "drive"])
    for name in ("training/drive", "testing/drive", "proj_depth/drive", "proj_depth/a/drive"):
        (tmp_path / name / "images").mkdir(parents=True)
        check_outputs({"--json": tmp_path / "new.json"}, data=[tmp_path / name])
    check_outputs({"--json": tmp_path / "new.json"}, data=[tmp_path / "training"])
