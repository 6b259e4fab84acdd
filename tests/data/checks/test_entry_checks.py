import re
import shutil
import warnings

import cv2
import numpy as np
import pytest
import torch

from sightline.data.check import check_tree, summarize_tree
from sightline.data.checks.frame_checks import check_depth_fit, depth_range_doubt
from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.map_png import write_depth_png
from sightline.data.open import open_dataset
from sightline.data.sharding import write_shards
from sightline.files.problem import FileError
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.data.recordings import write_recording
from tests.data.trees import (
    LABELS,
    calibration,
    write_depth_drive,
    write_drive,
    write_object_tree,
    write_selection,
)


@pytest.fixture
def tree(tmp_path):
    return write_object_tree(tmp_path, "000001", "000002", "000003") / "training"


def doubts(root, **settings) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        open_dataset(root, **settings)
    return [str(each.message) for each in caught]


def spread(count: int = 100) -> np.ndarray:
    generator = np.random.default_rng(0)
    return generator.uniform((5, -4, -1, 0), (40, 4, 1, 1), (count, 4)).astype("<f4")


def test_sound_data_of_every_layout_open_without_a_word(tmp_path, tree):
    write_selection(tmp_path / "depth")
    write_depth_drive(tmp_path / "drives", tmp_path / "drives")
    write_drive(tmp_path / "raw")
    write_recording(tmp_path / "recording")
    for root in (tree, "depth", "drives", "raw", "recording"):
        assert doubts(tmp_path / root) == []


@pytest.mark.parametrize(
    ("scale", "complaint"),
    [
        ((1, 1, 1, 255), "intensities from .* expected 0 to 1; .* divide them"),
        ((1000, 1000, 1000, 1), "in millimetres"),
    ],
)
def test_sweeps_that_cannot_be_right_are_refused_before_work_as_check_does(tree, scale, complaint):
    path = tree / "velodyne" / "000003.bin"
    path.write_bytes((spread() * np.float32(scale)).astype("<f4").tobytes())
    with pytest.raises(FileError, match=complaint) as caught:
        open_dataset(tree)
    assert caught.value.problem.path == path
    assert caught.value.problem in list(check_tree(tree))
    assert len(open_dataset(tree, parts=("image",))) == 3  # which needs no sweep


def test_an_inverted_calibration_is_a_warning_for_all_frames_together(tree):
    rigid = torch.linalg.inv(calibration().camera_from_lidar)[:3].flatten().tolist()
    entry = f"Tr_velo_to_cam: {' '.join(map(str, rigid))}\n"
    for path in (tree / "calib").iterdir():
        lines = path.read_text().splitlines(keepends=True)
        path.write_text("".join(entry if "Tr_velo" in each else each for each in lines))
    inverted, view = doubts(tree)
    assert (
        "000001.txt: holds a transform from LiDAR to camera that is probably inverted" in inverted
    )
    assert "(3 like it in 3 checked frames)" in inverted
    assert "points falls into the image" in view


def test_a_raw_drives_calibration_is_judged_too(tmp_path):
    drive = write_drive(tmp_path / "drive", official=False)
    path = drive / "calib_velo_to_cam.txt"
    path.write_text("R: 1 0 0 0 1 0 0 0 1\nT: 0 0 0\n")
    doubt, _ = doubts(drive)
    assert "has the identity for its rotation" in doubt


def test_labels_of_another_unit_are_a_warning_where_they_are_used(tree):
    for path in (tree / "label_2").iterdir():
        path.write_text(LABELS.replace("Car ", "Automobile "))
    (doubt,) = doubts(tree)
    assert "'Automobile', which is no class of KITTI" in doubt
    assert "write Car (3 like it in 3 checked frames" in doubt
    assert doubts(tree, parts=("image", "points")) == []


