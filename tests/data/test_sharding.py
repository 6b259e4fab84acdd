"""Data sets in shards: their bytes, reading without unpacking, damage and resumption."""

import gzip
import hashlib
import json
import os
import shutil
import tarfile
import zlib
from pathlib import Path

import pytest
import torch

from sightline.cli.main import main
from sightline.data.check import check_tree
from sightline.data.datasets.sample_files import list_sample_files
from sightline.data.open import open_dataset
from sightline.data.sharding import unpack_shards, write_shards
from sightline.files.byte_source import read_range, read_small
from sightline.files.problem import FileError
from sightline.files.shard_path import ShardPath, data_path
from tests.data.recordings import write_nuscenes, write_recording
from tests.data.trees import (
    write_depth_drive,
    write_drive,
    write_object_frame,
    write_selection,
)

pytestmark = pytest.mark.filterwarnings("ignore:.*only the frames in training are used")

NAMES = tuple(f"{number:06d}" for number in range(5))


def write_tree(root):
    for seed, name in enumerate(NAMES):
        write_object_frame(root, name, seed=seed)
    write_object_frame(root, "000000", "testing", seed=9)
    (root / "ImageSets").mkdir()
    (root / "ImageSets" / "val.txt").write_text("000003\n000001\n")
    (root / ".hidden").write_text("not packed")
    return root


@pytest.fixture
def tree(tmp_path):
    return write_tree(tmp_path / "tree")


@pytest.fixture
def shards(tree, tmp_path):
    write_shards(tree, tmp_path / "shards", frames_per_shard=2)
    return tmp_path / "shards"


@pytest.mark.parametrize("name", ["training", "drive"])
def test_a_recording_is_packed_under_any_name_of_its_folder(tmp_path, name):
    recording = write_recording(tmp_path / name)
    write_shards(recording, tmp_path / "shards", frames_per_shard=2)
    packed, loose = open_dataset(tmp_path / "shards"), open_dataset(recording)
    assert packed.sample_ids == loose.sample_ids
    torch.testing.assert_close(packed[0].points, loose[0].points, rtol=0, atol=0)


def contents(root):
    """Contents of the files of a folder that are not hidden, by their paths."""
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and not path.name.startswith(".")
    }


def damage(tar, path):
    """Change one byte of a file in a tar."""
    rows = json.loads(tar.with_suffix(".json").read_text())["files"]
    offset = next(row[2] for row in rows if row[0] == path)
    content = bytearray(tar.read_bytes())
    content[offset + 5] ^= 1
    tar.write_bytes(content)


def test_a_frame_is_a_sample_of_webdataset(shards):
    with tarfile.open(shards / "000000.tar") as tar:
        members = tar.getmembers()
    kinds = ["calib.txt", "image_2.png", "label_2.txt", "velodyne.bin"]
    assert [each.name for each in members] == [
        *(f"testing/000000.{kind}" for kind in kinds if kind != "label_2.txt"),
        *(f"training/000000.{kind}" for kind in kinds),
    ]
    assert {(each.mtime, each.uid, each.gid, each.uname) for each in members} == {(0, 0, 0, "")}
    with tarfile.open(shards / "shared.tar") as tar:
        assert tar.getnames() == ["ImageSets/val.txt"]


@pytest.mark.parametrize("compress", [False, True])
def test_equal_data_give_equal_bytes_and_come_back(compress, tree, tmp_path):
    for name, workers in (("one", 1), ("two", 3)):
        report = write_shards(
            tree, tmp_path / name, frames_per_shard=4, compress=compress, workers=workers
        )
        assert str(report) == "3 written, 0 there already"
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
    for tar in (tmp_path / "one").glob("*.tar"):
        index = json.loads(tar.with_suffix(".json").read_text())
        assert index["sha256"] == hashlib.sha256(tar.read_bytes()).hexdigest()
        assert index["bytes"] == tar.stat().st_size
    unpack_shards(tmp_path / "one", tmp_path / "back")
    assert contents(tmp_path / "back") == contents(tree)


