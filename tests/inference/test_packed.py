"""Results of shards in shards: their bytes, resumption, damage, and who may write to them."""

import json
import shutil
import tarfile
import warnings
from functools import partial

import numpy as np
import pytest
import torch

from sightline.cli.main import main
from sightline.data.formats.map_png import read_depth_png
from sightline.data.open import open_dataset
from sightline.data.sharding import unpack_shards, write_shards
from sightline.depth_completion.registration import TASK
from sightline.evaluation.depth import evaluate_depth
from sightline.files.shard_path import data_path
from sightline.inference.predict import predict_shards
from sightline.jobs.run import JobResult
from sightline.perception.perceive import perceive, perceive_shards
from sightline.perception.perceiver import MultiTaskPredictor
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.predictions import DepthMap
from tests.data.recordings import POINTS, write_calibration, write_recording
from tests.inference.function_predictor import FunctionPredictor, sparse, write
from tests.inference.trees import write_object_tree
from tests.perception.predictors import perceiver

pytestmark = pytest.mark.filterwarnings("ignore:.*only the frames in training are used")


@pytest.fixture
def shards(tmp_path):
    """Shards of two frames: five of training after one of testing."""
    tree = write_object_tree(tmp_path / "tree", 5)
    write_object_tree(tmp_path / "other", 1)
    shutil.move(tmp_path / "other" / "training", tree / "testing")
    write_shards(tree, tmp_path / "shards", frames_per_shard=2)
    return tmp_path / "shards"


def pack(shards, out, *, workers=1, name="sparse", **job):
    return predict_shards(
        TASK, FunctionPredictor(sparse, name), shards, out, workers=workers, **job
    )


def contents(root):
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }


def test_unpacked_results_are_those_of_a_job_without_shards(shards, tmp_path):
    assert pack(shards, tmp_path / "packed") == JobResult(written=3, skipped=0)
    with tarfile.open(tmp_path / "packed" / "000001.tar") as tar:
        assert tar.getnames() == ["000001.png", "000002.png"]
    unpack_shards(tmp_path / "packed", tmp_path / "unpacked")
    write(shards, tmp_path / "expected")
    assert contents(tmp_path / "unpacked") == contents(tmp_path / "expected")
    read = data_path(tmp_path / "packed")
    assert (read / "000004.png").read_bytes() == (tmp_path / "expected/000004.png").read_bytes()


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # forks with threads around
def test_bytes_do_not_depend_on_workers_or_parts(shards, tmp_path):
    pack(shards, tmp_path / "one")
    pack(shards, tmp_path / "two", workers=2)
    for index in (1, 0):
        pack(shards, tmp_path / "parts", shard_index=index, num_shards=2)
    expected = contents(tmp_path / "one")
    assert len(expected) == 9
    assert contents(tmp_path / "two") == contents(tmp_path / "parts") == expected


def test_whole_shards_are_skipped_and_a_changed_one_is_made_again(shards, tmp_path):
    out = tmp_path / "out"
    pack(shards, out)
    expected = contents(out)
    tar = out / "000001.tar"
    tar.write_bytes(tar.read_bytes()[:-1] + b"\1")
    assert pack(shards, out) == JobResult(written=1, skipped=2)
    assert contents(out) == expected


def test_results_of_shards_packed_anew_from_other_frames_are_made_again(shards, tmp_path):
    out = tmp_path / "out"
    pack(shards, out)
    before = contents(out)
    tree = tmp_path / "tree"
    sweep = tree / "training" / "velodyne" / "000003.bin"
    sweep.write_bytes(sweep.read_bytes()[: 16 * 100])
    shutil.rmtree(shards)
    write_shards(tree, shards, frames_per_shard=2)
    assert pack(shards, out) == JobResult(written=1, skipped=2)
    changed = {name for name, content in contents(out).items() if content != before[name]}
    assert changed == {"000002.tar", "000002.json"}
    assert pack(shards, out) == JobResult(written=0, skipped=3)


def height(sample):
    """Predict the LiDAR's height, which depends on the other frames."""
    depth_m = torch.full(sample.image_size, sample.lidar_height_m)
    return DepthMap(depth_m=depth_m, valid=depth_m > 0)


def height_and_time(sample):
    """Predict the LiDAR's height and the time, which depend on the other frames."""
    depth_m = torch.full(sample.image_size, sample.lidar_height_m)
    depth_m[0, 0] = 50 + sample.timestamp_s
    return DepthMap(depth_m=depth_m, valid=depth_m > 0)