def test_images_of_one_colour_and_sweeps_without_points_are_told(tree):
    for number in (1, 2, 3):
        write_rgb(tree / "image_2" / f"00000{number}.png", np.zeros((12, 40, 3), np.uint8))
        (tree / "velodyne" / f"00000{number}.bin").write_bytes(b"")
    images, sweeps = doubts(tree)
    assert "all 3 images have a single colour" in images
    assert "all 3 sweeps are empty" in sweeps


def test_depth_in_millimetres_is_doubted_by_check_and_on_entry(tmp_path):
    write_selection(tmp_path)
    for path in tmp_path.rglob("velodyne_raw/*.png"):
        write_depth_png(path, np.full((12, 40), 0.05))
    (doubt,) = doubts(tmp_path)
    assert "has a 99th percentile of depths of 0.05" in doubt
    assert any("in millimetres or another unit" in each.problem for each in check_tree(tmp_path))


@pytest.mark.parametrize(
    ("valid_share", "scale", "doubted"),
    [(0.9, 1, False), (0.9, 1000 / 256, True), (0.3, 1, True), (0.3, 1000 / 256, True)],
)
def test_only_dense_depth_goes_beyond_the_range_of_lidars(valid_share, scale, doubted):
    rng = np.random.default_rng(0)
    depth_m = np.exp(rng.normal(np.log(14), 1.0, (40, 80)))  # 99th percentile of 140 m
    depth_m[rng.random(depth_m.shape) > valid_share] = 0
    assert (depth_range_doubt(depth_m * scale) is not None) is doubted


def test_depth_is_compared_with_the_points_that_it_shows(tree):
    shown = spread(1000)
    shown[:, 1:3] /= 20
    (tree / "velodyne" / "000001.bin").write_bytes(shown.tobytes())
    (tree / "depth").mkdir()
    for number in (1, 2, 3):
        write_depth_png(tree / "depth" / f"00000{number}.png", np.full((12, 40), 90.0))
    (doubt,) = doubts(tree, parts=("image", "points", "depth"))
    assert "times the depths of the points" in doubt
    for number in (1, 2, 3):
        write_depth_png(tree / "depth" / f"00000{number}.png", np.full((6, 20), 90.0))
    (doubt,) = doubts(tree, parts=("image", "points", "depth"))
    assert "is 6x20 (height x width) but the image" in doubt, "the scale is no fault of its own"


def test_depth_maps_of_other_frames_are_doubted(tmp_path):
    rows, columns = np.mgrid[:20, :40].reshape(2, -1)
    depth_m = np.random.default_rng(0).uniform(5, 50, (20, 40)).astype(np.float32)
    image_from_camera = np.array([[10.0, 0, 20, 0], [0, 10, 10, 0], [0, 0, 1, 0]])
    rays = np.stack(((columns - 19.5) / 10, (rows - 9.5) / 10, np.ones(800), np.zeros(800)), axis=1)
    points = (rays * depth_m.reshape(-1, 1)).astype(np.float32)
    path = tmp_path / "depth" / "000001.png"
    assert check_depth_fit(depth_m, points, image_from_camera, path) == []
    (doubt,) = check_depth_fit(np.roll(depth_m, 7), points, image_from_camera, path)
    assert "agrees with the points at only" in str(doubt)
    few = points[:50]
    assert check_depth_fit(np.roll(depth_m, 7), few, image_from_camera, path) == []


def test_depth_maps_without_depth_are_doubted(tree):
    (tree / "depth").mkdir()
    for number in (1, 2, 3):
        write_depth_png(tree / "depth" / f"00000{number}.png", np.zeros((12, 40)))
    (doubt,) = doubts(tree, parts=("image", "points", "depth"))
    assert "000001.png: holds no depth; create it again, or remove it (3 like it" in doubt


@pytest.mark.parametrize("bad", [".bmp", ".tif", ".ppm", ""])
def test_pictures_that_nobody_reads_are_refused_where_none_is_left(tree, bad):
    for path in list((tree / "image_2").iterdir()):
        path.rename(path.with_suffix(bad))
    with pytest.raises(
        FileError, match=r"holds 3 files that are not read .*expected \.png"
    ) as told:
        open_dataset(tree.parent)
    assert told.value.problem.path == tree / "image_2"
    assert told.value.problem in list(check_tree(tree.parent))