def test_shards_give_the_samples_and_findings_of_the_tree(tree, shards):
    label = tree / "training" / "label_2" / "000002.txt"
    label.write_text(label.read_text().replace("Car", "Car Car"))
    faulty = tree.with_name("faulty")
    write_shards(tree, faulty, frames_per_shard=3, compress=True)
    one, other = open_dataset(tree), open_dataset(shards)
    assert one.sample_ids == other.sample_ids == NAMES
    for index in (0, 4):
        assert torch.equal(one[index].image, other[index].image)
        assert torch.equal(one[index].points, other[index].points)
        assert torch.equal(one[index].objects.boxes3d.bev, other[index].objects.boxes3d.bev)
    chosen = open_dataset(shards, sample_list="val")
    assert chosen.sample_ids == ("000003", "000001")
    expected = [str(each).replace(str(tree), "DATA") for each in check_tree(tree)]
    assert len(expected) >= 1
    assert [str(each).replace(str(faulty), "DATA") for each in check_tree(faulty)] == expected


@pytest.mark.usefixtures("shards")
def test_commands_give_the_bytes_of_the_unpacked_tree(tree, capsys):
    folder = tree.parent  # which gets a shards.json of another kind
    for name in ("tree", "shards"):
        arguments = ["predict", "depth-completion", folder / name, folder / f"{name}-out"]
        assert main([*map(str, arguments), "--method", "nearest", "--workers", "1"]) == 0
        arguments = ["corrupt", folder / name, folder / f"{name}-bad", "--cases", "lidar_blank"]
        assert main([*map(str, arguments), "--workers", "1"]) == 0
    assert contents(folder / "tree-out") == contents(folder / "shards-out")
    bad = contents(folder / "tree-bad")
    assert "lidar_blank/training/image_2/000003.png" in bad
    assert contents(folder / "shards-bad") == bad
    results = folder / "results"
    results.mkdir()
    for path in (tree / "training" / "label_2").iterdir():
        lines = [f"{line} 0.9" for line in path.read_text().splitlines() if "DontCare" not in line]
        (results / path.name).write_text("".join(f"{line}\n" for line in lines))
    capsys.readouterr()
    printed = []
    for name in ("tree", "shards"):
        report = folder / f"{name}.json"
        labels = folder / name / "training" / "label_2"
        arguments = ["evaluate", "objects", results, labels, "--json", report]
        assert main([*map(str, arguments)]) == 0
        assert main(["check", str(folder / name), "--workers", "1"]) in (0, 1)
        printed.append(capsys.readouterr().out.replace(f"{name}", "DATA"))
    assert printed[0] == printed[1]
    assert (folder / "tree.json").read_bytes() == (folder / "shards.json").read_bytes()


def test_a_recording_and_a_drive_are_read_from_shards(tmp_path):
    recording = write_recording(tmp_path / "recording", ("a.1", "b"), cloud=".pcd")
    write_shards(recording, tmp_path / "packed", frames_per_shard=1)
    (tmp_path / "packed").rename(tmp_path / "elsewhere")
    assert rows_of(tmp_path / "elsewhere" / "000000.tar")[0][1].startswith("a%2E1.")
    one, other = open_dataset(recording), open_dataset(tmp_path / "elsewhere")
    assert one.sample_ids == other.sample_ids == ("a.1", "b")
    assert torch.equal(one[0].points, other[0].points)
    assert torch.equal(one[1].image, other[1].image)
    day, drive = tmp_path / "2011_09_26", "2011_09_26_drive_0001_sync"
    shutil.copytree(write_drive(day / drive), day / "night.png")
    (day / "synced.bag").write_bytes(b"#ROSBAG V2.0")  # as converters leave it there
    with pytest.warns(UserWarning, match=r"1 bags, e\.g\. synced\.bag, are no part of the data"):
        write_shards(day, tmp_path / "packed-day", frames_per_shard=2)
    one, other = open_dataset(day / drive), open_dataset(tmp_path / "packed-day" / drive)
    assert one.sample_ids == other.sample_ids
    assert torch.equal(one[1].points, other[1].points)