def write_changing_recording(folder):
    """Recording whose road is lower in each frame, by whose clouds the LiDAR is higher."""
    names = tuple("abcdefg")
    write_recording(folder, names, cloud=".npy")
    for place, name in enumerate(names):
        points = POINTS.copy()
        points[:, 2] -= 0.1 * place
        np.save(folder / "points" / f"{name}.npy", points)
    (folder / "times.txt").write_text("".join(f"{name} {at}\n" for at, name in enumerate(names)))
    return folder


@pytest.mark.parametrize("frames_per_shard", [1, 3])
def test_a_shard_has_the_height_and_the_times_of_the_whole(tmp_path, frames_per_shard):
    recording = write_changing_recording(tmp_path / "drive")
    write_shards(recording, tmp_path / "shards", frames_per_shard=frames_per_shard)
    predictor = FunctionPredictor(height_and_time, "height")
    with warnings.catch_warnings(action="ignore"):  # of equal images
        write(recording, tmp_path / "expected", height_and_time, name="height")
        predict_shards(TASK, predictor, tmp_path / "shards", tmp_path / "packed", workers=1)
    unpack_shards(tmp_path / "packed", tmp_path / "unpacked")
    assert contents(tmp_path / "unpacked") == contents(tmp_path / "expected")


def test_the_height_is_estimated_where_some_frames_have_no_sweep(tmp_path):
    recording = write_changing_recording(tmp_path / "drive")
    for name in "adg":
        (recording / "points" / f"{name}.npy").unlink()
    write_shards(recording, tmp_path / "shards", frames_per_shard=3)
    predictor = FunctionPredictor(height, "height")
    with warnings.catch_warnings(action="ignore"):
        predict_shards(TASK, predictor, tmp_path / "shards", tmp_path / "packed", workers=1)
        whole = open_dataset(recording, parts=("points",), needs=())[1].lidar_height_m
    unpack_shards(tmp_path / "packed", tmp_path / "unpacked")
    heights = {
        round(float(read_depth_png(path).max()), 2)
        for path in (tmp_path / "unpacked").glob("*.png")
    }
    assert len(heights) == 1
    assert heights.pop() == pytest.approx(whole, abs=0.15)


def test_the_height_in_one_of_two_splits_is_that_of_the_unpacked_split(tmp_path):
    tree = tmp_path / "tree"
    for split, count in (("testing", 3), ("training", 8)):
        for number in range(count):
            name = f"{number:06}"
            for part in ("image_2", "calib", "velodyne"):
                (path,) = (PACKAGED_FRAMES / "training" / part).glob("000000.*")
                (tree / split / part).mkdir(parents=True, exist_ok=True)
                shutil.copy(path, tree / split / part / f"{name}{path.suffix}")
            points = POINTS.copy()
            points[:, 2] -= 0.8 + 0.1 * number
            points.tofile(tree / split / "velodyne" / f"{name}.bin")
    write_shards(tree, tmp_path / "shards", frames_per_shard=2)
    with warnings.catch_warnings(action="ignore"):
        for split in ("training", "testing"):
            write(tree / split, tmp_path / f"{split}-expected", height, name="height")
            predictor = FunctionPredictor(height, "height")
            predict_shards(TASK, predictor, tmp_path / "shards" / split, tmp_path / split)
            unpack_shards(tmp_path / split, tmp_path / f"{split}-unpacked")
            found, expected = (
                {path.name: path.read_bytes() for path in (tmp_path / each).glob("*.png")}
                for each in (f"{split}-unpacked", f"{split}-expected")
            )
            assert found == expected


def test_a_changed_calibration_of_all_shards_makes_their_results_again(tmp_path):
    recording = write_changing_recording(tmp_path / "drive")
    shards, out = tmp_path / "shards", tmp_path / "out"
    with warnings.catch_warnings(action="ignore"):
        write_shards(recording, shards, frames_per_shard=3)
        assert pack(shards, out) == JobResult(written=3, skipped=0)
        write_calibration(recording, lidar_height_m=1.5)
        write_shards(recording, shards, frames_per_shard=3)
        assert pack(shards, out) == JobResult(written=3, skipped=0)
        assert pack(shards, out) == JobResult(written=0, skipped=3)


def test_a_damaged_shard_is_named_the_rest_finishes_and_mended_it_is_made_alone(shards, tmp_path):
    pack(shards, tmp_path / "expected")
    tar = shards / "000001.tar"
    whole = tar.read_bytes()
    rows = json.loads(tar.with_suffix(".json").read_text())["files"]
    offset = next(row[2] for row in rows if row[0] == "training/velodyne/000002.bin")
    tar.write_bytes(whole[: offset + 5] + bytes([whole[offset + 5] ^ 1]) + whole[offset + 6 :])
    message = r"1 of 3 failed, the others are done: shard 000001\.tar: sample 000002: .* damaged"
    with pytest.raises(ValueError, match=message):
        pack(shards, tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").glob("*.tar")) == [
        "000000.tar",
        "000002.tar",
        "shared.tar",
    ]
    tar.write_bytes(whole)
    assert pack(shards, tmp_path / "out") == JobResult(written=1, skipped=2)
    assert contents(tmp_path / "out") == contents(tmp_path / "expected")