@pytest.mark.parametrize(
    ("write", "folder"),
    [
        (write_recording, "points"),
        (write_recording, "images"),
        (write_drive, "image_02/data"),
        (write_drive, "velodyne_points/data"),
    ],
)
def test_files_that_nobody_reads_are_told_in_every_layout(tmp_path, write, folder):
    root = tmp_path / "data"  # a drive's calibration lies one folder up
    write(root)
    paths = sorted((root / folder).iterdir())
    for path in paths:
        path.rename(path.with_suffix(".laz"))
    with pytest.raises(FileError, match=r"files that are not read \(. \.laz\)"):
        open_dataset(root)
    problems = [each for each in check_tree(root) if each.path == root / folder]
    assert [each.problem[:6] for each in problems] == ["holds "]


def test_some_files_that_nobody_reads_are_counted_beside_those_that_are(tree):
    path = tree / "image_2" / "000002.png"
    path.rename(path.with_suffix(".bmp"))
    (tree / "image_2" / "notes.txt").write_text("taken in May")
    (doubt,) = doubts(tree)
    assert "holds 1 files that are not read (1 .bmp), beside 2 that are" in doubt


@pytest.mark.parametrize("name", ["calibration.yaml", "calibration.json"])
def test_a_recordings_calibration_in_an_object_tree_is_told_as_not_read(tree, name):
    shutil.copytree(tree, tree.parent / "testing")
    for path in (tree / name, tree.parent / name):
        path.write_text("lidar_height_m: 2.5\n")
        for root in (tree, tree.parent):
            (doubt,) = (each for each in doubts(root) if name in each)
            assert doubt.startswith(f"{path}: is not read: in KITTI's object trees each frame has")
            (problem,) = (each for each in check_tree(root) if each.path == path)
            assert str(problem) == doubt
        path.unlink()


def test_files_in_folders_below_are_told(tree):
    (tree / "image_2" / "left").mkdir()
    for path in list((tree / "image_2").glob("*.png")):
        path.rename(tree / "image_2" / "left" / path.name)
    with pytest.raises(FileError, match="holds no files, only 1 folders such as left"):
        open_dataset(tree)


def test_files_in_folders_beside_those_that_are_read_are_told(tree):
    (tree / "image_2" / "left").mkdir()
    (tree / "image_2" / "left" / "notes.txt").write_text("")
    open_dataset(tree)  # an error if it warned
    shutil.copy(next((tree / "image_2").glob("*.png")), tree / "image_2" / "left")
    expected = "holds 1 files in folders such as left, which are not searched, beside 3 that are"
    with pytest.warns(UserWarning, match=expected):
        open_dataset(tree)


def test_capital_endings_are_read_in_every_tree(tmp_path, tree):
    write_selection(tmp_path / "depth")
    write_drive(tmp_path / "raw")
    for path in [each for each in tmp_path.rglob("*.*") if each.is_file()]:
        if path.suffix in (".png", ".bin"):
            path.rename(path.with_suffix(path.suffix.upper()))
    for root, count in ((tree, 3), (tmp_path / "depth", 1), (tmp_path / "raw", 3)):
        dataset = open_dataset(root)
        assert len(dataset) == count
        assert dataset[0].image is not None
        assert dataset[0].points is not None


def test_clouds_that_stand_on_their_head_are_doubted_in_kittis_tree_before_anything_else(tmp_path):
    root = shutil.copytree(PACKAGED_FRAMES, tmp_path / "KITTI")
    for path in (root / "training" / "velodyne").iterdir():
        points = np.fromfile(path, "<f4").reshape(-1, 4)
        (points * np.float32([1, -1, -1, 1])).tofile(path)
    told = [str(problem) for problem in check_tree(root)]
    assert any("z" in problem and "convert" in problem for problem in told), told
    assert not any("millimetres" in problem for problem in told)
    assert any("convert" in doubt for doubt in doubts(root))


