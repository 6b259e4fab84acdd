import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from sightline.data.check import check_tree, summarize_tree
from sightline.data.checks import tree_checks
from sightline.data.checks.frame_checks import Findings
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.kitti_files import write_points
from sightline.data.formats.map_png import MAX_DEPTH_M, write_depth_png
from sightline.data.open import open_dataset
from sightline.files.problem import FileError, Problem
from tests.data.recordings import POINTS, write_cloud_file, write_recording
from tests.data.trees import (
    LABELS,
    depth_map,
    picture,
    points,
    write_depth_drive,
    write_drive,
    write_object_frame,
    write_object_tree,
    write_selection,
)


def lines(root: Path) -> list[str]:
    return [str(problem) for problem in check_tree(root, num_workers=1)]


def rewrite(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def write_sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**40)


@pytest.fixture
def tree(tmp_path):
    return write_object_tree(tmp_path, "000001", "000002", "000003") / "training"


def test_whole_trees_have_no_problems(tmp_path):
    write_object_tree(tmp_path / "object", "000001", "000002")
    write_object_frame(tmp_path / "object", "000001", split="testing")
    write_selection(tmp_path / "depth")
    write_depth_drive(tmp_path / "depth", tmp_path / "depth")
    write_drive(tmp_path / "day" / "drive")
    write_drive(tmp_path / "flat", official=False)
    for root in ("object", "object/training", "depth", "day/drive", "flat"):
        assert lines(tmp_path / root) == []


def test_the_summary_counts_frames_and_parts_of_each_tree(tmp_path):
    write_object_tree(tmp_path, "000001", "000002")
    (tmp_path / "training" / "velodyne" / "000001.bin").unlink()
    write_selection(tmp_path)
    training, selection = summarize_tree(tmp_path)
    assert (training.num_frames, selection.num_frames) == (2, 1)
    assert str(training) == (
        f"{tmp_path / 'training'}: 2 object frames (image_2 2, velodyne 1, calib 2, label_2 2)"
    )
    assert {part.name: part.num_files for part in selection.parts} == {
        "image": 1,
        "velodyne_raw": 1,
        "intrinsics": 1,
        "groundtruth_depth": 1,
    }
    write_drive(tmp_path / "day" / "drive")
    (drive,) = summarize_tree(tmp_path / "day" / "drive")
    assert str(drive).endswith("drive: 3 raw frames (image_02 3, velodyne_points 3)")


@pytest.mark.parametrize("content", ["nothing", "empty folders"])
def test_a_folder_without_frames_is_one_problem(tmp_path, content):
    expected = "is no data set, expected a recording"
    remedy = "give the folder of such a data set, or make yours a recording"
    if content == "empty folders":
        for folder in ("image_2", "velodyne", "calib", "label_2"):
            (tmp_path / "training" / folder).mkdir(parents=True)
        expected = "has no frames: there are no files in training/image_2/ and training/velodyne/"
        remedy = "copy or link the files of KITTI's object tree there"
    (line,) = lines(tmp_path)
    assert line.startswith(f"{tmp_path}: {expected}")
    assert remedy in line
    assert summarize_tree(tmp_path) == ()


def test_a_path_that_is_no_folder_is_one_problem(tmp_path):
    (line,) = lines(tmp_path / "nowhere")
    assert line.startswith(f"{tmp_path / 'nowhere'}: does not exist; give the folder")


def test_no_threads_are_too_few(tmp_path):
    with pytest.raises(ValueError, match="workers must be at least 1, got 0"):
        list(check_tree(tmp_path, num_workers=0))


def test_an_empty_folder_among_full_ones_is_one_problem_however_many_frames(tree):
    for path in (tree / "velodyne").iterdir():
        path.unlink()
    (line,) = lines(tree.parent)
    assert line.startswith(f"{tree / 'velodyne'}: holds no files of the frames; extract")


@pytest.mark.parametrize("part", ["image_2", "velodyne", "label_2"])
def test_a_part_that_a_tree_does_without_is_no_problem_and_counted_as_none(tree, part):
    shutil.rmtree(tree / part)
    assert lines(tree.parent) == []
    (summary,) = summarize_tree(tree.parent)
    assert f"{part} 0" in str(summary)


@pytest.mark.parametrize("part", ["image_02", "velodyne"])
def test_a_drive_of_one_sensor_is_no_problem(tmp_path, part):
    drive = write_drive(tmp_path / "drive", official=False)
    shutil.rmtree(drive / part)
    assert lines(drive) == []


