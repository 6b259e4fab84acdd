"""Frames of one tree against each other: equal files, no point anywhere, sizes of one camera."""

import math
import shutil
import warnings

import numpy as np
import pytest

from sightline.data.check import check_tree
from sightline.data.checks import between_frames
from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.map_png import read_depth_png, write_depth_png
from sightline.data.layouts.kitti_trees import CORRUPTED, DepthFrame
from sightline.data.open import open_dataset
from tests.data.formats.test_image_file import with_exif
from tests.data.recordings import write_recording
from tests.data.trees import picture, write_drive, write_object_tree, write_selection

NAMES = ("000001", "000002", "000003")


@pytest.fixture
def tree(tmp_path):
    return write_object_tree(tmp_path, *NAMES) / "training"


def problems(root):
    return [(each.path, each.problem) for each in check_tree(root)]


def told_on_opening(root):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        open_dataset(root)
    return [str(each.message) for each in caught]


@pytest.mark.parametrize(
    ("folder", "suffix", "what"), [("image_2", ".png", "picture"), ("velodyne", ".bin", "cloud")]
)
def test_files_that_are_equal_between_frames_are_told_by_check_and_on_opening(
    tree, folder, suffix, what
):
    assert problems(tree.parent) == []
    for name in NAMES[1:]:
        shutil.copy(tree / folder / f"{NAMES[0]}{suffix}", tree / folder / f"{name}{suffix}")
    ((path, said),) = problems(tree.parent)
    assert path == tree / folder / f"{NAMES[0]}{suffix}"
    assert f"is the same {what}, byte for byte, as that of 2 other frames (000002, 000003)" in said
    (warned,) = told_on_opening(tree)
    assert said in warned


def test_point_clouds_without_points_are_told_as_such_not_as_equal(tmp_path):
    root = write_recording(tmp_path, ("a", "b", "c"), cloud=".npy")
    for name in ("b", "c"):
        np.save(root / "points" / f"{name}.npy", np.zeros((0, 4), np.float32))
    with pytest.warns(UserWarning, match=r"b\.npy: holds no point, like 1 more, of 3 point clouds"):
        assert problems(root) == []


@pytest.mark.parametrize("suffix", [".bin", ".npy"])
def test_clouds_of_a_recording_that_are_all_empty_are_told_with_their_number(tmp_path, suffix):
    root = write_recording(tmp_path, NAMES, cloud=suffix)
    for name in NAMES:
        empty = np.zeros((0, 4), np.float32)
        path = root / "points" / f"{name}{suffix}"
        np.save(path, empty) if suffix == ".npy" else path.write_bytes(b"")
    assert problems(root) == [(root / "points", "holds 3 clouds, all without a point")]
    (told,) = (each for each in told_on_opening(root) if "sightline check" in each)
    assert "all 3 sweeps are empty" in told


def test_sparse_maps_that_are_all_empty_are_told_with_their_number(tmp_path):
    for seed in range(2):
        write_selection(tmp_path, f"000000000{seed}", seed)
    first, last = sorted(tmp_path.rglob("velodyne_raw/*.png"))
    nothing = np.zeros_like(read_depth_png(first))
    write_depth_png(first, nothing)
    assert problems(tmp_path) == []
    write_depth_png(last, nothing)
    told = "holds 2 sparse depth maps, all without a depth"
    assert (first.parent, told) in problems(tmp_path)


def test_frames_of_a_length_that_differ_in_a_byte_are_no_repeats(tree):
    for place, name in enumerate(NAMES):
        cloud = np.random.default_rng(0).uniform(0, 1, (500, 4)).astype("<f4")
        cloud[:, 0] += 5
        cloud[0, 3] = place / 10
        cloud.tofile(tree / "velodyne" / f"{name}.bin")
    assert problems(tree.parent) == []


def test_many_repeats_are_told_in_a_few_lines(tmp_path):
    tree = write_object_tree(tmp_path, *(f"{number:06}" for number in range(18))) / "training"
    for number in range(0, 18, 2):
        shutil.copy(
            tree / "image_2" / f"{number:06}.png", tree / "image_2" / f"{number + 1:06}.png"
        )
    told = [each for each in problems(tmp_path) if "3D box" not in each[1]]
    assert len(told) == 6
    assert "is of one of 4 more groups of frames with the same picture" in told[-1][1]
    for name in ("000000", "000002", "000004"):
        (tree / "image_2" / f"{name}.png").unlink()
    told = [each for each in problems(tmp_path) if "picture" in each[1]]
    assert [each[1].startswith("is the same picture") for each in told] == [True] * 6


def test_sensors_that_delivered_nothing_and_corrupted_trees_have_no_repeats(tree):
    for name in NAMES:
        write_rgb(tree / "image_2" / f"{name}.png", np.zeros((12, 40, 3), np.uint8))
        (tree / "velodyne" / f"{name}.bin").write_bytes(b"")
    told = [each for each in problems(tree.parent) if "single colour" not in each[1]]
    assert told == [(tree / "velodyne", "holds 3 clouds, all without a point")]
    (tree / CORRUPTED).mkdir()
    assert problems(tree.parent) == []