def test_a_drive_without_its_days_calibration_is_not_packed(tmp_path):
    drive = write_drive(tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync")
    with pytest.raises(
        ValueError, match=r"one folder up; pack the folder of its day, .*2011_09_26"
    ):
        write_shards(drive, tmp_path / "packed", frames_per_shard=2)
    assert not (tmp_path / "packed").exists()
    for path in drive.parent.glob("calib_*.txt"):
        shutil.copy(path, drive)
    write_shards(drive, tmp_path / "packed", frames_per_shard=2)
    assert not list(check_tree(tmp_path / "packed"))


def test_times_of_other_shards_are_no_fault_of_a_single_one(tmp_path, recwarn):
    recording = write_recording(tmp_path / "recording", ("a", "b"))
    (recording / "times.txt").write_text("a 0.0\nb 0.1\n")
    write_shards(recording, tmp_path / "packed", frames_per_shard=1)
    for name in ("", "000000.tar", "000001.tar"):
        assert not list(check_tree(tmp_path / "packed" / name))
        open_dataset(tmp_path / "packed" / name)
    assert not recwarn
    (recording / "times.txt").write_text("a 0.0\n")
    write_shards(recording, tmp_path / "other", frames_per_shard=1)
    (problem,) = check_tree(tmp_path / "other" / "000001.tar")
    assert "has no time of any frame" in str(problem)


def test_depth_trees_are_read_from_shards(tmp_path):
    write_selection(tmp_path / "selection")
    write_depth_drive(tmp_path / "drives", tmp_path / "drives")
    for name in ("selection", "drives"):
        write_shards(tmp_path / name, tmp_path / f"packed-{name}", frames_per_shard=1)
        one, other = open_dataset(tmp_path / name), open_dataset(tmp_path / f"packed-{name}")
        assert one.sample_ids == other.sample_ids
        assert torch.equal(one[0].image, other[0].image)
        assert torch.equal(one[0].depth, other[0].depth)
        assert torch.equal(one[0].points, other[0].points)


def test_a_split_by_drives_is_refused_with_the_tree_to_pack(tmp_path):
    write_depth_drive(tmp_path / "tree", tmp_path / "tree")
    tree, out = tmp_path / "tree" / "data_depth_velodyne", tmp_path / "packed"
    shutil.copytree(tmp_path / "tree" / "data_depth_annotated", tree, dirs_exist_ok=True)
    shutil.copytree(tmp_path / "tree" / "2011_09_26", tree / "2011_09_26")
    told = f"split val of a depth completion tree .*; pack the whole tree, {tree}; .* OUT/val"
    with pytest.raises(FileError, match=told):
        write_shards(tree / "val", out, frames_per_shard=1)
    assert not out.exists()
    write_shards(tree, out, frames_per_shard=1)
    assert len(open_dataset(out / "val")) == 1
    assert list(check_tree(out / "val")) == []


def rows_of(tar):
    return json.loads(tar.with_suffix(".json").read_text())["files"]


def test_one_tar_is_a_data_set_of_its_own(shards):
    dataset = open_dataset(shards / "000001.tar")
    assert dataset.sample_ids == ("000001", "000002")
    assert dataset[1].points is not None
    files = list_sample_files(dataset)[0]
    assert files["image"] == shards / "000001.tar" / "training" / "image_2" / "000001.png"


def test_paths_in_shards_behave_like_those_of_the_tree(tree, shards):
    packed = data_path(shards)
    assert isinstance(packed, ShardPath)
    for pattern in ("*", "training/*", "*/calib/00000?.txt", "nothing/*"):
        expected = sorted(each.relative_to(tree) for each in tree.glob(pattern))
        found = [each.relative_to(packed) for each in packed.glob(pattern)]
        assert found == [Path(each) for each in expected if each.name != ".hidden"]
    assert {str(each.relative_to(packed)) for each in packed.rglob("*.bin")} == {
        str(each.relative_to(tree)) for each in tree.rglob("*.bin")
    }
    path = packed / "training" / "calib" / "000001.txt"
    assert (path.exists(), path.is_file(), path.is_dir(), path.parent.is_dir()) == (1, 1, 0, 1)
    assert path.read_text() == (tree / "training" / "calib" / "000001.txt").read_text()
    with pytest.raises(FileNotFoundError):
        (packed / "training" / "calib" / "7.txt").read_bytes()
    with pytest.raises(IsADirectoryError):
        path.parent.read_bytes()
    with pytest.raises(OSError, match="cannot be written"):
        path.open("wb")
    assert data_path(tree / "training") == tree / "training"
    assert not isinstance(data_path(tree), ShardPath)


def test_whole_shards_are_kept_and_a_damaged_one_is_made_again(tree, shards):
    before = {path.name: path.stat().st_mtime_ns for path in shards.glob("*.tar")}
    damage(shards / "000001.tar", "training/velodyne/000001.bin")
    (shards / "000002.json").unlink()
    report = write_shards(tree, shards, frames_per_shard=2)
    assert str(report) == "2 written, 2 there already"
    after = {path.name: path.stat().st_mtime_ns for path in shards.glob("*.tar")}
    assert {name for name in after if after[name] != before[name]} == {"000001.tar", "000002.tar"}


@pytest.mark.parametrize("change", ["length", "same length", "other frame", "list"])
def test_a_shard_of_files_that_changed_since_is_made_again(change, tree, shards, tmp_path):
    label = tree / "training" / "label_2" / "000003.txt"
    if change == "length":
        label.write_text(label.read_text() * 2)
    elif change == "same length":
        label.write_text(label.read_text()[::-1])
    elif change == "list":
        (tree / "ImageSets" / "val.txt").write_text("000002\n")
    else:
        for path in sorted(tree.glob("training/*/000003.*")):
            path.rename(path.with_stem("0000031"))
    report = write_shards(tree, shards, frames_per_shard=2)
    assert str(report) == "1 written, 3 there already"
    unpack_shards(shards, tmp_path / "again")
    assert contents(tmp_path / "again") == contents(tree)


def test_a_damaged_shard_is_named_and_the_rest_is_unpacked(tree, shards, tmp_path, capsys):
    whole = (shards / "000001.tar").read_bytes()
    damage(shards / "000001.tar", "training/velodyne/000001.bin")
    arguments = ["unshard", str(shards), str(tmp_path / "back")]
    assert main(arguments) == 1
    printed = capsys.readouterr()
    assert "shards: 3 written, 0 there already, 1 failed" in printed.out
    (line,) = printed.err.splitlines()
    assert line.startswith(f"sightline: {shards}/000001.tar: is damaged: it has another checksum; ")
    assert not (tmp_path / "back" / "training" / "velodyne" / "000001.bin").exists()
    (shards / "000001.tar").write_bytes(whole)
    assert main(arguments) == 0
    assert "shards: 1 written, 3 there already" in capsys.readouterr().out
    assert contents(tmp_path / "back") == contents(tree)


def test_a_damaged_file_in_a_shard_is_named_when_it_is_read(shards):
    damage(shards / "000001.tar", "training/velodyne/000002.bin")
    dataset = open_dataset(shards / "000001.tar", parts=("points",))
    assert dataset[0].points is not None
    message = (
        r"000002\.bin: cannot be read: 000001\.tar is damaged: training/000002\.velodyne\.bin in "
        "it has another checksum"
    )
    with pytest.raises(ValueError, match=message):
        dataset[1]
    problems = [str(each) for each in check_tree(shards / "000001.tar")]
    assert sum("has another checksum" in each for each in problems) == 1
    assert not any("report this as a bug" in each for each in problems)


@pytest.mark.parametrize("name", ["calib/000003.txt", "velodyne/000003.bin"])
def test_a_file_that_cannot_be_read_fails_its_shard_alone(name, tree, tmp_path, capsys):
    path = tree / "training" / name
    content = path.read_bytes()
    path.unlink()
    path.symlink_to(tree / ("absent" if path.suffix == ".txt" else "training"))  # a file, a folder
    arguments = ["shard", str(tree), str(tmp_path / "out"), "--frames-per-shard", "2"]
    assert main(arguments) == 1
    printed = capsys.readouterr()
    assert "shards: 3 written, 0 there already, 1 failed" in printed.out
    assert f"sightline: {path}: " in printed.err
    path.unlink()
    path.write_bytes(content)
    assert main(arguments) == 0
    assert "shards: 1 written, 3 there already" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda row: row.__setitem__(0, "../outside.txt"), "'../outside.txt', of which a part is"),
        (lambda row: row.__setitem__(0, "/etc/passwd"), "expected a relative path"),
        (lambda row: row.__setitem__(2, 10**9), "is no index of a shard"),
        (lambda row: row.__setitem__(3, -1), "is no index of a shard"),
        (lambda row: row.__setitem__(4, "many"), "is no index of a shard"),
        (lambda row: row.__setitem__(4, 2**63), "is no index of a shard"),
        (lambda row: row.__setitem__(2, float("inf")), "is no index of a shard"),
        (lambda row: row.pop(), "is no index of a shard"),
    ],
)
def test_a_harmful_index_is_refused(change, message, shards, tmp_path):
    index = shards / "000000.json"
    content = json.loads(index.read_text())
    change(content["files"][0])
    index.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=message):
        open_dataset(shards / "000000.tar")
    report = unpack_shards(shards, tmp_path / "back")
    assert len(report.faults) == 1
    assert not (tmp_path / "outside.txt").exists()


