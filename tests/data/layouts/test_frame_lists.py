import os
import re
import threading
from pathlib import Path

import pytest

from sightline.data.check import check_tree
from sightline.data.layouts.frame_lists import (
    describe_left_out,
    read_sample_list,
    require_frame_files,
)
from sightline.data.open import open_dataset
from sightline.data.sharding import write_shards
from sightline.evaluation.kitti_object import frame_names
from sightline.files import plain_file, plain_text
from sightline.files.problem import FileError
from sightline.files.shard_path import data_path
from tests.data.recordings import write_recording
from tests.data.trees import write_object_tree


def test_the_published_lists_part_the_7481_training_frames(tmp_path):
    train = read_sample_list("kitti-object-train", tmp_path)
    val = read_sample_list("kitti-object-val", tmp_path)
    assert (len(train), len(val)) == (3712, 3769)
    assert sorted(train + val) == [f"{number:06}" for number in range(7481)]
    assert (train[:3], val[:3]) == (("000000", "000003", "000007"), ("000001", "000002", "000004"))


def test_a_list_is_a_path_or_a_name_in_image_sets_or_the_frames_themselves(tmp_path):
    (tmp_path / "ImageSets").mkdir()
    (tmp_path / "ImageSets" / "mine.txt").write_text("000003\r\n\n 000001\n")
    expected = ("000003", "000001")
    assert read_sample_list("mine", tmp_path) == expected
    assert read_sample_list(tmp_path / "ImageSets" / "mine.txt", "elsewhere") == expected
    assert read_sample_list(str(tmp_path / "ImageSets" / "mine.txt"), "elsewhere") == expected
    assert read_sample_list(["000003", "000001"], tmp_path) == expected


def test_lists_of_the_data_set_go_before_packaged_ones_and_files_of_their_names(
    tmp_path, monkeypatch
):
    lists, here = tmp_path / "ImageSets", tmp_path / "here"
    lists.mkdir()
    here.mkdir()
    monkeypatch.chdir(here)
    for name in ("val", "kitti-object-val", "mine"):
        (here / name).write_text("000007")
    (lists / "val.txt").write_text("000003")
    assert read_sample_list("val", tmp_path) == ("000003",)
    assert read_sample_list("./val", tmp_path) == ("000007",)
    assert read_sample_list(here / "val", tmp_path) == ("000007",)
    assert read_sample_list(Path("val"), tmp_path) == ("000007",)
    assert len(read_sample_list("kitti-object-val", tmp_path)) == 3769
    (lists / "kitti-object-val.txt").write_text("000001")
    assert read_sample_list("kitti-object-val", tmp_path) == ("000001",)
    assert read_sample_list("mine", tmp_path) == ("000007",)
    (lists / "val.txt.txt").write_text("000009")
    (here / "val.txt").write_text("000007")
    assert read_sample_list("val.txt", tmp_path) == ("000007",)


def test_an_unknown_list_is_answered_with_those_there_are(tmp_path):
    (tmp_path / "ImageSets").mkdir()
    (tmp_path / "ImageSets" / "mine.txt").write_text("000003")
    with pytest.raises(ValueError, match=r"'trian'; .* kitti-object-train, kitti-object-val, mine"):
        read_sample_list("trian", tmp_path)


def test_an_empty_list_and_a_frame_named_twice_are_refused_by_name(tmp_path):
    path = tmp_path / "mine.txt"
    path.write_text("\n \n")
    with pytest.raises(ValueError, match=r"mine\.txt names no frames"):
        read_sample_list(path, tmp_path)
    path.write_text("0\n1\n2\n1\n")
    with pytest.raises(ValueError, match=r"mine\.txt names frame '1' twice"):
        read_sample_list(path, tmp_path)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("# val", "'# val' in the list is a comment, which lists cannot hold; remove it"),
        ("000000.png", "'000000.png' in the list has the ending of a file; write 000000"),
        ("/kitti/000000.png", "'/kitti/000000.png' in the list has the ending of a file; write 0"),
        (
            "000000 000001",
            "'000000 000001' in the list is no single name; write one frame per line",
        ),
        ("000000\t1", r"'000000\t1' in the list is no single name; write one frame per line"),
    ],
)
def test_a_line_that_is_no_name_is_told_where_its_frame_is_missing(tmp_path, line, said):
    tree = write_object_tree(tmp_path / "tree", "000000", "000001")
    write_recording(tmp_path / "recording", ("000000", "000001"))
    for names in ([line], ["000000", line]):
        for data in (tree, tmp_path / "recording"):
            with pytest.raises(ValueError, match=re.escape(said)):
                open_dataset(data, sample_list=names)
        with pytest.raises(ValueError, match=re.escape(said)):
            require_frame_files(tree / "training" / "label_2", names, "label", "extract again")