@pytest.mark.parametrize(
    ("own", "other"),
    [
        ("velodyne", "Velodyne"),
        ("velodyne", "lidar"),
        ("image_2", "image_02"),
        ("image_2", "images"),
        ("calib", "calibration"),
    ],
)
def test_a_sensors_folder_of_another_name_is_called_so_in_kittis_tree(tree, own, other):
    (tree / own).rename(tree / other)
    with pytest.raises(FileError, match=f"{other}.* holds 3 files that are not read.*{own}"):
        open_dataset(tree)
    assert any(other in str(problem) for problem in check_tree(tree))


def test_labels_in_a_folder_of_another_name_are_told_where_labels_are_used(tree, recwarn):
    (tree / "label_2").rename(tree / "label_02")
    open_dataset(tree, parts=("image", "points"))
    assert not recwarn
    told = "label_02: holds 3 files that are not read, expected them in label_2; rename"
    with pytest.warns(UserWarning, match=told):
        assert open_dataset(tree)[0].objects is None
    assert [told in str(problem) for problem in check_tree(tree)] == [True]


@pytest.mark.parametrize(
    ("own", "other"), [("points", "Points"), ("points", "lidar"), ("images", "image")]
)
def test_a_sensors_folder_of_another_name_is_called_so_in_recordings(tmp_path, own, other):
    write_recording(tmp_path, ("a",))
    (tmp_path / own).rename(tmp_path / other)
    with pytest.raises(FileError, match=f"{other}.* holds 1 files that are not read.*{own}"):
        open_dataset(tmp_path)


@pytest.mark.filterwarnings("ignore:.*has no image_size")
@pytest.mark.parametrize(("own", "other"), [("images", "image_front"), ("points", "LIDAR_TOP")])
def test_a_folder_of_any_name_with_files_of_the_frames_is_told_where_the_sensor_has_none(
    tmp_path, own, other
):
    write_recording(tmp_path, ("a", "b"))
    shutil.copytree(tmp_path / own, tmp_path / other)
    (tree,) = summarize_tree(tmp_path)
    assert f"not read: {other}, whose files have the frames' names" in str(tree)
    assert not list(check_tree(tmp_path))  # a second sensor is no fault
    shutil.rmtree(tmp_path / own)
    told = f"{other}: holds 2 files with the frames' names that are not read, and there is no "
    problem = next(each for each in check_tree(tmp_path) if told in str(each))
    assert f"rename it to {own}" in str(problem)
    with pytest.warns(UserWarning, match=f"{told}folder {own}"):
        open_dataset(tmp_path)


def test_folders_of_other_frames_results_masks_and_maps_of_16_bits_are_no_further_cameras(tree):
    pictures = sorted((tree / "image_2").iterdir())
    for folder in ("others", "results", "disparity"):
        (tree / folder).mkdir()
    (tree / "results" / "sightline.json").touch()
    for picture in pictures:
        shutil.copy(picture, tree / "others" / f"x{picture.name}")
        shutil.copy(picture, tree / "results")
        write_depth_png(tree / "disparity" / picture.name, np.ones((2, 2)))
    shutil.copytree(tree / "velodyne", tree / "velodyne_reduced")
    shutil.copytree(tree / "image_2", tree / "image_3")
    (told,) = summarize_tree(tree)
    assert told.note.endswith("not read: image_3, whose files have the frames' names")
    assert not list(check_tree(tree))
    shutil.rmtree(tree / "image_3")
    shutil.copytree(tree / "image_2", tree / "camera_mask")
    (tree / "corruption").mkdir()  # of `sightline corrupt`, with masks
    shutil.rmtree(tree / "image_2")
    (told,) = summarize_tree(tree)
    assert "camera_mask" not in told.note
    assert not list(check_tree(tree))