def test_one_cloud_with_points_is_enough(tree):
    for name in NAMES[1:]:
        (tree / "velodyne" / f"{name}.bin").write_bytes(b"")
    with pytest.warns(UserWarning, match="000002.bin: holds no point, like 1 more, of 3 point"):
        assert problems(tree.parent) == []


def test_equal_pictures_are_told_in_drives_and_depth_trees(tmp_path):
    drive = write_drive(tmp_path / "drive", official=False)
    shutil.copy(drive / "image_02/0000000001.png", drive / "image_02/0000000002.png")
    for number in ("0000000005", "0000000006"):
        write_selection(tmp_path / "depth", number)
    for root, expected in (("drive", 1), ("depth", 2)):
        told = [said for _, said in problems(tmp_path / root)]
        assert len(told) == expected
        assert all("byte for byte" in said for said in told)


def test_equal_pictures_of_one_name_are_told_by_their_places(tmp_path):
    """Pictures of both cameras, or of several drives, have the same names."""
    frames = []
    for camera in ("image_02", "image_03"):
        image = tmp_path / camera / "data" / "0000000005.png"
        write_rgb(image, picture())
        parts = dict.fromkeys(("sparse", "truth", "intrinsics"))
        frames.append(DepthFrame(sample_id=camera, image=image, camera=camera, **parts))
    (problem,) = between_frames.check_repeats(frames)
    assert "as that of 1 other frame (image_03/data/0000000005.png)" in problem.problem


def test_equal_files_are_told_in_recordings_by_check_and_on_opening(tmp_path):
    root = write_recording(tmp_path, ("a", "b", "c"))
    assert problems(root) == []
    for path in ("images/{}.jpg", "points/{}.pcd"):
        shutil.copy(root / path.format("a"), root / path.format("b"))
    for told in ([said for _, said in problems(root)], told_on_opening(root)):
        assert ["is the same" in each for each in told] == [True, True]
        assert ("picture" in told[0], "cloud" in told[1]) == (True, True)


def test_a_shared_calibration_is_read_once_and_only_up_to_a_size(tmp_path, monkeypatch):
    root = write_recording(tmp_path, ("a", "b", "c"))
    shutil.copy(root / "points/a.pcd", root / "points/b.pcd")
    read = []
    original = between_frames._digest
    monkeypatch.setattr(between_frames, "_digest", lambda path: read.append(path) or original(path))
    assert len(problems(root)) == 1
    assert read.count(root / "calibration.yaml") == 1
    with (root / "calibration.yaml").open("ab") as file:
        file.truncate(2**35)  # sparse: reading it would take minutes
    assert original(root / "calibration.yaml") is None
    assert any("bytes long, expected up to" in said for _, said in problems(root))


def test_cameras_of_a_recording_may_share_a_cloud(tmp_path):
    root = write_recording(tmp_path, ("a", "b"))
    shutil.copy(root / "points/a.pcd", root / "points/b.pcd")
    said = (root / "calibration.yaml").read_text()
    (root / "calibration.yaml").unlink()
    (root / "calibration").mkdir()
    (root / "calibration/a.yaml").write_text(said)
    (root / "calibration/b.yaml").write_text(said)
    assert len(problems(root)) == 1
    (root / "calibration/b.yaml").write_text(f"# of another camera\n{said}")
    assert problems(root) == []


def test_equal_labels_are_told_where_they_have_a_box(tree):
    boxed = (tree / "label_2" / "000001.txt").read_text()
    apart, in_a_row = (NAMES[0], NAMES[2]), NAMES[:2]
    for names, labels, expected in (
        (apart, boxed, 1),
        (apart, "", 0),
        (apart, boxed.split("\n")[1] + "\n", 0),
        (in_a_row, boxed, 0),
    ):
        for place, name in enumerate(NAMES):
            other = boxed.replace(" 20.00 9.00", f" 20.0{place + 1} 9.00")
            path = tree / "label_2" / f"{name}.txt"
            path.write_text(labels if name in names else other)
        told = [said for _, said in problems(tree.parent)]
        assert sum("is the same label file, byte for byte" in said for said in told) == expected
        assert len(told) == expected


def test_an_image_of_another_size_than_others_of_its_calibration_is_told(tree):
    write_rgb(tree / "image_2" / "000002.png", picture(1, (12, 44)))
    shutil.rmtree(tree / "label_2")
    ((path, said),) = problems(tree.parent)
    assert path == tree / "image_2" / "000002.png"
    assert "is 12x44 (height x width), expected 12x40 like 2 images of the same calib" in said