def test_a_shard_without_files_is_no_shard_that_is_there_already(tree, tmp_path):
    shutil.rmtree(tree / "ImageSets")
    write_shards(tree, tmp_path / "one", frames_per_shard=100)
    assert str(unpack_shards(tmp_path / "one", tmp_path / "back")) == "1 written, 0 there already"
    assert str(unpack_shards(tmp_path / "one", tmp_path / "back")) == "0 written, 1 there already"


def test_a_bomb_is_not_unpacked_beyond_its_stated_length(shards):
    bomb = gzip.compress(bytes(10**7), mtime=0)
    tar = shards / "000000.tar"
    tar.write_bytes(bomb)
    row = ["training/velodyne/0.bin", "training/0.velodyne.bin.gz", 0, len(bomb), 64,
           zlib.crc32(bytes(64))]  # fmt: skip
    index = {"format": "sightline shard 1", "sha256": "", "bytes": len(bomb), "files": [row]}
    tar.with_suffix(".json").write_text(json.dumps(index))
    path = data_path(tar) / "training" / "velodyne" / "0.bin"
    with pytest.raises(OSError, match="has another checksum"):
        path.read_bytes()


@pytest.mark.parametrize("field", ["frames", "frames_per_shard", "data"])
def test_a_damaged_manifest_is_refused(field, shards):
    manifest = json.loads((shards / "shards.json").read_text())
    manifest[field] = 0
    (shards / "shards.json").write_text(json.dumps(manifest))
    told = r"shards\.json: is no manifest of shards; copy it again"
    with pytest.raises(ValueError, match=told):
        open_dataset(shards)
    (shards / "shards.json").write_text("damaged")
    with pytest.raises(ValueError, match=told):
        unpack_shards(shards, shards.with_name("back"))


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        (10**13, r"counts \d+ shards, expected at most 100000"),  # their names would fill memory
        (float("inf"), "is no manifest of shards"),
        (2, r"counts 1 shards, but there is 000001\.json"),  # frames that would be lost silently
    ],
)
def test_a_manifest_that_lies_about_the_shards_is_refused(frames, message, shards, tmp_path):
    manifest = json.loads((shards / "shards.json").read_text())
    (shards / "shards.json").write_text(json.dumps({**manifest, "frames": frames}))
    for use in (open_dataset, lambda folder: unpack_shards(folder, tmp_path / "back")):
        with pytest.raises(ValueError, match=message):
            use(shards)


