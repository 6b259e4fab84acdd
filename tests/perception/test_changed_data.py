"""Kept results of `predict` and `perceive` after their data changed."""

import json
import shutil

import pytest

from sightline.data.datasets.sample_files import dataset_title
from sightline.data.open import open_dataset
from sightline.data.sharding import write_shards
from sightline.inference.predict import predict
from sightline.perception.perceive import perceive
from sightline.perception.perceiver import MultiTaskPredictor
from sightline.tasks import find_task
from tests.data.recordings import write_recording
from tests.data.trees import write_depth_drive, write_drive, write_object_tree, write_selection
from tests.inference.trees import contents_of
from tests.perception.predictors import FunctionPredictor, one_box, perceiver
from tests.perception.test_alignment import perceiver as perceiver_of_any_frame

TASK = find_task("detection2d")
BOXES = perceiver().predictors["detection2d"]


def title(path):
    return dataset_title(open_dataset(path), path)


def lines_of(out):
    return [json.loads(line) for line in (out / "perception.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("file", ["velodyne/000002.bin", "image_2/000002.png"])
@pytest.mark.filterwarnings("ignore:.*there are no .* of 4 frames")
def test_a_sensor_that_arrives_with_its_own_older_times_is_used(data, out, tmp_path, file):
    original, aside = data / "training" / file, tmp_path / "aside"
    shutil.move(original, aside)
    perceive(data, out, perceiver=perceiver())
    predict(TASK, BOXES, data, out.with_name("boxes"), workers=1)
    for _ in range(2):
        assert perceive(data, out, perceiver=perceiver()).written == 0
        assert predict(TASK, BOXES, data, out.with_name("boxes"), workers=1).written == 0
        assert predict(TASK, BOXES, data, out / "detection2d", workers=1).written == 0
    shutil.copy2(aside, original)  # older than the results
    assert predict(TASK, BOXES, data, out / "detection2d", workers=1).written == 1
    assert predict(TASK, BOXES, data, out.with_name("boxes"), workers=1).written == 1
    assert perceive(data, out, perceiver=perceiver()).written == 1
    assert perceive(data, out, perceiver=perceiver()).written == 0
    assert predict(TASK, BOXES, data, out.with_name("boxes"), workers=1).written == 0
    perceive(data, tmp_path / "new", perceiver=perceiver())
    assert (out / "perception.jsonl").read_bytes() == (
        tmp_path / "new" / "perception.jsonl"
    ).read_bytes()
    for folder in (out / "detection2d", out.with_name("boxes")):
        assert (folder / "000002.txt").read_text().split()[-1].startswith("0.8")


def test_a_predictor_by_one_sensor_does_not_wait_for_the_other(data, out):
    alone = FunctionPredictor(one_box, "one-box", ("image",), ("image",), ("results",))
    for written in (4, 0):
        assert predict(TASK, alone, data, out, workers=1).written == written
        done = perceive(
            data, out.with_name("all"), perceiver=MultiTaskPredictor({"detection2d": alone})
        )
        assert done.written == written


def test_times_that_are_added_or_corrected_come_into_the_lines(tmp_path, out):
    recording = write_recording(tmp_path / "drive")
    perceiver = perceiver_of_any_frame()
    perceive(recording, out, perceiver=perceiver)
    assert [line["timestamp_s"] for line in lines_of(out)] == [None, None]
    changed_ns = (out / "lines" / "b.json").stat().st_mtime_ns
    for second in (0.1, 0.5):
        (recording / "times.txt").write_text(f"a 7.25\nb {7.25 + second}\n")
        assert perceive(recording, out, perceiver=perceiver).written == 0
        assert [line["timestamp_s"] for line in lines_of(out)] == [0, second]
    assert (out / "lines" / "b.json").stat().st_mtime_ns == changed_ns  # newer frames are told
    perceive(recording, tmp_path / "new", perceiver=perceiver)
    assert contents_of(out / "lines") == contents_of(tmp_path / "new" / "lines")


def test_times_of_a_drive_come_into_the_lines(tmp_path, out):
    drive = write_drive(tmp_path / "2011_09_26" / "drive")
    times = drive / "velodyne_points" / "timestamps.txt"
    perceiver = perceiver_of_any_frame()
    perceive(drive, out, perceiver=perceiver)
    times.write_text(times.read_text().replace("13:02:25.2", "13:02:25.3"))
    assert perceive(drive, out, perceiver=perceiver, sample_list=["0000000002"]).written == 0
    assert lines_of(out)[2]["timestamp_s"] == pytest.approx(0.3)


def test_results_of_removed_and_renamed_frames_are_told(data, out):
    perceive(data, out, perceiver=perceiver())
    predict(TASK, BOXES, data, out.with_name("boxes"), workers=1)
    for name in ("readme.txt", "._000002.txt"):
        (out.with_name("boxes") / name).write_text("of a run in May\n")
    told = r"results of 1 of 4 frames, 000003, are of no frame of these data and stay; if the"
    for path in data.glob("*/*/000003.*"):
        path.rename(path.with_stem("000007"))
    with pytest.warns(UserWarning, match=f"out/lines: {told}"):
        assert perceive(data, out, perceiver=perceiver()).written == 1
    with pytest.warns(UserWarning, match=f"boxes: {told}"):
        predict(TASK, BOXES, data, out.with_name("boxes"), workers=1)
    (out / "lines" / "000003.json").unlink()
    perceive(data, out, perceiver=perceiver(), sample_list=["000001"])  # others are in the data


def test_a_tree_and_its_split_are_the_same_data(data, out):
    for number, path in enumerate((data, data / "training", data / "training" / ".")):
        done = predict(TASK, BOXES, path, out, workers=1)
        assert done.written == (0 if number else 4)
    shards = data.parent / "shards" / "training"
    write_shards(data, shards, frames_per_shard=2)
    for path, written in ((shards, 4), (shards / "training", 0)):
        done = predict(TASK, BOXES, path, out.with_name("of shards"), workers=1)
        assert done.written == written
        assert title(path) == title(data) == f"{data.parent.name}/data"


def test_a_tree_or_its_shards_may_be_named_like_a_split(tmp_path):
    tree = write_object_tree(tmp_path / "training", "000001")
    (tmp_path / "link").symlink_to(tree / "training")
    for path in (tree, tree / "training", tmp_path / "link"):
        assert title(path) == f"{tmp_path.name}/training"


def test_equal_splits_of_two_trees_are_not_the_same_data(tmp_path, out):
    trees = [write_object_tree(tmp_path / each / "fog", "000001") for each in ("seed0", "seed1")]
    predict(TASK, BOXES, trees[0] / "training", out, workers=1)
    with pytest.raises(ValueError, match="with data seed0/fog instead of seed1/fog"):
        predict(TASK, BOXES, trees[1] / "training", out, workers=1)
    shutil.copytree(trees[0] / "training", trees[0] / "testing")
    with pytest.raises(ValueError, match="with data seed0/fog instead of seed0/fog/testing"):
        predict(TASK, BOXES, trees[0] / "testing", out, workers=1)


@pytest.mark.filterwarnings("ignore:.*only the frames in")
def test_depth_data_are_named_by_tree_and_split(tmp_path):
    tree = tmp_path / "data" / "depth"
    write_selection(tree)
    write_depth_drive(tree, tree)
    selections, drives = tree / "depth_selection", tree / "val"
    shutil.copytree(tree / "data_depth_velodyne" / "val", drives)
    shutil.copytree(tree / "data_depth_annotated" / "val", drives, dirs_exist_ok=True)
    selection = selections / "val_selection_cropped"
    for number, path in enumerate((tree, selections, selection)):
        write_shards(path, tmp_path / f"shards{number}", frames_per_shard=9)
        for each in (path, tmp_path / f"shards{number}"):
            assert title(each) == "data/depth/val_selection_cropped"
    assert title(drives) == title(tmp_path / "shards0" / "val") == "data/depth/val"
    (tmp_path / "val").symlink_to(tmp_path / "shards0")
    assert title(tmp_path / "val" / "val") == "data/depth/val"
    shutil.copytree(tree, tmp_path / "other" / "depth")
    assert title(tmp_path / "other" / "depth") == "other/depth/val_selection_cropped"
    own = tmp_path / "own" / "mine"
    shutil.copytree(selection, own)
    assert title(own) == "own/mine"
    shutil.rmtree(own / "groundtruth_depth")  # which decides what the split is called
    assert title(own) == "own/mine"