def test_a_list_may_come_through_a_pipe():
    source, sink = os.pipe()
    with os.fdopen(source, "rb"), os.fdopen(sink, "wb") as file:
        file.write(b"000003\n000001\n")
        file.flush()
        reader = threading.Timer(0.1, file.close)
        reader.start()
        assert read_sample_list(f"/dev/fd/{source}", "elsewhere") == ("000003", "000001")
        reader.join()


def test_a_pipe_that_nobody_writes_to_is_not_waited_for_without_end(tmp_path, monkeypatch):
    monkeypatch.setattr(plain_file, "_TIMEOUT_S", 0.01)
    os.mkfifo(tmp_path / "names")
    with pytest.raises(FileError, match=r"names: gives nothing for 0\.01 s; name a file"):
        read_sample_list(tmp_path / "names", tmp_path)


def test_a_pipe_that_gives_nothing_or_no_end_is_refused(monkeypatch):
    source, sink = os.pipe()
    with os.fdopen(source, "rb"), os.fdopen(sink, "wb") as file:
        monkeypatch.setattr(plain_file, "_TIMEOUT_S", 0.01)
        with pytest.raises(FileError, match=r"gives nothing for 0\.01 s; name a file"):
            read_sample_list(f"/dev/fd/{source}", "elsewhere")
        monkeypatch.setattr(plain_text, "_MAX_BYTES", 10)
        file.write(b"000001\n" * 3)
        file.flush()
        with pytest.raises(FileError, match="holds more than 10 bytes"):
            read_sample_list(f"/dev/fd/{source}", "elsewhere")


def refusal(folder) -> str:
    with pytest.raises(ValueError, match="has no result file for 2 of 2 frames") as caught:
        require_frame_files(folder, ["000000", "000001"], "result", "write them")
    return str(caught.value)


def test_labels_are_not_named_as_results(tmp_path):
    labels = tmp_path / "training" / "label_2"
    labels.mkdir(parents=True)
    (labels / "000000.txt").write_text("")
    assert refusal(tmp_path).endswith(f"they are probably in {labels}; name that folder")
    with pytest.raises(ValueError, match=r"frames, the first is 000000\.txt: write them"):
        require_frame_files(tmp_path, ["000000"], "result", "write them", other_than=labels)


def test_results_in_the_folder_data_are_found_and_named(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "000000.txt").write_text("")
    assert refusal(tmp_path).endswith(
        f"they are in {tmp_path / 'data'}, as KITTI's own program writes them; name that folder"
    )
    (tmp_path / "data" / "000000.txt").unlink()
    assert refusal(tmp_path).endswith(": write them")
    for name in ("joined/data", "detection2d"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "000001.txt").write_text("")
    assert refusal(tmp_path).endswith(
        "2 of its folders hold some (detection2d, joined/data); name one of them"
    )


@pytest.mark.parametrize("place", ["training/label_2", "label_2", "labels"])
def test_labels_in_a_data_set_are_found_beside_calibrations_of_their_names(tmp_path, place):
    for folder in (tmp_path / place, (tmp_path / place).parent / "calib"):
        folder.mkdir(parents=True)
        (folder / "000000.txt").write_text("")
    assert refusal(tmp_path).endswith(f"probably in {tmp_path / place}; name that folder")


def test_files_of_other_frames_or_formats_are_told(tmp_path):
    (tmp_path / "0.json").write_text("")
    assert "holds 1 files of another format, such as 0.json; write one NAME.txt" in refusal(
        tmp_path
    )
    (tmp_path / "000007.txt").write_text("")
    assert "holds 1 files of other frames, such as 000007.txt; name a list" in refusal(tmp_path)


def _write_lists(root, *frames):
    (root / "ImageSets").mkdir()
    (root / "ImageSets" / "val.txt").write_text("\n".join(frames))


def _labels(folder, *names):
    folder.mkdir()
    for name in names:
        (folder / f"{name}.txt").write_text("")
    return folder