@pytest.mark.parametrize(
    "file",
    ["image_2/000002.png", "velodyne/000002.bin", "calib/000002.txt", "label_2/000002.txt"],
)
def test_a_missing_file_is_named(tree, file):
    (tree / file).unlink()
    (line,) = lines(tree.parent)
    assert line.startswith(f"{tree / file}: is missing; extract the archive again")
    is_label = file.startswith("label_2")
    assert ("or write an empty label file for each frame without objects" in line) == is_label


@pytest.mark.parametrize("part", ["label_2", "velodyne", "image_2"])
def test_files_of_the_same_frames_by_another_number_are_told_once_to_be_renamed(tree, part):
    for path in (tree / part).iterdir():
        path.rename(path.with_name(f"{int(path.stem)}{path.suffix}"))
    (problem,) = check_tree(tree.parent)
    assert problem.path == tree
    assert problem.problem.startswith(f"names 3 frames in two ways, such as 1 in {part} and 000001")
    assert "rename 1 as 000001" in problem.remedy
    with pytest.raises(ValueError, match="names 3 frames in two ways"):
        KittiObjectDataset(tree.parent)


def test_labels_of_a_whole_sequence_are_not_to_be_renamed(tree):
    labels = tree / "label_2"
    tracked = f"0 4 {(labels / '000001.txt').read_text()}".splitlines()[0]
    for path in labels.iterdir():
        path.unlink()
    (labels / "0001.txt").write_text(tracked)
    (problem,) = check_tree(tree.parent)
    assert problem.path == labels / "0001.txt"
    assert "line 1 has 17 fields: frame and track number come before the class" in problem.problem
    with pytest.raises(ValueError, match="frame and track number come before the class"):
        KittiObjectDataset(tree.parent)


def test_a_list_of_classes_beside_labels_is_no_frame(tree):
    (tree / "label_2" / "labels.txt").write_text("Car\nPedestrian\n")
    assert lines(tree.parent) == []
    assert len(open_dataset(tree.parent)) == 3


@pytest.mark.parametrize(
    ("file", "content", "complaint"),
    [
        ("velodyne/000002.bin", bytes(17), "holds 17 bytes, expected a multiple of 16"),
        ("velodyne/000002.bin", np.full(4, np.nan, "<f4").tobytes(), "1 points with NaN"),
        ("velodyne/000002.bin", np.full(4, np.inf, "<f4").tobytes(), "1 points with NaN"),
        (
            "velodyne/000002.bin",
            np.float32([6e5, 0, 0, 0]).tobytes(),
            "farther away than 6e+05 m, expected up to 300 m",
        ),
        (
            "velodyne/000002.bin",
            np.float32([9, 0, 0, 255]).tobytes(),
            "intensities from 255 to 255, expected 0 to 1",
        ),
        (
            "velodyne/000002.bin",
            np.float32([(-9, place, 0, place / 99) for place in range(24)]).tobytes(),
            "none of its 24 points falls",
        ),
        ("image_2/000002.png", b"\x89PNG", "neither a PNG nor a JPEG|cut short"),
        ("image_2/000002.png", b"", "neither a PNG nor a JPEG"),
        ("calib/000002.txt", b"", "lacks P2"),
        ("calib/000002.txt", b"P2: 1\n", "P2 holds 1 values"),
        ("label_2/000002.txt", b"Car 0 0\n", "has 3 fields"),
        ("label_2/000002.txt", LABELS.replace("3.90", "long").encode(), "is 'long', not a number"),
    ],
)
def test_a_file_that_readers_refuse_or_doubt_is_one_line(tree, file, content, complaint):
    (tree / file).write_bytes(content)
    (problem,) = check_tree(tree.parent)
    assert problem.path == tree / file
    assert any(part in problem.problem for part in complaint.split("|"))
    assert problem.remedy
    assert str(problem).count(str(tree / file)) == 1
    assert "\n" not in str(problem)