def test_of_two_images_with_two_sizes_none_is_blamed(tree):
    for part in ("image_2", "velodyne", "calib"):
        for path in (tree / part).iterdir():
            if path.stem not in NAMES[:2]:
                path.unlink()
    shutil.rmtree(tree / "label_2")
    write_rgb(tree / "image_2" / f"{NAMES[1]}.png", picture(1, (12, 44)))
    ((path, said),) = problems(tree.parent)
    assert path == tree / "image_2"
    assert f"none is the most frequent: {NAMES[0]}.png of 12x40, {NAMES[1]}.png of 12x44" in said


def test_images_of_other_sizes_have_their_own_calibrations(tree):
    write_rgb(tree / "image_2" / "000002.png", picture(1, (12, 44)))
    calibration = tree / "calib" / "000002.txt"
    calibration.write_text(calibration.read_text().replace("1.9500000000000000e+01", "21.5"))
    assert problems(tree.parent) == []


def test_an_image_of_another_size_in_a_drive_is_told(tmp_path):
    drive = write_drive(tmp_path / "drive", official=False)
    write_rgb(drive / "image_02" / "0000000002.png", picture(2, (14, 40)))
    ((path, said),) = problems(drive)
    assert path.name == "0000000002.png"
    assert "is 14x40 (height x width), expected 12x40 like 2 images" in said


def test_pictures_that_viewers_turn_are_told_once_by_check_and_on_opening(tmp_path):
    folder = write_recording(tmp_path / "drive", names=NAMES)
    assert problems(folder) == []
    for name in NAMES[1:]:
        path = folder / "images" / f"{name}.jpg"
        path.write_bytes(with_exif(path.read_bytes(), "<", 3))
    ((path, said),) = problems(folder)
    assert path == folder / "images" / "000002.jpg"
    assert said.startswith("has EXIF orientation 3, like 1 more, of 3 pictures: pixels are used as")
    (warned,) = told_on_opening(folder)
    assert said in warned


def test_label_files_that_are_all_empty_are_told(tree):
    labels = sorted((tree / "label_2").iterdir())
    for path in labels[1:]:
        path.write_text("")
    assert problems(tree.parent) == []
    labels[0].write_text("\n")
    assert problems(tree.parent) == [
        (tree / "label_2", "holds 3 label files, all without an object")
    ]


@pytest.mark.parametrize("hidden", ["0.00 3", "2.00 0", "87 1"])
def test_labels_of_which_none_counts_are_told(tree, hidden):
    def is_told():
        said = "objects, all with an occlusion above 2 (3 is unknown) or a truncation above 0.5"
        return any(said in problem for _, problem in problems(tree.parent))

    for number, path in enumerate(sorted((tree / "label_2").iterdir())):
        assert not is_told()
        box = f"{100 + number} 120 200 180 1.50 1.60 3.90 0.50 1.60"
        path.write_text("".join(f"Car {hidden} -1.57 {box} {z}.00 -1.53\n" for z in (12, 24)))
    assert is_told()


@pytest.mark.parametrize(
    ("alpha", "rotation_y", "said"),
    [
        (lambda *_: 0.0, 0.6, "alpha of all 9 labels is 0;"),
        (lambda *_: -10.0, 0.6, "alpha of all 9 labels is -10, KITTI's number for"),
        (
            lambda rotation, bearing: bearing - rotation,
            0.6,
            "alpha of 9 of 9 labels is probably ne",
        ),
        (
            lambda rotation, bearing: rotation - bearing + 3.14,
            -2.5,
            "probably half a turn off, or r",
        ),
        (lambda rotation, bearing: rotation - bearing, 0.6, None),
        (lambda rotation, bearing: -10.0 if bearing > 0.2 else rotation - bearing, 0.6, None),
    ],
)
def test_alphas_that_contradict_the_3d_boxes_are_told_once_for_all_labels(
    tree, alpha, rotation_y, said
):
    for number, path in enumerate(sorted((tree / "label_2").iterdir())):
        lines = []
        for x, z in ((-3, 12 + number), (0.5, 18), (4, 14)):
            angle = alpha(rotation_y, math.atan2(x, z))
            sizes = "100 120 200 180 1.50 1.60 3.90"
            lines.append(f"Car 0 0 {angle:.2f} {sizes} {x} 1.60 {z} {rotation_y}\n")
        path.write_text("".join(lines))
    told = [each for each in check_tree(tree.parent) if "orientation" in each.problem]
    assert [each.path for each in told] == ([tree / "label_2"] if said else [])
    assert all(said in f"{each.problem}; {each.remedy}" for each in told)
    assert not any("an angle outside" in problem for _, problem in problems(tree.parent))


def test_label_files_that_hold_nothing_but_dont_care_are_told(tree):
    labels = sorted((tree / "label_2").iterdir())
    region = "DontCare -1 -1 -10 1 2 8 9 -1 -1 -1 -1000 -1000 -1000 -10\n"
    for path in labels[1:]:
        path.write_text(region)
    assert problems(tree.parent) == []
    labels[0].write_text("")
    assert problems(tree.parent) == [
        (tree / "label_2", "holds 3 label files, all without an object but DontCare")
    ]