def test_another_job_in_the_same_folder_is_refused_and_nothing_changes(shards, tmp_path):
    out = tmp_path / "out"
    pack(shards, out)
    before = contents(out)
    with pytest.raises(ValueError, match=r"method sparse instead of other.*would mix with this"):
        pack(shards, out, name="other")
    write_shards(tmp_path / "tree", tmp_path / "fewer", frames_per_shard=4)
    with pytest.raises(ValueError, match="frames_per_shard 2 instead of 4"):
        pack(tmp_path / "fewer", out)
    assert contents(out) == before


@pytest.mark.parametrize("data", ["tree", "shards/000001.tar"])
def test_what_is_no_folder_of_shards_is_refused(shards, tmp_path, data):
    assert shards.is_dir()
    with pytest.raises(ValueError, match="is no folder of shards; pack the data by"):
        pack(tmp_path / data, tmp_path / "out")


def test_perceive_packs_all_tasks_and_their_shards_are_scored(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_shards(PACKAGED_FRAMES, tmp_path / "shards", frames_per_shard=1)
    tasks = ["--detection2d", "detection2d-fast-cpu", "--depth-completion", "nearest",
             "--detection3d", "none", "--workers", "1"]  # fmt: skip
    assert main(["perceive", "shards", "packed", "--pack", *tasks]) == 0
    assert "packed: shards: 2 written, 0 there already" in capsys.readouterr().out
    assert main(["perceive", "shards", "plain", *tasks]) == 0
    assert main(["unshard", "packed", "unpacked"]) == 0
    expected = {
        path: content
        for path, content in contents(tmp_path / "plain").items()
        if not path.startswith(("timings", "perception.jsonl"))
    }
    assert contents(tmp_path / "unpacked") == expected
    assert any(path.startswith("lines/") for path in expected)
    capsys.readouterr()
    scores = []
    for name in ("packed", "plain"):
        labels = PACKAGED_FRAMES / "training" / "label_2"
        assert main(["evaluate", "objects", f"{name}/detection2d", str(labels)]) == 0
        depth = ["evaluate", "depth", f"{name}/depth-completion"]
        assert main([*depth, str(PACKAGED_FRAMES / "training" / "depth")]) == 0
        scores.append(capsys.readouterr().out.replace(name, ""))
    assert scores[0] == scores[1]
    assert "Car" in scores[0]


def without(tree, part, *names):
    """The tree, without these frames' files of a part."""
    for name in names:
        (path,) = (tree / "training" / part).glob(f"{name}.*")
        path.unlink()
    return tree


def assert_packs_and_tells_the_same(tree, tmp_path, predictors, *, frames_per_shard):
    """Packed results and warnings of missing sensors are those of a job without --pack."""
    shards = tmp_path / "shards"
    write_shards(tree, shards, frames_per_shard=frames_per_shard)
    told = []
    for job, out in ((perceive_shards, "packed"), (partial(perceive, align=False), "plain")):
        with warnings.catch_warnings(record=True, action="always") as caught:
            job(shards, tmp_path / out, perceiver=predictors)
        told.append({text for each in caught if "there are no" in (text := str(each.message))})
    unpack_shards(tmp_path / "packed", tmp_path / "unpacked")
    expected = {
        path: content
        for path, content in contents(tmp_path / "plain").items()
        if not path.startswith(("timings", "perception.jsonl")) and ".lacks" not in path
    }
    assert contents(tmp_path / "unpacked") == expected
    assert told[0] == told[1]
    return sorted(told[0])


def test_a_shard_may_begin_with_a_frame_without_a_sensor(tmp_path):
    tree = write_object_tree(tmp_path / "tree", 6)
    without(tree, "velodyne", "000000", "000001", "000004")  # all of the first shard
    without(tree, "image_2", "000002")
    told = assert_packs_and_tells_the_same(tree, tmp_path, perceiver(), frames_per_shard=2)
    assert [each.split(": ")[1].split(";")[0] for each in told] == [
        "there are no images for 1 of 6 frames, the first is 000002",
        "there are no point clouds for 3 of 6 frames, the first is 000000",
    ]


def test_joined_objects_are_packed_of_a_shard_that_begins_without_an_image(tmp_path):
    shutil.copytree(PACKAGED_FRAMES, tree := tmp_path / "tree")
    without(tree, "image_2", "000000")
    predictors = MultiTaskPredictor.load({"depth-completion": None}, threads=1)
    (told,) = assert_packs_and_tells_the_same(tree, tmp_path, predictors, frames_per_shard=2)
    assert "1 of 2 frames, the first is 000000" in told
    assert (tmp_path / "unpacked" / "joined" / "000000.txt").is_file()


@pytest.mark.parametrize("layout", ["object tree", "recording"])
def test_gaps_of_shards_are_refused_with_a_remedy_that_works(tmp_path, layout):
    if layout == "recording":
        data = write_changing_recording(tmp_path / "drive")
        (data / "points" / "c.npy").unlink()
    else:
        data = without(write_object_tree(tmp_path / "tree", 4), "velodyne", "000002")
    predictor = FunctionPredictor(sparse, needs=("points",))
    message = (
        r"1 of \d failed.* of 1 of 2 frames \((c|000002)\); shard the complete frames alone, or "
        "leave --pack out and name a list of them"
    )
    with warnings.catch_warnings(action="ignore"):
        write_shards(data, tmp_path / "shards", frames_per_shard=2)
        with pytest.raises(ValueError, match=message):
            predict_shards(TASK, predictor, tmp_path / "shards", tmp_path / "out", workers=1)


def test_packed_depth_is_compared_with_other_depth(tmp_path):
    write_shards(PACKAGED_FRAMES, tmp_path / "shards", frames_per_shard=1)
    pack(tmp_path / "shards", tmp_path / "packed")
    pack(tmp_path / "shards", tmp_path / "other", name="other")
    unpack_shards(tmp_path / "other", tmp_path / "files")
    truth = PACKAGED_FRAMES / "training" / "depth"
    with pytest.warns(UserWarning, match="have the same scores in all 2 images"):
        reports = [
            evaluate_depth(
                tmp_path / "packed", truth, against=tmp_path / other, progress=False
            ).to_json()
            for other in ("other", "files")
        ]
    assert reports[0] == reports[1]


def test_options_that_whole_shards_cannot_have_are_refused(tmp_path, capsys):
    command = ["predict", "depth-completion", str(PACKAGED_FRAMES), str(tmp_path / "out"), "--pack"]
    assert main([*command, "--method", "nearest", "--overwrite"]) == 2
    assert "leave --overwrite out, or --pack" in capsys.readouterr().err


def test_a_truncated_tar_is_blamed_and_no_temporary_folder(shards, tmp_path):
    tar = shards / "000001.tar"
    tar.write_bytes(tar.read_bytes()[:3000])
    message = r"^1 of 3 failed, the others are done: shard 000001\.tar: sample .* ends at byte"
    with pytest.raises(ValueError, match=message):
        pack(shards, tmp_path / "out")
    assert (tmp_path / "out" / "000002.tar").exists()


def test_an_absent_tar_is_named_with_its_cause(shards, tmp_path):
    (shards / "000001.tar").unlink()
    message = r"^1 of 3 failed, the others are done: .*000001\.tar: is missing, or no regular file"
    with pytest.raises(ValueError, match=message):
        pack(shards, tmp_path / "out")


def test_results_in_shards_and_as_files_are_not_written_to_one_folder(shards, tmp_path):
    pack(shards, tmp_path / "packed")
    before = contents(tmp_path / "packed")
    with pytest.raises(ValueError, match="packed holds shards, which would mix with this job"):
        write(shards, tmp_path / "packed")
    assert contents(tmp_path / "packed") == before
    write(shards, tmp_path / "plain")
    with pytest.raises(ValueError, match="plain holds files that are not in shards"):
        pack(shards, tmp_path / "plain")


def test_packed_results_are_read_by_every_command_that_reads_results(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_shards(PACKAGED_FRAMES, tmp_path / "shards", frames_per_shard=1)
    labels = str(PACKAGED_FRAMES / "training" / "label_2")
    for name in ("detection2d-best", "detection2d-fast-cpu"):
        command = ["predict", "detection2d", "shards", name, "--weights", name, "--pack"]
        assert main([*command, "--workers", "1"]) == 0
    unpack_shards(tmp_path / "detection2d-best", tmp_path / "files")
    commands = [
        ["evaluate", "calibration", "RESULTS", labels],
        ["evaluate", "proposals", "RESULTS", labels],
        ["evaluate", "objects", "RESULTS", labels, "--against", "detection2d-fast-cpu"],
        ["submission", "RESULTS", "out.zip"],
    ]
    for command in commands:
        printed = []
        for results in ("detection2d-best", "files"):
            capsys.readouterr()
            assert main([results if each == "RESULTS" else each for each in command]) == 0
            printed.append(capsys.readouterr().out.replace(results, "").split())
        assert printed[0] == printed[1]
        assert "WARNING:" not in printed[0]  # of results that are the same to the byte
