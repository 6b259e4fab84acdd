"""Judgement of the calibration of every frame, in the layouts with one for each."""

import shutil
from collections import Counter

import numpy as np
import yaml
from PIL import Image

from sightline.data.check import check_tree
from sightline.data.open import open_dataset
from tests.data.recordings import CAMERA_MATRIX, calibration_entries, write_recording
from tests.data.trees import write_object_tree, write_selection
from tests.geometry.cameras import IMAGE_FROM_CAMERA

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


def test_images_cropped_without_kittis_camera_matrix_are_told_of_each_frame(tmp_path, recwarn):
    root = write_object_tree(tmp_path, *IDS)
    for name in IDS:
        write_kitti_picture(root / "training", name, (352, 1216))
    dataset = open_dataset(root)
    told = [each for each in check_tree(root) if "KITTI's images of 375x1242" in each.problem]
    assert len(told) == len(IDS)
    assert "352x1216" in told[0].problem
    assert "subtract the crop's offset" in told[0].remedy
    assert sum("(3 like it in 3 checked frames)" in str(each.message) for each in recwarn) == 1
    assert not warned_by_frame(dataset, recwarn)


def test_one_cropped_image_in_a_middle_frame_is_told_when_it_is_read(tmp_path, recwarn):
    root = write_object_tree(tmp_path, *IDS)
    for name in IDS:
        write_kitti_picture(root / "training", name, (375, 1242))
    write_kitti_picture(root / "training", IDS[1], (352, 1216))
    dataset = open_dataset(root)
    (told,) = warned_by_frame(dataset, recwarn)
    assert "KITTI's images of 375x1242" in told
    assert IDS[1] in told


def test_images_of_the_depth_benchmark_that_are_not_of_its_intrinsics_are_told(tmp_path):
    name = write_selection(tmp_path, "0000000005", 0)
    root = tmp_path / "depth_selection" / "val_selection_cropped"
    for folder in ("image", "velodyne_raw", "groundtruth_depth"):
        for path in (root / folder).iterdir():
            picture = Image.open(path)
            picture.resize((1216, 352), Image.Resampling.NEAREST).save(path)
    camera = " ".join(map(str, np.ravel(IMAGE_FROM_CAMERA)[[0, 1, 2, 4, 5, 6, 8, 9, 10]]))
    (root / "intrinsics" / f"{name}.txt").write_text(camera)
    problems = [each.problem for each in check_tree(root)]
    assert sum("KITTI's images of 375x1242" in each for each in problems) == 1


def write_kitti_picture(folder, name, size):
    """Replace a frame's image and its P2 by KITTI's."""
    noise = np.random.default_rng(int(name)).integers(0, 256, (*size, 3), dtype=np.uint8)
    Image.fromarray(noise).save(folder / "image_2" / f"{name}.png")
    path = folder / "calib" / f"{name}.txt"
    matrix = " ".join(map(str, np.ravel(IMAGE_FROM_CAMERA)))
    lines = [
        f"P2: {matrix}" if line.startswith("P2:") else line
        for line in path.read_text().splitlines()
    ]
    path.write_text("\n".join(lines))