def test_a_calibration_that_no_vehicle_has_is_named_in_every_kind_of_tree(tmp_path):
    write_object_tree(tmp_path / "object", "000001")
    write_selection(tmp_path / "depth")
    write_depth_drive(tmp_path / "depth", tmp_path / "depth")
    write_drive(tmp_path / "flat", official=False)
    for root, pattern in (
        ("object", "calib/*.txt"),
        ("depth", "*/*/intrinsics/*.txt"),
        ("depth", "*/calib_cam_to_cam.txt"),
        ("flat", "calib_cam_to_cam.txt"),
    ):
        (path,) = (tmp_path / root).rglob(pattern)
        text = path.read_text()
        negative = text.replace("2.0000000000000000e+01", "-2e1").replace("20.0 ", "-20.0 ")
        path.write_text(negative)
        said = lines(tmp_path / root)
        path.write_text(text)
        assert any(line.startswith(str(path)) and "focal lengths of -20" in line for line in said)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("20.00 9.00", "60.00 9.00", "has a 2D box far outside the image"),
        ("5.00 3.00", "-50.00 3.00", "has a 2D box far outside the image"),
        ("20.00 9.00", "4.00 9.00", "has a 2D box with its maximum below its minimum"),
        ("1.50 1.60 3.90", "1.50 0.00 3.90", "has a 3D box of a size that is not positive"),
        ("Car 0.10 0", "Car 0.10 7", "has an occlusion other than -1 to 3"),
    ],
)
def test_labels_that_cannot_be_right_are_named_with_the_object(tree, old, new, complaint):
    rewrite(tree / "label_2" / "000003.txt", old, new)
    (line,) = lines(tree.parent)
    assert line.startswith(f"{tree / 'label_2' / '000003.txt'}: object 1 of 2 (Car) {complaint}; ")


def test_a_box_a_little_over_the_edge_is_no_problem(tree):
    rewrite(tree / "label_2" / "000003.txt", "20.00 9.00", "41.00 12.00")
    assert lines(tree.parent) == []


@pytest.mark.parametrize(
    ("added", "complaint"),
    [
        ("lidar_height_m: 1730\nlidar_tilt_deg: 0 0\n", "lidar_height_m is 1730 m, expected -0.3"),
        ("lidar_height_m: 1.73\n", "lacks lidar_tilt_deg"),
        ("lidar_height_m: 1.73\nlidar_tilt_deg: 0 90\n", "lidar_tilt_deg exceeds 45 degrees"),
    ],
)
def test_a_mount_that_cannot_be_read_is_no_mount_that_is_not_given(tree, added, complaint):
    path = tree / "calib" / "000002.txt"
    path.write_text(path.read_text() + added)
    (line,) = lines(tree.parent)
    assert line.startswith(f"{path}: {complaint}")
    with pytest.raises(FileError, match=complaint):
        open_dataset(tree.parent)[1]


@pytest.mark.filterwarnings("ignore:.*points are left out")
def test_points_at_the_origin_are_counted_in_the_summary_of_trees_and_drives(tree, tmp_path):
    drive = write_drive(tmp_path / "day" / "drive")
    for folder, path in (
        (tree, tree / "velodyne/000002.bin"),
        (drive, drive / "velodyne_points/data/0000000001.bin"),
    ):
        assert "no echo" not in str(summarize_tree(folder)[0])
        cloud = points(25).numpy()
        cloud[::5, :3] = 0
        write_points(path, cloud)
        losses = "of 75 points in 3 checked clouds 5 have no echo and are left out: 0 with non-fin"
        assert losses in str(summarize_tree(folder)[0])
        assert lines(folder) == []
        write_points(path, 0 * cloud)
        (line,) = lines(folder)
        assert f"{path.name}: holds no point: all 25 rows are at 0, 0, 0; check" in line


def test_an_empty_sweep_and_a_frame_without_objects_are_no_problems(tree):
    (tree / "velodyne" / "000001.bin").write_bytes(b"")
    (tree / "label_2" / "000001.txt").write_bytes(b"")
    with pytest.warns(UserWarning, match=r"000001\.bin: holds no point, of \d+ point clouds"):
        assert lines(tree.parent) == []


@pytest.mark.parametrize(
    "file",
    ["image_2/000002.png", "velodyne/000002.bin", "calib/000002.txt", "label_2/000002.txt"],
)
@pytest.mark.parametrize(
    ("replace", "complaint"),
    [
        (os.mkfifo, "is no regular file"),
        (Path.mkdir, "is no regular file"),
        (lambda path: path.symlink_to(path.name), "cannot be read: "),
        (lambda path: path.symlink_to("/dev/zero"), "is no regular file"),
        (write_sparse, f"is {2**40} bytes long, expected up to"),
    ],
    ids=["pipe", "folder", "circular link", "endless device", "terabyte"],
)
def test_what_would_hang_or_fill_the_memory_is_one_line_unread(tree, file, replace, complaint):
    (tree / file).unlink()
    replace(tree / file)
    (line,) = lines(tree.parent)
    assert line.startswith(f"{tree / file}: {complaint}")


