"""Judgement of the calibration of every frame, in the layouts with one for each."""

import shutil
from collections import Counter

import yaml

from sightline.data.open import open_dataset
from tests.data.recordings import CAMERA_MATRIX, calibration_entries, write_recording
from tests.data.trees import write_object_tree, write_selection

IDS = tuple(f"{number:06d}" for number in range(5))


def doubled(text):
    """Text of a calibration for images of twice the size."""
    lines = []
    for line in text.splitlines():
        name, colon, words = line.rpartition(":")
        if name in ("P2", ""):
            values = [float(word) for word in words.split()]
            words = " ".join(str(2 * each) for each in values[: -len(values) // 3])
            words += " 0 0 1 0"[: 2 * len(values) // 3]
        lines.append(f"{name}{colon} {words}")
    return "\n".join(lines)


def warned_by_frame(dataset, recwarn):
    """Kinds of warnings of reading each frame twice, with their number."""
    recwarn.clear()
    for index in [*range(len(dataset)), *range(len(dataset))]:
        dataset[index]
    return Counter(str(each.message).partition(" for another resolution")[0] for each in recwarn)


def test_a_camera_matrix_of_another_resolution_in_one_middle_frame_of_a_tree(tmp_path, recwarn):
    root = write_object_tree(tmp_path, *IDS)
    path = root / "training" / "calib" / "000001.txt"
    dataset = open_dataset(root)
    assert not warned_by_frame(dataset, recwarn)
    path.write_text(doubled(path.read_text()))
    warned = warned_by_frame(open_dataset(root), recwarn)
    assert list(warned.values()) == [1]
    assert str(path) in next(iter(warned))


def test_a_camera_matrix_of_another_resolution_in_one_frame_of_the_depth_benchmark(
    tmp_path, recwarn
):
    names = [write_selection(tmp_path, f"{number:010d}", number) for number in range(5)]
    root = tmp_path / "depth_selection" / "val_selection_cropped"
    path = root / "intrinsics" / f"{names[1]}.txt"
    path.write_text(doubled(path.read_text()))
    warned = warned_by_frame(open_dataset(root), recwarn)
    assert list(warned.values()) == [1]
    assert str(path) in next(iter(warned))


def test_a_camera_matrix_of_another_resolution_in_one_frame_of_a_recording(tmp_path, recwarn):
    write_recording(tmp_path, ("a", "b", "c"))
    (tmp_path / "calibration").mkdir()
    for name in "abc":
        shutil.copy(tmp_path / "calibration.yaml", tmp_path / "calibration" / f"{name}.yaml")
    (tmp_path / "calibration.yaml").unlink()
    assert not warned_by_frame(open_dataset(tmp_path), recwarn)
    matrix = (2 * CAMERA_MATRIX).tolist()
    own = calibration_entries(camera_matrix=[*matrix[:2], [0, 0, 1]])
    (tmp_path / "calibration" / "b.yaml").write_text(yaml.safe_dump(own))
    warned = warned_by_frame(open_dataset(tmp_path), recwarn)
    assert list(warned.values()) == [1]
    assert "calibration/b.yaml: camera_matrix has its principal point" in next(iter(warned))


def test_what_is_said_of_the_first_frame_is_not_said_again(tmp_path, recwarn):
    root = write_object_tree(tmp_path, *IDS)
    for path in (root / "training" / "calib").iterdir():
        path.write_text(doubled(path.read_text()))
    dataset = open_dataset(root)
    assert sum("for another resolution" in str(each.message) for each in recwarn) == 1
    assert not warned_by_frame(dataset, recwarn)