def test_the_list_of_labels_is_the_data_sets_own(tmp_path):
    """As it is where the data set itself is opened, also by links and in shards."""
    _write_lists(tmp_path, "above")
    drive = write_recording(tmp_path / "drive")
    _write_lists(drive, "b")
    labels = _labels(drive / "labels", "a", "b")
    write_shards(drive, tmp_path / "shards", frames_per_shard=2)
    (tmp_path / "link").symlink_to(labels)
    for place in (labels, tmp_path / "shards" / "labels", tmp_path / "link"):
        assert frame_names(data_path(place), "val") == ("b",)
    tree = write_object_tree(tmp_path / "tree", "000000", "000001")
    _write_lists(tree, "000001")
    (tmp_path / "split").symlink_to(tree / "training")
    for place in (tree / "training", tmp_path / "split"):
        assert frame_names(place / "label_2", "val") == ("000001",)
    assert frame_names(_labels(tree / "others", "above"), "val") == ("above",)


def test_notes_and_hidden_files_beside_labels_are_no_frames(tmp_path):
    tree = write_object_tree(tmp_path, "000000", "000001")
    labels = tree / "training" / "label_2"
    for name in ("classes.txt", "README.txt", "._000000.txt"):
        (labels / name).write_text("Car")
    (tree / "training" / "calib" / "readme.txt").write_text("")
    assert list(frame_names(labels, None)) == ["000000", "000001"]
    assert open_dataset(tree).sample_ids == ("000000", "000001")
    assert list(check_tree(tree)) == []


@pytest.mark.parametrize("place", ["data", "label_02/data"])
def test_labels_in_a_folder_below_are_named(tmp_path, place):
    readings = tmp_path / "calib"
    readings.mkdir()
    (readings / "000000.txt").write_text("P2: 1 2 3\n")
    labels = write_object_tree(tmp_path / "tree", "000000") / "training" / "label_2"
    (tmp_path / place).parent.mkdir(exist_ok=True)
    labels.rename(tmp_path / place)
    with pytest.raises(ValueError, match=f"there are labels in {tmp_path / place}; name that"):
        frame_names(tmp_path, None)


def test_labels_of_another_format_are_told(tmp_path):
    with pytest.raises(ValueError, match=r"no label files .*; give KITTI's folder label_2"):
        frame_names(tmp_path, None)
    (tmp_path / "classes.txt").write_text("Car")
    (tmp_path / "Thumbs.db").write_text("")
    (tmp_path / "#recycle").mkdir()
    (tmp_path / "#recycle" / "000000.txt").write_text("Car")
    with pytest.raises(ValueError, match=r"no label files .*; give KITTI's folder label_2"):
        frame_names(tmp_path, None)
    (tmp_path / "000000.xml").write_text("")
    with pytest.raises(ValueError, match=r"1 files of another format, such as 000000\.xml"):
        frame_names(tmp_path, None)


@pytest.mark.parametrize(
    "written", [("0", "1"), ("00000000", "00000001"), ("000000.png", "000001.png"), ("f0", "f1")]
)
def test_files_of_the_same_frames_in_another_form_are_told_to_be_renamed(tmp_path, written):
    for name in written:
        (tmp_path / f"{name}.txt").write_text("")
    assert refusal(tmp_path).endswith(
        f"holds 2 files with other names, such as {written[0]}.txt; rename them as 000000.txt"
    )


@pytest.mark.parametrize("written", ["0000", "0020"])
def test_results_of_a_whole_sequence_are_not_to_be_renamed(tmp_path, written):
    (tmp_path / f"{written}.txt").write_text(f"0 4 Car {'1 ' * 14}0.9\n")
    said = refusal(tmp_path)
    assert f"{written}.txt, line 1 has 18 fields: frame and track number come before the" in said
    assert "write a file for each frame without its first two fields" in said


@pytest.mark.parametrize("written", [("0", "00"), ("0", "7"), ("0", "a"), ("0_1", "1_1")])
def test_files_that_name_no_frame_each_are_of_other_frames(tmp_path, written):
    for name in written:
        (tmp_path / f"{name}.txt").write_text("")
    assert "holds 2 files of other frames" in refusal(tmp_path)


def test_results_two_folders_below_are_found(tmp_path):
    (tmp_path / "epoch_80" / "pred").mkdir(parents=True)
    (tmp_path / "epoch_80" / "pred" / "000001.txt").write_text("")
    assert refusal(tmp_path).endswith(f"are in {tmp_path}/epoch_80/pred; name that folder")
    assert describe_left_out(tmp_path) == "1 folder (the first is epoch_80) with 1 .txt files"


def test_a_pipe_that_is_read_twice_gives_the_same_list(tmp_path):
    reading, writing = os.pipe()
    os.write(writing, b"000001\n000000\n")
    os.close(writing)
    try:
        lists = [read_sample_list(f"/dev/fd/{reading}", tmp_path) for _ in range(2)]
    finally:
        os.close(reading)
    assert lists == [("000001", "000000")] * 2