@pytest.mark.parametrize(("own", "other"), [("images", "Images"), ("labels", "LABELS")])
def test_a_second_folder_in_another_case_is_told_beside_the_one_that_is_read(tmp_path, own, other):
    write_recording(tmp_path, ("a",))
    (tmp_path / "labels").mkdir()
    shutil.copytree(tmp_path / own, tmp_path / other)
    (tmp_path / other / "b.txt").touch()
    shutil.copy(tmp_path / "images" / "a.jpg", tmp_path / other / "c.jpg")
    num_files = {"images": 2, "labels": 1}[own]
    told = [problem for problem in check_tree(tmp_path) if problem.path.name == other]
    assert [each.problem for each in told] == [
        f"holds {num_files} files that are not read, expected them in {own}"
    ]
    assert any(f"{other}: holds {num_files} files" in each for each in doubts(tmp_path))
    shutil.rmtree(tmp_path / other)
    (tmp_path / other).symlink_to(own)  # as on a disk that knows no case
    assert not [problem for problem in check_tree(tmp_path) if problem.path.name == other]


def test_files_that_hide_each_other_are_told_by_check_and_on_opening(tree, recwarn):
    shutil.copy(tree / "image_2" / "000001.png", tree / "image_2" / "000001.PNG")
    assert [problem.path.name for problem in check_tree(tree)] == ["000001.PNG"]
    open_dataset(tree)
    assert any(
        "is not read, because 000001.png has the same name" in str(each.message) for each in recwarn
    )


@pytest.mark.parametrize(("name", "other"), [("a", "A"), ("\u00e9", "e\u0301"), ("\u00df", "ss")])
def test_frames_that_some_disks_take_for_one_are_told(tmp_path, name, other):
    write_recording(tmp_path, (name, other))
    if len(list((tmp_path / "images").iterdir())) < 2:
        pytest.skip("this disk is one of them")
    with pytest.warns(UserWarning, match="only in case or in the encoding of accents"):
        open_dataset(tmp_path)
    assert {problem.path.parent.name for problem in check_tree(tmp_path)} == {"images", "points"}


def test_an_image_and_a_cloud_whose_names_differ_in_case_are_told(tmp_path):
    write_recording(tmp_path, ("a", "b"))
    (tmp_path / "points" / "b.pcd").rename(tmp_path / "points" / "B.pcd")
    if (tmp_path / "points" / "b.pcd").exists():
        pytest.skip("this disk takes both names for one")
    said = "B.pcd: differs from b only in case or in the encoding of accents; rename one: a frame's"
    assert any(said in str(problem) for problem in check_tree(tmp_path))
    with pytest.warns(UserWarning, match=re.escape(said)):
        open_dataset(tmp_path)


def test_names_that_no_screen_shows_are_told_by_check_as_on_opening(tmp_path):
    write_recording(tmp_path, ("a\nb", "c"))
    with pytest.raises(FileError, match=r"has 1 frames with names") as raised:
        open_dataset(tmp_path)
    assert [str(problem) for problem in check_tree(tmp_path)] == [str(raised.value)]


@pytest.mark.parametrize("name", ["times.txt", "calibration.yaml"])
def test_what_is_no_file_is_told_and_not_passed_over(tmp_path, name):
    write_recording(tmp_path, ("a",))
    (tmp_path / name).unlink(missing_ok=True)
    (tmp_path / name).symlink_to("nowhere")
    (problem,) = check_tree(tmp_path)
    assert str(problem).startswith(f"{tmp_path / name}: is a link to 'nowhere', which cannot be r")
    with pytest.raises(FileError, match=f"{name}: is a link to 'nowhere', which cannot be reached"):
        open_dataset(tmp_path)[0]


@pytest.mark.parametrize("folder", ["image_2", "velodyne", "label_2"])
@pytest.mark.parametrize("target", ["unmounted/disk", "itself", None])
def test_a_sensor_behind_a_link_to_nothing_is_not_taken_for_one_that_lacks(tree, folder, target):
    lost = tree / folder
    shutil.rmtree(lost)
    if target is None:
        lost.write_text("a file")
    else:
        lost.symlink_to(folder if target == "itself" else target)
    complaint = "is no folder" if target is None else "is a link to .*, which cannot be reached"
    with pytest.raises(FileError, match=complaint) as caught:
        open_dataset(tree)
    assert caught.value.problem.path == lost
    assert caught.value.problem in list(check_tree(tree))