def test_more_shards_than_a_manifest_may_count_are_not_begun(tree, tmp_path, monkeypatch):
    monkeypatch.setattr("sightline.data.sharding.MAX_SHARDS", 2)
    with pytest.raises(ValueError, match="are more than 2 shards; raise --frames-per-shard"):
        write_shards(tree, tmp_path / "out", frames_per_shard=1)
    assert not (tmp_path / "out").exists()


def test_a_file_that_two_entries_or_shards_name_is_refused(shards):
    index = shards / "000000.json"
    content = json.loads(index.read_text())
    first, *others = content["files"]
    index.write_text(json.dumps({**content, "files": [first, *others, first]}))
    with pytest.raises(ValueError, match=r"000000\.json: names a file twice"):
        open_dataset(shards)
    index.write_text(json.dumps(content))
    for suffix in (".tar", ".json"):
        shutil.copy(shards / f"000000{suffix}", shards / f"000001{suffix}")
    with pytest.raises(ValueError, match=r"000001\.json: names test.*, which another shard"):
        open_dataset(shards)


def exchange(files):
    files[0][1:], files[1][1:] = files[1][1:], files[0][1:]


@pytest.mark.parametrize("change", [lambda files: files.pop(), exchange])
def test_an_index_that_lists_other_files_than_its_tar_is_not_unpacked(change, shards, tmp_path):
    index = shards / "000000.json"
    content = json.loads(index.read_text())
    change(content["files"])
    index.write_text(json.dumps(content))
    (fault,) = unpack_shards(shards, tmp_path / "back").faults
    assert "000000.json: lists other files than 000000.tar holds; copy both again" in fault


