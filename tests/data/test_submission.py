"""The archive for KITTI's object benchmark."""

import os
import re
import subprocess
import sys
from zipfile import ZipFile

import pytest

from sightline.cli.main import main
from sightline.data.submission import write_submission

CAR = "Car -1 -1 -1.57 600.0 170.0 650.0 210.0 1.5 1.6 3.9 1.0 1.6 20.0 -1.52 0.93\n"


@pytest.fixture
def results(tmp_path):
    folder = tmp_path / "results"
    folder.mkdir()
    for name, content in (
        ("000007", CAR),
        ("000002", ""),
        ("000010", CAR + CAR.replace("Car", "Van")),
    ):
        (folder / f"{name}.txt").write_text(content)
    return folder


def test_each_frame_is_in_the_archive_as_it_is_in_order_and_empty_where_nothing_was_found(results):
    out = results.parent / "submission.zip"
    assert write_submission(results, out) == 3
    with ZipFile(out) as archive:
        assert archive.namelist() == ["000002.txt", "000007.txt", "000010.txt"]
        assert archive.testzip() is None
        for name in archive.namelist():
            assert archive.read(name) == (results / name).read_bytes()


@pytest.mark.parametrize("content", [CAR, CAR + "\N{BYTE ORDER MARK}" + CAR.replace("Car", "Van")])
def test_byte_order_marks_are_left_out_as_the_benchmark_reads_them_as_part_of_the_class(
    results, content
):
    (results / "000007.txt").write_text(content, encoding="utf-8-sig")
    write_submission(results, results.parent / "submission.zip")
    with ZipFile(results.parent / "submission.zip") as archive:
        packed = archive.read("000007.txt").decode()
    assert packed == content.replace("\N{BYTE ORDER MARK}", "")


def test_the_same_results_give_the_same_bytes_whenever_and_in_whatever_order_they_were_written(
    results,
):
    first, second = results.parent / "a.zip", results.parent / "b.zip"
    write_submission(results, first)
    moved = results.parent / "moved"
    moved.mkdir()
    for path in sorted(results.iterdir(), reverse=True):
        (moved / path.name).write_bytes(path.read_bytes())
        os.utime(moved / path.name, (1e9, 1e9))
        (moved / path.name).chmod(0o600)
    write_submission(moved, second)
    assert first.read_bytes() == second.read_bytes()


def test_a_list_names_the_frames_and_each_must_be_there(results):
    wanted = results.parent / "ImageSets"
    wanted.mkdir()
    (wanted / "mine.txt").write_text("000007\n000002\n")
    out = results.parent / "submission.zip"
    assert write_submission(results, out, sample_list="mine") == 2
    with ZipFile(out) as archive:
        assert archive.namelist() == ["000002.txt", "000007.txt"]
    (wanted / "mine.txt").write_text("000007\n000003\n000004\n")
    with pytest.raises(ValueError, match=r"no result file for 2 of 3 frames, .*000003\.txt: write"):
        write_submission(results, out, sample_list="mine")


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (CAR.replace(" 0.93", ""), "line 1 has 15 fields, but a result has 16; add score"),
        (CAR + CAR.replace("20.0", "far"), "line 2: z is 'far', not a number"),
        (CAR.replace("0.93", "nan"), "line 1: score is 'nan', not finite"),
        (
            CAR + CAR.replace("650.0", "550.0"),
            "object 2 has the box 600 170 550 210, whose maximum",
        ),
        (CAR.replace("Car", "Banana"), "object 1 is of class 'Banana', which is no class of KITTI"),
    ],
)
def test_a_file_at_fault_is_named_with_its_line_and_nothing_is_written(results, content, fault):
    out = results.parent / "submission.zip"
    out.write_bytes(b"an older one")
    (results / "000008.txt").write_text(content)
    with pytest.raises(ValueError, match=rf"000008\.txt: {re.escape(fault)}"):
        write_submission(results, out)
    assert out.read_bytes() == b"an older one"
    assert sorted(path.name for path in results.parent.iterdir()) == ["results", "submission.zip"]


def test_what_is_no_submission_is_refused_in_one_line(results):
    out = results.parent / "submission.zip"
    with pytest.raises(ValueError, match=r"submission\.tar does not end in \.zip"):
        write_submission(results, out.with_suffix(".tar"))
    with pytest.raises(ValueError, match="is no folder; give the folder of the result files"):
        write_submission(results / "nowhere", out)
    (results / "summary.txt").write_text("")
    with pytest.raises(ValueError, match=r"summary\.txt: is not named by six digits"):
        write_submission(results, out)
    (results.parent / "empty").mkdir()
    with pytest.raises(ValueError, match=r"empty has no result files \(\*\.txt\)"):
        write_submission(results.parent / "empty", out)


def test_files_and_folders_that_are_left_out_are_counted(results):
    out = results.parent / "submission.zip"
    (results / "sightline.json").write_text("{}")
    (results / "._000001.txt").write_bytes(b"\0")
    assert write_submission(results, out) == 3
    (results / "notes.md").write_text("not a result")
    for number in (11, 12):
        (results / f"{number:06}.TXT").write_text(CAR)
    (results / "data").mkdir()
    (results / "data" / "000013.txt").write_text(CAR)
    with pytest.warns(UserWarning, match="left out of the archive") as told:
        assert write_submission(results, out) == 3
    said = str(told[0].message)
    assert "2 .TXT files (the first is 000011.TXT), 1 .md file (the first is notes.md), " in said
    assert "1 folder (the first is data) with 1 .txt files; " in said
    for path in results.glob("*.txt"):
        path.unlink()
    with pytest.raises(ValueError, match=r"no result files \(\*\.txt\) but 2 \.TXT files .*folder"):
        write_submission(results, out)


@pytest.mark.parametrize(
    ("content", "found"), [("", ""), (CAR.replace("Car", "Van"), ", only van")]
)
def test_results_without_any_detection_of_a_scored_class_are_refused(results, content, found):
    for path in results.iterdir():
        path.write_text(content)
    with pytest.raises(ValueError, match=f"in any of its 3 result files{found}: check whether"):
        write_submission(results, results.parent / "submission.zip")


def test_the_command_says_what_it_packed(results, capsys):
    out = results.parent / "submission.zip"
    assert main(["submission", str(results), str(out)]) == 0
    assert capsys.readouterr().out == f"{out}: 3 frames\n"
    (results / "000002.txt").write_text("Car\n")
    assert main(["submission", str(results), str(out)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_packing_needs_no_pytorch():
    script = "import sys, sightline.data.submission; print('torch' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout == "False\n"


def test_results_of_a_whole_sequence_are_told_as_such(results):
    (results / "0003.txt").write_text(f"0 4 {CAR}")
    with pytest.raises(
        ValueError, match=r"0003\.txt: line 1 has 18 fields: frame and track number"
    ):
        write_submission(results, results.parent / "submission.zip")
