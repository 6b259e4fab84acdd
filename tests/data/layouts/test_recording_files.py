import re
import shutil
from decimal import Decimal
from pathlib import Path

import pytest

from sightline.data.check import check_tree, summarize_tree
from sightline.data.formats.image_file import write_rgb
from sightline.data.layouts.frame_lists import read_sample_list
from sightline.data.layouts.kitti_trees import ObjectFrame
from sightline.data.layouts.recording_files import (
    begins_sequence,
    doubtful_steps,
    order_doubt,
    read_times,
)
from sightline.data.open import open_dataset
from sightline.files.problem import FileError
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.data.recordings import IMAGE, SAMPLE, write_calibration, write_recording


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a 1\na 2\n", "line 2 repeats frame a of line 1"),
        ("a nan\n", "value 1 is 'nan'"),
        ("a inf\n", "value 1 is 'inf'"),
        ("a 1\x85b 2\n", r"line 1 holds invisible characters: a 1\\x85b 2"),
        ("a 1\u2028b 2\n", "line 1 holds invisible characters"),
        ("a 1\x0cb 2\n", "line 1 holds invisible characters"),
        ("a\u00a01\n", "line 1 holds invisible characters"),
        ("a 1_0\n", "value 1 is '1_0'"),
        ("name time\na 1\n", "value 1 is 'time', .*; write lines like .*; no heading, no dates"),
        ("a 2026-01-01T00:00:00\n", "value 1 is '2026-.*; no heading, no dates"),
        ("1.0 a\n", "value 1 is 'a', .*name, then seconds as a number"),
        ("a 1700000000000\n", "is no time in seconds, probably in milliseconds"),
        ("a 1700000000000000\n", "is no time in seconds, probably in microseconds"),
        ("a 1700000000000000000\n", "is no time in seconds, probably in nanoseconds; divide"),
    ],
)
def test_times_that_cannot_be_read_are_one_line_in_check_and_on_opening(tmp_path, text, said):
    write_recording(tmp_path, ("a", "b"))
    (tmp_path / "times.txt").write_text(text, encoding="utf-8")
    with pytest.raises(FileError, match=said) as raised:
        open_dataset(tmp_path)
    assert [str(problem) for problem in check_tree(tmp_path)] == [str(raised.value)]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x 1\ny 2\n", r"has no time of any frame: it has x, y, frames are called a \.\."),
        ("\n", "has no time of any frame: it is empty"),
        ("a 1\nb 2\nx 3\n", r"1 of 3 lines name no frame \(x\)"),
        ("a 1\n", r"lacks a time of 1 of 2 frames \(b\)"),
        (
            "a 2\nb 1\n",
            r"do not rise from frame to frame: 1 of 2, 0 of them equal, such as that of b",
        ),
        ("a 1\nb 1.0\n", r"do not rise from frame to frame: 1 of 2, 1 of them equal"),
    ],
)
def test_times_that_do_not_fit_the_frames_are_told_by_check_and_on_opening(tmp_path, text, said):
    write_recording(tmp_path, ("a", "b"))
    (tmp_path / "times.txt").write_text(text)
    with pytest.warns(UserWarning, match=rf"times.txt: .*{said}"):
        open_dataset(tmp_path)
    (problem,) = check_tree(tmp_path)
    assert problem.path == tmp_path / "times.txt"


def test_lines_of_times_are_parted_by_tabs_and_blanks(tmp_path):
    (tmp_path / "times.txt").write_text("a b \t 1\n\n \t\nc\t2\r\n")
    assert read_times(tmp_path / "times.txt") == {"a b": 1, "c": 2}


def test_the_file_of_times_is_found_in_any_case(tmp_path):
    write_recording(tmp_path, ("a", "b"))
    (tmp_path / "Times.TXT").write_text("a 5\nb 7.5\n")
    assert [sample.timestamp_s for sample in open_dataset(tmp_path)] == [0.0, 2.5]