def test_a_device_in_the_place_of_a_tar_is_not_read_without_end(shards, tmp_path):
    (shards / "000000.tar").unlink()
    (shards / "000000.tar").symlink_to("/dev/zero")
    (fault,) = unpack_shards(shards, tmp_path / "back").faults
    assert "000000.tar: is missing, or no regular file" in fault


def test_check_lists_the_files_of_a_truncated_shard_and_goes_on(shards, capsys):
    tar = shards / "000000.tar"
    tar.write_bytes(tar.read_bytes()[:2000])
    assert main(["check", str(shards)]) == 1
    printed = capsys.readouterr()
    assert "report this as a bug" not in printed.out
    assert "ends at byte" in printed.out
    assert printed.out.splitlines()[-1].endswith("problems")
    assert "Errno" not in printed.err


@pytest.mark.parametrize("end", [0, 1_000, 10_000, 10_001])
def test_the_end_of_a_truncated_file_is_told_as_it_is(tmp_path, end):
    path = tmp_path / "000000.tar"
    path.write_bytes(bytes(end))
    with pytest.raises(ValueError, match=f"ends at byte {end}, expected 30 bytes from 10000"):
        read_range(path, 10_000, 30)


def test_an_absent_shard_is_named_before_the_work(shards):
    shutil.move(shards / "000001.json", shards / "000001.gone")
    with pytest.raises(ValueError, match=r"000001\.json: is missing: the shard is not whole"):
        open_dataset(shards)


def test_other_data_in_the_folder_are_refused(tree, shards):
    with pytest.raises(ValueError, match="frames_per_shard"):
        write_shards(tree, shards, frames_per_shard=3)
    with pytest.raises(ValueError, match="holds no frames"):
        write_shards(tree / "ImageSets", shards.with_name("new"), frames_per_shard=3)
    (tree / "v1.0-mini").mkdir()  # beside a data set
    assert write_shards(tree, shards.with_name("beside"), frames_per_shard=3).written
    with pytest.raises(ValueError, match="nuScenes data set; convert it to a recording"):
        write_shards(write_nuscenes(shards.with_name("tables")), tree, frames_per_shard=3)
    with pytest.raises(ValueError, match="holds shards already; use them as they are"):
        write_shards(shards, shards.with_name("new"), frames_per_shard=3)
    with pytest.raises(ValueError, match="frames_per_shard must be at least 1, got 0"):
        write_shards(tree, shards.with_name("new"), frames_per_shard=0)
    unpacked = shards.with_name("back")
    (unpacked / "ImageSets").mkdir(parents=True)
    (unpacked / "ImageSets" / "val.txt").write_text("mine")
    report = unpack_shards(shards, unpacked)
    assert "holds something else; name an empty folder" in report.faults[0]
    assert (unpacked / "ImageSets" / "val.txt").read_text() == "mine"


