from pathlib import Path

import pytest

from sightline.data.formats.kitti_calibration import read_object_matrices
from sightline.data.layouts.drive_poses import read_poses
from sightline.data.layouts.drive_times import read_timestamps
from sightline.data.layouts.frame_lists import read_sample_list
from sightline.data.layouts.recording_files import read_times
from sightline.files.plain_text import MAX_CALIBRATION_BYTES, read_text
from sightline.files.problem import FileError
from tests.data.trees import write_object_tree

_POSE = "1 0 0 5 0 1 0 6 0 0 1 7"


def text_of(path: Path, content: str, end: str) -> Path:
    path.write_bytes(b"\xef\xbb\xbf" + content.replace("\n", end).encode())
    return path


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_each_text_format_is_read_with_a_mark_and_with_any_ends_of_lines(tmp_path, end):
    poses = read_poses(text_of(tmp_path / "poses.txt", f"{_POSE}\n{_POSE}\n", end))
    assert poses[:, :3, 3].tolist() == [[5, 6, 7]] * 2
    times = text_of(tmp_path / "times.txt", "a 0.5\nb 1\n", end)
    assert read_times(times) == {"a": 0.5, "b": 1.0}
    dates = "2011-09-26 13:02:25.5\n2011-09-26 13:02:26.5\n"
    assert read_timestamps(text_of(tmp_path / "dates.txt", dates, end)).tolist() == [0, 1]
    frames = text_of(tmp_path / "frames.txt", "000001\n000002\n", end)
    assert read_sample_list(frames, tmp_path) == ("000001", "000002")
    write_object_tree(tmp_path, "000001")
    path = tmp_path / "training" / "calib" / "000001.txt"
    expected = read_object_matrices(path)
    found = read_object_matrices(text_of(path, path.read_text(), end))
    assert (found.image_from_camera == expected.image_from_camera).all()


@pytest.mark.parametrize(
    ("encoding", "said"),
    [
        ("utf-16", "is text in UTF-16"),
        ("utf-32", "is text in UTF-32"),
        ("utf-32-be", "or text in UTF-16 or UTF-32"),
        ("utf-16-le", "or text in UTF-16 or UTF-32"),
    ],
)
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_text_in_utf_16_or_32_is_called_so(tmp_path, encoding, said, mark):
    path = tmp_path / "calib.txt"
    path.write_bytes(f"{mark}P2: 1".encode(encoding))
    said = f"is text in {encoding[:6].upper()}" if mark else said
    with pytest.raises(FileError, match=f"{said}, expected UTF-8; save it as plain") as caught:
        read_text(path)
    assert caught.value.problem.path == path


def test_a_calibration_of_megabytes_is_refused_unread(tmp_path):
    path = tmp_path / "calib.txt"
    path.write_bytes(b"P2: " + b"1 " * MAX_CALIBRATION_BYTES)
    with pytest.raises(FileError, match=f"bytes long, expected up to {MAX_CALIBRATION_BYTES}"):
        read_object_matrices(path)


def test_the_remedy_for_an_absent_file_does_not_tell_to_correct_it(tmp_path):
    with pytest.raises(FileError, match="name a file that exists or extract the file again"):
        read_text(tmp_path / "absent.txt")