def test_grey_images_are_told_as_where_arrays_are_given(tree):
    for path in (tree / "image_2").iterdir():
        grey = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2GRAY)
        cv2.imwrite(str(path), grey)
    with pytest.warns(UserWarning, match=r"training: checked images are grey: .* on colour"):
        open_dataset(tree)
    assert not list(check_tree(tree))
    assert "; images are grey: their level is used" in str(summarize_tree(tree)[0])


LEFTOVER_FOLDERS = ("@eaDir", "#recycle", "$RECYCLE.BIN", "System Volume Information", "lost+found",
                    ".AppleDouble", ".Trash-1000", ".sync", ".stfolder")  # fmt: skip
LEFTOVER_FILES = ("Thumbs.db", "desktop.ini", "Icon\r", "._lost{0}", "{1}:Zone.Identifier",
                  "gone{0}:Zone.Identifier", "{1}.md5", "gone{0}.sha256", "{1}.bak", "{1}~",
                  "{1}.part")  # fmt: skip


@pytest.mark.parametrize(
    "write",
    [
        lambda root: write_object_tree(root, "000001"),
        write_recording,
        lambda root: write_drive(root, official=False),
    ],
    ids=["tree", "recording", "drive"],
)
def test_leftovers_of_systems_and_copies_of_read_files_are_no_findings(tmp_path, write, recwarn):
    root = tmp_path / "data"
    write(root)
    names = open_dataset(root).sample_ids
    paths = [path for path in root.rglob("*") if path.is_file()]
    for path in paths:
        for name in LEFTOVER_FOLDERS:
            (path.parent / name / path.name).mkdir(parents=True)  # thumbnails lie in a folder
            shutil.copy(path, path.parent / name / f"other{path.suffix}")
        for name in LEFTOVER_FILES:
            (path.parent / name.format(path.suffix, path.name)).write_bytes(b"\0")
    assert open_dataset(root).sample_ids == names
    assert not recwarn
    assert not list(check_tree(root))
    for path in root.rglob("Icon\r"):
        path.unlink()  # shards hold no such names
    write_shards(root, tmp_path / "shards", frames_per_shard=9)
    assert open_dataset(tmp_path / "shards").sample_ids == names


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("9.png.crdownload", "finish their download or move them away"),
        ("9.png.bak", "rename them or move them away"),
        ("9.png~", "rename them or move them away"),
        ("9.bmp", "convert them or move them away"),
    ],
)
def test_unread_files_have_a_remedy_that_suits_their_ending(tree, name, remedy):
    (tree / "image_2" / name).write_bytes(b"\0")
    (problem,) = check_tree(tree)
    assert problem.problem.startswith("holds 1 files that are not read (1 ")
    assert problem.remedy == remedy


def test_labels_of_points_are_told_as_such(tmp_path):
    write_recording(tmp_path)
    (tmp_path / "labels").mkdir()
    (tmp_path / "labels" / "a.label").write_bytes(bytes(8))
    (problem,) = check_tree(tmp_path)
    assert problem.problem.endswith(
        "(1 .label), expected .txt, with labels of objects, not of points"
    )
    assert problem.remedy == "write such labels or move them away"


def test_folders_called_as_files_are_not_counted_in_folders_below(tree):
    (tree / "image_2" / "left" / "000001.png").mkdir(parents=True)
    open_dataset(tree)  # an error if it warned
    assert not list(check_tree(tree))


def test_data_sets_in_the_bin_of_a_network_drive_are_not_proposed(tmp_path):
    write_recording(tmp_path / "#recycle" / "deleted")
    with pytest.raises(FileError) as told:
        open_dataset(tmp_path)
    assert "recycle" not in str(told.value)