def test_nothing_is_unpacked_among_other_files(shards, tmp_path):
    out = tmp_path / "found"
    out.mkdir()
    (out / "000001.txt").write_text("")
    with pytest.raises(ValueError, match=r"holds 000001\.txt, which is not in these shards"):
        unpack_shards(shards, out)
    assert contents(out).keys() == {"000001.txt"}
    (out / "000001.txt").unlink()
    unpack_shards(shards, out)
    assert unpack_shards(shards, out).written == 0


def test_a_split_keeps_its_name_and_the_lists(tree, tmp_path):
    write_shards(tree / "training", tmp_path / "one", frames_per_shard=10)
    dataset = open_dataset(tmp_path / "one", sample_list="val")
    assert dataset.sample_ids == ("000003", "000001")
    assert [row[0].split("/")[0] for row in rows_of(tmp_path / "one" / "000000.tar")] == [
        "training"
    ] * 20


@pytest.mark.parametrize("name", ["000000.tar", "000000.json", "shared.tar", "shards.json"])
def test_a_pipe_in_the_place_of_a_file_of_shards_is_not_waited_for(name, shards):
    (shards / name).unlink()
    os.mkfifo(shards / name)
    with pytest.raises(ValueError, match="is no regular file"):
        read_small(shards / name, 1000)
    assert any("no regular file" in str(each) for each in unpack_faults(shards, shards / "../back"))


def unpack_faults(shards, out):
    try:
        return unpack_shards(shards, out).faults
    except ValueError as error:
        return (error,)


def test_nothing_is_unpacked_through_a_link_or_beside_shards(shards, tree, tmp_path):
    (tmp_path / "back").mkdir()
    (tmp_path / "back" / "training").symlink_to(tree / "training")
    with pytest.raises(ValueError, match=r"is a link to .*, outside"):
        unpack_shards(shards, tmp_path / "back")
    write_shards(tree, tmp_path / "others", frames_per_shard=3)
    before = contents(tmp_path / "others")
    with pytest.raises(ValueError, match="others holds shards"):
        unpack_shards(shards, tmp_path / "others")
    assert contents(tmp_path / "others") == before


def test_a_truncated_first_picture_is_named_with_its_cause(shards):
    tar = shards / "000000.tar"
    tar.write_bytes(tar.read_bytes()[:2000])
    with pytest.raises(ValueError, match=r"000000\.\w+: cannot be read: 000000\.tar ends at byte"):
        open_dataset(shards / "000000.tar", parts=("image",))[0]


@pytest.mark.parametrize("place", [".", "training", "000001.tar", "000001.tar/training"])
@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (Path.unlink, "is missing, or no regular file; copy it again"),
        (lambda tar: tar.write_bytes(tar.read_bytes() + b"0"), "bytes long, expected 10240; copy"),
        (lambda tar: tar.write_bytes(bytes(10240)), "is damaged: it has another checksum; copy"),
    ],
)
def test_check_finds_damage_of_the_files_of_no_frame(shards, place, damage, told):
    before = list(check_tree(shards / place))
    damage(shards / "shared.tar")
    problem, *others = check_tree(shards / place)
    assert others == before
    assert problem.path == shards / "shared.tar"
    assert told in str(problem)


def test_an_open_data_set_reads_shards_that_are_packed_anew(tree, shards):
    dataset = open_dataset(shards)
    before = dataset[0].points
    sweep = tree / "training" / "velodyne" / "000000.bin"
    sweep.write_bytes(sweep.read_bytes()[16:])
    write_shards(tree, shards, frames_per_shard=2)
    assert len(dataset[0].points) == len(before) - 1


def test_an_open_data_set_reads_shards_whose_packing_was_killed_and_run_again(
    tree, shards, monkeypatch
):
    dataset = open_dataset(shards)
    before = dataset[0].points
    sweep = tree / "training" / "velodyne" / "000000.bin"
    sweep.write_bytes(sweep.read_bytes()[16:])
    monkeypatch.setattr(Path, "touch", lambda _: None)  # killed before
    write_shards(tree, shards, frames_per_shard=2)
    monkeypatch.undo()
    assert write_shards(tree, shards, frames_per_shard=2).written == 0
    assert len(dataset[0].points) == len(before) - 1