def test_clouds_without_permission_are_neither_broken_nor_empty(tree, monkeypatch):
    whole = Path.stat

    def refuse(path, **options):
        if path.suffix == ".bin":
            raise PermissionError(13, "Permission denied", str(path))
        return whole(path, **options)

    monkeypatch.setattr(Path, "stat", refuse)
    remedy = "cannot be read: permission denied; give this user access to it and its folder"
    names = ("000001", "000002", "000003")
    assert lines(tree.parent) == [f"{tree / 'velodyne' / name}.bin: {remedy}" for name in names]


def test_a_fault_that_no_reader_foresaw_is_told_of_its_frame_and_the_others_are_checked(
    tree, monkeypatch
):
    def check(frame):
        if frame.sample_id != "000003":
            raise MemoryError
        return Findings(
            implausible=[Problem(path=Path("3"), problem="is faulty", remedy="mend it")]
        )

    monkeypatch.setattr(tree_checks, "examine_object_frame", check)
    assert lines(tree.parent) == [
        f"{tree}: frame 000001 cannot be checked (MemoryError); report this as a bug",
        f"{tree}: frame 000002 cannot be checked (MemoryError); report this as a bug",
        "3: is faulty; mend it",
    ]


def test_a_name_that_is_no_text_is_told_in_plain_characters(tree):
    (tree / "image_2" / "000002.png").rename(tree / "image_2" / "00\udcff2.png")
    told = "\n".join(lines(tree.parent))
    assert told.isascii()
    assert "00\\udcff2" in told


def test_frames_whose_names_other_commands_refuse_are_a_problem(tree):
    for path in list(tree.glob("*/000002.*")):
        path.rename(path.with_name(f"00\a2{path.suffix}"))
    (problem,) = check_tree(tree.parent)
    with pytest.raises(FileError) as refused:
        open_dataset(tree)
    assert refused.value.problem == problem


def test_a_picture_of_one_colour_among_others_is_a_problem_unless_it_was_corrupted(tree):
    image = tree / "image_2" / "000002.png"
    write_rgb(image, np.full((12, 40, 3), 90, np.uint8))
    (line,) = lines(tree.parent)
    assert line.startswith(f"{image}: has a single colour; check whether")
    (tree / "corruption").mkdir()
    assert lines(tree.parent) == []


def test_a_handful_of_points_in_the_image_is_a_problem_in_trees_drives_and_recordings(tmp_path):
    behind = torch.rand(267, 4, generator=torch.Generator().manual_seed(0))
    behind[:, 0] -= 11
    cloud = torch.cat((points(3), behind))
    write_object_frame(tmp_path / "tree", "000001")
    write_points(tmp_path / "tree" / "training" / "velodyne" / "000001.bin", cloud)
    write_drive(tmp_path / "drive", 1, official=False)
    write_points(tmp_path / "drive" / "velodyne" / "0000000000.bin", cloud)
    for root in ("tree", "drive"):
        (told,) = lines(tmp_path / root)
        assert "only 3 of its 270 points fall into the image" in told
    write_recording(tmp_path / "recording", ("a",), cloud=".npy")
    cloud = np.concatenate((POINTS[POINTS[:, 0] > 5][:9], behind.numpy()[:200]))
    write_cloud_file(tmp_path / "recording" / "points" / "a.npy", cloud)
    (told,) = lines(tmp_path / "recording")
    assert "209 points of frame a into the image of 375x1242 (height x width);" in told


def test_it_goes_on_after_every_problem_and_tells_them_in_the_order_of_the_frames(tree):
    (tree / "image_2" / "000003.png").unlink()
    (tree / "calib" / "000001.txt").write_text("")
    (tree / "velodyne" / "000002.bin").write_bytes(bytes(3))
    (tree / "label_2" / "000003.txt").write_text("Car")
    found = [problem.path.relative_to(tree) for problem in check_tree(tree.parent, num_workers=3)]
    assert [str(path) for path in found] == [
        "image_2/000003.png",
        "calib/000001.txt",
        "velodyne/000002.bin",
        "label_2/000003.txt",
    ]