def test_files_that_belong_to_no_frame_are_told_by_check_and_on_opening(tmp_path, recwarn):
    write_recording(tmp_path, ("1", "2"))
    labels = PACKAGED_FRAMES / "training" / "label_2" / "000000.txt"
    for name, source in (("labels", labels), ("calibration", tmp_path / "calibration.yaml")):
        (tmp_path / name).mkdir(exist_ok=True)
        for frame in ("1", "2", "frame_2"):
            shutil.copy(source, tmp_path / name / f"{frame}{source.suffix}")
    (tmp_path / "labels" / "classes.txt").write_text("Car\n")
    problems = [each for each in check_tree(tmp_path) if "frame" in each.problem]
    assert [f"{each.path.name} {each.problem.partition(';')[0]}" for each in problems] == [
        "calibration.yaml is not read: every frame has its own file in calibration",
        "labels has 1 of 4 files that belong to no frame (frame_2)",
        "calibration has 1 of 3 files that belong to no frame (frame_2)",
    ]
    open_dataset(tmp_path)
    warned = "\n".join(str(warning.message) for warning in recwarn)
    assert all(str(problem) in warned for problem in problems)


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ((0, 0.1, 0.2, 0.3), None),
        ((0, 0.1, 0.2, 1.5), None),
        ((0, 10, 20, 30), None),
        ((0, 0.1, 30.1, 30.2), "has a gap of 30 s between b and c; other frames are 0.1 s apart"),
        ((0, 40, 40.1, 80), "so its times are probably in milliseconds"),
        ((0, 100_000, 200_000, 300_000), "100000 s apart, so its times are .* in microseconds"),
        ((0, 1e8, 2e8, 3e8), "so its times are probably in nanoseconds"),
    ],
)
def test_gaps_and_other_units_of_times_are_told(tmp_path, times, said):
    write_recording(tmp_path, "abcd")
    lines = [f"{name} {time}" for name, time in zip("abcd", times, strict=True)]
    (tmp_path / "times.txt").write_text("\n".join(lines))
    problems = [str(each) for each in check_tree(tmp_path) if each.path.name == "times.txt"]
    assert len(problems) == (said is not None)
    if said is not None:
        assert re.search(said, problems[0])


@pytest.mark.parametrize(
    ("before", "after", "begins"),
    [
        ("scene-0001-039", "scene-0002-000", True),
        ("a_12", "b_1", True),
        ("a_12", "b_13", False),
        ("scene-0001-038", "scene-0001-039", False),
        ("a", "b", False),
        ("000001", "000000", False),
    ],
)
def test_sequences_begin_with_another_text_and_the_first_number(before, after, begins):
    assert begins_sequence(before, after) == begins


def test_within_a_sequence_gaps_and_times_that_fall_are_still_told(tmp_path):
    names = ("a_0", "a_1", "a_2", "b_0", "b_1", "b_2")
    write_recording(tmp_path, names)
    for times, said in (
        ((50, 50.1, 50.2, 0, 0.1, 30), "gap of 29.9 s between b_1 and b_2"),
        ((50, 50.1, 50.2, 0, 0.1, 0.1), "do not rise from frame to frame: 1 of 6, 1 of them equal"),
        ((50, 50.1, 50.2, 0, 0.1, 0.2), None),
    ):
        lines = [f"{name} {time}" for name, time in zip(names, times, strict=True)]
        (tmp_path / "times.txt").write_text("\n".join(lines))
        problems = [str(each) for each in check_tree(tmp_path) if each.path.name == "times.txt"]
        assert (said is None and not problems) or said in problems[0]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("calib.yaml", r"calib.yaml: is not read: .*; rename it to calibration.yaml"),
        ("calibration_old.json", r"calibration_old.json: is not read"),
        ("times.csv", r"times.csv: is not read: .*; convert it to times.txt"),
        ("timestamps.txt", r"timestamps.txt: is not read: .*; rename it to times.txt"),
    ],
)
def test_calibrations_and_times_of_another_name_are_told(tmp_path, name, said):
    write_recording(tmp_path, ("a", "b"))
    (tmp_path / name).write_text("a 1\nb 2\n")
    with pytest.warns(UserWarning, match=said):
        open_dataset(tmp_path)
    (problem,) = check_tree(tmp_path)
    assert re.search(said, str(problem))


def test_a_recording_whose_only_calibration_has_another_name_is_told_to_rename_it(tmp_path):
    write_recording(tmp_path, ("a",))
    (tmp_path / "calibration.yaml").rename(tmp_path / "calib.yaml")
    with pytest.raises(ValueError, match=r"calib.yaml.* is not read: .*rename it to calibration"):
        open_dataset(tmp_path)


def test_two_files_of_times_are_told_by_check_and_on_opening(tmp_path):
    write_recording(tmp_path, ("a",))
    for name, time in (("times.txt", 0), ("Times.TXT", 9)):
        (tmp_path / name).write_text(f"a {time}\n")
    if (tmp_path / "times.txt").read_text() == "a 9\n":
        pytest.skip("this disk knows no case")
    with pytest.warns(UserWarning, match=r"Times.TXT: is not read: times.txt has the same name"):
        open_dataset(tmp_path)
    (problem,) = check_tree(tmp_path)
    assert problem.path.name == "Times.TXT"


def test_hidden_files_of_a_sensor_are_counted(tmp_path):
    write_recording(tmp_path, ("a", "b"), cloud=".npy")
    for name in (".c.npy", ".d.npy", "._a.npy", ".DS_Store"):
        (tmp_path / "points" / name).write_bytes(b"")
    with pytest.warns(UserWarning, match=r"2 hidden files that are not read, such as .c.npy"):
        open_dataset(tmp_path)
    (problem,) = check_tree(tmp_path)
    assert problem.path == tmp_path / "points"