def test_sweeps_in_both_folders_are_looked_at(tree):
    shutil.copytree(tree / "velodyne", tree / "velodyne_reduced")
    (tree / "velodyne_reduced" / "000002.bin").write_bytes(bytes(3))
    (line,) = lines(tree.parent)
    assert line.startswith(str(tree / "velodyne_reduced" / "000002.bin"))


def test_reduced_sweeps_alone_are_enough(tree):
    (tree / "velodyne").rename(tree / "velodyne_reduced")
    assert lines(tree.parent) == []
    assert "velodyne_reduced 3" in str(summarize_tree(tree.parent)[0])


@pytest.mark.parametrize("kind", ["velodyne_raw", "groundtruth_depth"])
def test_an_image_of_another_size_than_its_depth_map_is_a_problem_with_both_sizes(tmp_path, kind):
    write_selection(tmp_path)
    path = next(tmp_path.rglob(f"{kind}/*.png"))
    write_depth_png(path, depth_map(size=(12, 41)))
    (line,) = lines(tmp_path)
    assert line.startswith(f"{path}: is 12x41 (height x width) but the image ")
    assert "is 12x40; " in line


def test_a_simulated_trees_depth_maps_are_looked_at_beside_its_images(tree):
    for name in ("000001", "000002", "000003"):
        write_depth_png(tree / "depth" / f"{name}.png", np.full((12, 40), 7.0))
    assert lines(tree.parent) == []
    assert str(summarize_tree(tree.parent)[0]).endswith("label_2 3, depth 3)")
    (tree / "depth" / "000001.png").unlink()
    write_depth_png(tree / "depth" / "000002.png", depth_map(size=(12, 41)))
    (tree / "depth" / "000003.png").write_bytes(b"\x89PNG")
    (tree / "image_2" / "000003.png").write_bytes(b"")
    found = {problem.path.relative_to(tree): problem.problem for problem in check_tree(tree)}
    assert found[Path("depth/000001.png")] == "is missing"
    assert found[Path("depth/000002.png")].startswith("is 12x41 (height x width) but the image ")
    assert {Path("depth/000003.png"), Path("image_2/000003.png")} < found.keys()


def test_depth_maps_of_8_bits_and_truths_without_depth_are_problems(tmp_path):
    write_selection(tmp_path)
    sparse = next(tmp_path.rglob("velodyne_raw/*.png"))
    write_rgb(sparse, picture())
    write_depth_png(next(tmp_path.rglob("groundtruth_depth/*.png")), np.zeros((12, 40)))
    next(tmp_path.rglob("intrinsics/*.txt")).write_text("1 2 3")
    assert [line.split(": ", 1)[1].split(",")[0] for line in lines(tmp_path)] == [
        "is a PNG of 3 channels with 8 bits",
        "holds 3 numbers",
        "holds no depth; create it again",
    ]


@pytest.mark.parametrize(("count", "is_told"), [(150, True), (99, False)])
def test_the_largest_number_for_no_value_in_a_depth_map_is_told(tmp_path, count, is_told):
    write_selection(tmp_path)
    path = next(tmp_path.rglob("groundtruth_depth/*.png"))
    depth_m = depth_map()
    depth_m.ravel()[:count] = MAX_DEPTH_M
    write_depth_png(path, depth_m)
    said = f"holds 65535 at {count} pixels, probably for no value; write 0 for no value"
    assert any(said in line for line in lines(tmp_path)) == is_told


def test_labels_without_3d_boxes_are_counted_in_the_summary(tree):
    assert "3D box" not in str(summarize_tree(tree.parent)[0])
    path = tree / "label_2" / "000001.txt"
    path.write_text(f"{path.read_text().rstrip()}\nCar 0 0 -1.5 1 2 30 11 -1 -1 -1 -1 -1 -1 -1\n")
    assert lines(tree.parent) == []
    assert "; 1 of 4 labelled objects have no 3D box" in str(summarize_tree(tree.parent)[0])


def test_many_missing_files_of_a_part_are_one_problem_with_their_number(tree):
    for number in range(4, 10):
        for folder in ("image_2", "velodyne", "calib"):
            copied = next((tree / folder).glob("000001.*"))
            shutil.copyfile(copied, copied.with_stem(f"{number:06}"))
    missing = [line for line in lines(tree.parent) if "label_2: lacks" in line]
    assert len(missing) == 1
    assert "lacks files of 6 of 9 frames: 000004, 000005, 000006, 000007, 000008 and" in missing[0]
    assert not [line for line in lines(tree.parent) if "is missing" in line]


def test_gaps_in_depth_trees_and_drives_are_named(tmp_path):
    write_selection(tmp_path, "0000000005")
    write_selection(tmp_path, "0000000008", seed=2)
    next(tmp_path.rglob("groundtruth_depth/*08_image_02.png")).unlink()
    (line,) = lines(tmp_path)
    assert "groundtruth_depth: lacks a file of 2011_09_26_drive_0002_sync_image_0000000008" in line
    for root in (selection := tmp_path / "depth_selection" / "val_selection_cropped", tmp_path):
        (root / "calib").mkdir()  # kept for other programs
        (root / "calib" / "0.txt").write_text("")
        assert [each.folder for each in summarize_tree(root)] == [selection]
    folder = write_drive(tmp_path / "day" / "drive")
    (folder / "velodyne_points" / "data" / "0000000001.bin").unlink()
    (folder.parent / "calib_cam_to_cam.txt").unlink()
    gap, calibration = lines(folder)
    assert "velodyne_points/data/0000000001.bin: is missing; " in gap
    assert "name a list of the other frames" in gap  # KITTI's own drive 0009 lacks four sweeps
    assert "calib_cam_to_cam.txt: is missing, here and one folder up; " in calibration
    assert "or make data that is not KITTI's a recording" in calibration


@pytest.mark.parametrize("split", ["train", "val"])
def test_a_split_by_drives_is_checked_by_its_own_folder_as_in_the_tree(
    tmp_path, monkeypatch, split
):
    write_depth_drive(tmp_path, tmp_path, split)
    for archive in ("data_depth_annotated", "data_depth_velodyne"):
        shutil.copytree(tmp_path / archive, tmp_path, dirs_exist_ok=True)
        shutil.rmtree(tmp_path / archive)
    folder = tmp_path / split
    monkeypatch.chdir(folder)
    for place in (tmp_path, folder, Path()):
        (summary,) = summarize_tree(place)
        assert (summary.folder, summary.num_frames) == (folder, 1)
        assert lines(place) == []
    next(folder.rglob("groundtruth/image_02/*.png")).unlink()
    (line,) = lines(folder)
    assert line.startswith(f"{folder}/*/proj_depth/groundtruth: holds no files of the frames")


def test_a_split_by_drives_without_its_raw_drives_is_a_problem_as_for_opening(tmp_path):
    name = write_depth_drive(tmp_path, tmp_path)
    day = tmp_path / "2011_09_26"
    images = day / "2011_09_26_drive_0002_sync" / "image_02" / "data"
    shutil.rmtree(images)
    (line,) = lines(tmp_path)
    told = f"lacks images of 1 of 1 frames of val ({name}); extract KITTI's raw data, or link"
    assert line.startswith(f"{images}: {told}")
    shutil.rmtree(day)
    (line,) = lines(tmp_path)
    told = "is missing, with the intrinsics of 1 frame of val; extract KITTI's raw data, or link"
    assert line.startswith(f"{day / 'calib_cam_to_cam.txt'}: {told}")
    for parts in (("points",), ("image", "points")):
        with pytest.raises(ValueError, match=r"intrinsics .* lacks 1 of 1"):
            open_dataset(tmp_path, parts=parts)


def test_part_of_a_calibration_in_a_drive_is_named_where_the_day_has_the_one_read(tmp_path):
    folder = write_drive(tmp_path / "day" / "drive")
    mounting = folder.parent / "calib_velo_to_cam.txt"
    (folder / mounting.name).write_bytes(mounting.read_bytes())
    (line,) = lines(folder)
    assert "drive/calib_velo_to_cam.txt: is not read: the drive's folder has no calib_cam_" in line
    camera = folder.parent / "calib_cam_to_cam.txt"
    (folder / camera.name).write_bytes(camera.read_bytes())
    assert lines(folder) == []


def test_a_calibration_that_is_a_pipe_is_a_problem_and_nothing_waits_for_it(tmp_path):
    write_recording(tmp_path)
    (path,) = tmp_path.glob("calibration.*")
    path.unlink()
    os.mkfifo(path)
    assert any("is no regular file" in str(problem) for problem in check_tree(tmp_path))