@pytest.mark.parametrize("name", [" a", "a ", "a\\b", "a\nb"])
def test_check_and_opening_refuse_the_names_that_lists_of_frames_refuse(tmp_path, name):
    write_recording(tmp_path, (name, "c"))
    with pytest.raises(FileError, match="has 1 frames with names that are no plain file names"):
        open_dataset(tmp_path)
    assert "no plain file names" in str(next(check_tree(tmp_path)))
    with pytest.raises(FileError, match="expected a relative path of plain names"):
        read_sample_list([name], tmp_path)


def test_numbers_without_leading_zeros_are_told_by_check_and_on_opening(tmp_path):
    write_recording(tmp_path, tuple(f"f{number}" for number in (8, 9, 10)))
    with pytest.warns(UserWarning, match="of their names as text: f8 follows f10; write") as told:
        assert open_dataset(tmp_path).sample_ids == ("f10", "f8", "f9")
    assert len(told) == 1
    assert [str(each) for each in check_tree(tmp_path)] == [str(told[0].message)]


@pytest.mark.parametrize(
    "names",
    [
        *(("8", "9"), ("08", "09", "10"), ("a1", "b02"), ("x", "y"), ("cam0_7", "cam0_8")),
        *(("1700000000.1", "1700000000.15"), ("1700000000.09", "1700000000.1")),
    ],
)
def test_names_whose_order_as_text_is_that_of_their_numbers_are_sound(names):
    frames = [ObjectFrame(sample_id=name) for name in names]
    assert order_doubt(Path("drive"), frames) is None


@pytest.mark.parametrize(
    "names",
    [("17_100000000", "17_9000000"), ("10.5", "9.5"), ("d1_10", "d1_2"), ("a10_b1", "a9_b2")],
)
def test_names_whose_numbers_are_in_another_order_are_doubted(names):
    frames = [ObjectFrame(sample_id=name) for name in names]
    assert f"{names[1]} follows {names[0]}" in str(order_doubt(Path("drive"), frames))


@pytest.mark.parametrize("place", ["calib", "calibration"])
def test_the_calibration_of_all_frames_in_a_folder_of_its_own_is_told(tmp_path, place):
    folder = write_recording(tmp_path / "drive", ("a", "b"))
    (folder / place).mkdir()
    lost = (folder / "calibration.yaml").rename(folder / place / "calibration.yaml")
    remedy = f"{lost}: is not read .*; move it one folder up, into {folder}$"
    assert any(re.match(remedy, str(problem)) for problem in check_tree(folder))
    with pytest.raises((FileError, UserWarning), match=remedy):
        open_dataset(folder)
    lost.rename(folder / "calibration.yaml")
    lost.parent.rmdir()
    assert not list(check_tree(folder))


def test_times_closer_than_any_lidar_turns_are_told():
    def doubt(step: str):
        return doubtful_steps([(str(place), place * Decimal(step)) for place in range(4)])

    assert "0.00167 s apart, so its times are probably not in seconds" in doubt("0.001666667")[0]
    assert doubt("0.01") is None


def test_a_recording_of_a_lidar_alone_has_a_note_in_place_of_a_problem(tmp_path):
    write_recording(tmp_path, ("a", "b"))
    height, width = SAMPLE.image_size
    for path in sorted((tmp_path / "images").iterdir()):
        path.unlink()
        problems = [str(each) for each in check_tree(tmp_path)]
        assert any("images: " in each and "add the missing files" in each for each in problems)
    write_calibration(tmp_path, image_size={"width": width, "height": height})
    assert list(check_tree(tmp_path)) == []
    (summary,) = summarize_tree(tmp_path)
    assert "; no images: the image_size of the calibration is used; " in str(summary)
    write_rgb(tmp_path / "images" / "a.png", IMAGE)
    (problem,) = check_tree(tmp_path)
    assert problem.problem == "lacks a file of b"


def test_a_guessed_image_size_is_told(tmp_path):
    write_recording(tmp_path, ("a", "b"))
    shutil.rmtree(tmp_path / "images")
    (problem,) = check_tree(tmp_path)
    assert problem.path == tmp_path / "calibration.yaml"
    assert "has no image_size, and there are no images" in problem.problem
    with pytest.warns(UserWarning, match="no image_size, and there are no images") as warned:
        height, width = open_dataset(tmp_path)[0].image_size
    assert len(warned) == 1
    assert f"{height}x{width} (height x width) is guessed" in str(warned[0].message)


@pytest.mark.parametrize("folders", [("images", "points"), ("points",)])
def test_an_empty_recording_is_told_as_such(tmp_path, folders):
    write_recording(tmp_path, ("a",))
    for folder in ("images", "points"):
        shutil.rmtree(tmp_path / folder)
    for folder in folders:
        (tmp_path / folder).mkdir()
    expected = f"has no frames: there are no files in {'/ and '.join(folders)}/"
    (problem,) = check_tree(tmp_path)
    assert problem.problem == expected
    with pytest.raises(ValueError, match=expected):
        open_dataset(tmp_path)
