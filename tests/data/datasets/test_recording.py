import json
import pickle
import shutil

import cv2
import numpy as np
import pytest
import torch
import yaml

from sightline.data.check import check_tree, summarize_tree
from sightline.data.datasets.recording import RecordingDataset
from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.map_png import write_depth_png
from sightline.data.open import open_dataset
from sightline.files.problem import FileError
from tests.data.recordings import (
    CAMERA_MATRIX,
    IMAGE,
    LABELS,
    POINTS,
    SAMPLE,
    calibration_entries,
    write_calibration,
    write_cloud_file,
    write_recording,
)


@pytest.mark.parametrize(
    ("cloud", "picture"), [(".pcd", ".png"), (".npy", ".jpg"), (".bin", ".png")]
)
def test_a_recording_of_any_formats_is_the_simulated_frame(tmp_path, cloud, picture):
    changes = {"max_intensity": 255}
    write_recording(tmp_path, cloud=cloud, picture=picture, **changes)
    dataset = open_dataset(tmp_path)
    assert isinstance(dataset, RecordingDataset)
    assert dataset.sample_ids == ("a", "b")
    sample = dataset[0]
    torch.testing.assert_close(sample.points, SAMPLE.points, rtol=0, atol=1e-6)
    assert sample.image_size == SAMPLE.image_size
    assert (sample.image.float() - SAMPLE.image).abs().mean() < (8 if picture == ".jpg" else 1e-9)
    ours, true = sample.calibration.image_from_lidar, SAMPLE.calibration.image_from_lidar
    torch.testing.assert_close(ours, true, rtol=0, atol=1e-9)
    assert list(check_tree(tmp_path)) == []
    (summary,) = summarize_tree(tmp_path)
    assert "2 frames (images 2, points 2, calibration 2, labels 0, depth 0); " in str(summary)
    assert "% of the points of frame a fall into the image" in str(summary)
    assert "by the road in its clouds the LiDAR is 1.7" in str(summary)


def test_points_without_an_echo_are_counted_in_the_summary(tmp_path):
    write_recording(tmp_path)
    cloud = POINTS.copy()
    cloud[:30, 1], cloud[30:37, :3] = np.nan, 0
    write_cloud_file(tmp_path / "points/b.pcd", cloud)
    (summary,) = summarize_tree(tmp_path)
    losses = f"of {2 * len(POINTS)} points in 2 checked clouds 37 have no echo and are left out"
    assert f"{losses}: 30 with non-finite x, y, z, 7 at" in str(summary)


@pytest.mark.filterwarnings("ignore:.*times the depths of the points")
def test_labels_depth_times_and_a_calibration_in_json_are_read(tmp_path):
    write_recording(tmp_path, ("a", "b"))
    (tmp_path / "calibration.yaml").unlink()
    (tmp_path / "calibration.json").write_text(json.dumps(calibration_entries()))
    (tmp_path / "labels").mkdir()
    shutil.copy(LABELS, tmp_path / "labels" / "a.txt")
    write_depth_png(tmp_path / "depth" / "a.png", np.ones(SAMPLE.image_size))
    (tmp_path / "times.txt").write_text("a 1000.5\nb 1000.75\n")
    first, second = (
        open_dataset(tmp_path, parts=("points", "objects", "depth"), needs=())[at] for at in (0, 1)
    )
    assert first.objects.class_names == SAMPLE.objects.class_names
    assert first.depth.mean() == 1
    assert second.objects is None
    assert second.timestamp_s == 0.25


def test_a_depth_map_of_another_size_than_the_images_is_named_as_the_cause(tmp_path):
    write_recording(tmp_path, ("a", "b"))
    height, width = SAMPLE.image_size
    path = tmp_path / "depth" / "a.png"
    for size, remedy in (
        ((height // 2, width // 2), "write depth maps in the size of the images"),
        ((width, height), "rotate it"),
    ):
        write_depth_png(path, np.full(size, 9.0))
        (line,) = [str(each) for each in check_tree(tmp_path) if each.path == path]
        assert f"is {size[0]}x{size[1]} (height x width), expected {height}x{width}" in line
        assert remedy in line


def test_times_since_the_start_are_those_that_are_written(tmp_path):
    write_recording(tmp_path, ("a", "b", "c"))
    (tmp_path / "times.txt").write_text("a 1700000000.000000\nb 1700000000.6\nc 1700000000.7\n")
    dataset = open_dataset(tmp_path, parts=("points",), needs=())
    assert [dataset[at].timestamp_s for at in range(3)] == [0.0, 0.6, 0.7]


def test_frames_of_two_cameras_and_sensors_have_calibrations_of_their_own(tmp_path):
    write_recording(tmp_path, ("a",))
    write_rgb(tmp_path / "images" / "b.png", cv2.resize(IMAGE, (621, 188)))
    write_cloud_file(tmp_path / "points" / "b.npy", POINTS[::7])
    own = calibration_entries(camera_matrix=(np.diag([0.5, 0.5, 1]) @ CAMERA_MATRIX).tolist())
    for parts in (("image", "points"), ("points",)):  # sizes count where pixels are not read, too
        with pytest.raises(FileError, match=r"is 188x621 .*, expected 375x1242 as in a.jpg"):
            open_dataset(tmp_path, parts=parts)[1]
    assert "is 188x621" in str(next(iter(check_tree(tmp_path))))
    (tmp_path / "calibration").mkdir()
    (tmp_path / "calibration" / "b.yaml").write_text(yaml.safe_dump(own))
    first, second = (open_dataset(tmp_path)[at] for at in (0, 1))
    assert (first.image_size, second.image_size) == ((375, 1242), (188, 621))
    assert len(second.points) == len(POINTS[::7])
    assert list(check_tree(tmp_path)) == []


@pytest.mark.parametrize("folder", ["images", "points"])
def test_a_recording_of_one_sensor_is_opened_and_has_no_problems(tmp_path, folder):
    write_recording(tmp_path)
    shutil.rmtree(tmp_path / folder)
    write_calibration(tmp_path, image_size={"width": 1242, "height": 375})
    sample = open_dataset(tmp_path)[0]
    assert (sample.image is None, sample.points is None) == (folder == "images", folder == "points")
    assert sample.image_size == (375, 1242)
    assert list(check_tree(tmp_path)) == []
    with pytest.raises(ValueError, match=rf"lacks {folder} of 2 of 2 frames \(a, b\)"):
        open_dataset(tmp_path, parts=("image", "points"))


def test_labels_that_some_frames_lack_may_be_written_empty(tmp_path):
    write_recording(tmp_path)
    (tmp_path / "labels").mkdir()
    said = "or write an empty label file for each frame without objects"
    with pytest.raises(ValueError, match="labels of 2 of 2 frames") as caught:
        RecordingDataset(tmp_path)
    assert said not in str(caught.value)
    shutil.copy(LABELS, tmp_path / "labels" / "a.txt")
    with pytest.raises(ValueError, match=rf"labels of 1 of 2 frames \(b\); .*, {said}"):
        RecordingDataset(tmp_path)
    assert said in str(next(iter(check_tree(tmp_path))))


def test_a_lens_is_made_good_for_only_where_that_is_asked_for(tmp_path):
    lens = {"model": "plumb_bob", "coefficients": [-0.2, 0.05, 0, 0]}
    write_recording(tmp_path, ("a",), picture=".png", lens=lens)
    with pytest.raises(FileError, match=r"lens has distortion, .* write `undistort: true`"):
        open_dataset(tmp_path)[0]
    write_calibration(tmp_path, lens=lens | {"undistort": True})
    straight = open_dataset(tmp_path)[0].image.permute(1, 2, 0).numpy()
    expected = cv2.undistort(IMAGE, CAMERA_MATRIX, np.array(lens["coefficients"]))
    assert np.abs(straight.astype(int) - expected).mean() < 0.5


def test_frames_are_chosen_by_name_and_absent_ones_named(tmp_path):
    write_recording(tmp_path)
    assert open_dataset(tmp_path, sample_list=("b",)).sample_ids == ("b",)
    with pytest.raises(ValueError, match=r"has no frame c: .*there are 2, from a to b"):
        open_dataset(tmp_path, sample_list=("c",))


def test_a_line_of_times_that_is_none_is_named(tmp_path):
    write_recording(tmp_path, ("a",))
    (tmp_path / "times.txt").write_text("a 1\n12\n")
    with pytest.raises(FileError, match=r"times.txt: line 2 has no frame name and time"):
        open_dataset(tmp_path)


def test_names_end_in_any_case_and_hold_any_characters(tmp_path):
    write_recording(tmp_path, ("Füße 2",))
    (tmp_path / "images" / "Füße 2.jpg").rename(tmp_path / "images" / "Füße 2.Jpg")
    (tmp_path / "points" / "Füße 2.pcd").rename(tmp_path / "points" / "Füße 2.PCD")
    sample = open_dataset(tmp_path, needs=("image", "points"))[0]
    assert sample.sample_id == "Füße 2"


def test_images_and_clouds_of_different_names_are_told_once(tmp_path):
    write_recording(tmp_path, ("1", "2"))
    for path in list((tmp_path / "points").iterdir()):
        path.rename(path.with_name(f"000{path.name}"))
    with pytest.warns(UserWarning, match=r"no image and cloud of one name: images are called 1 "):
        open_dataset(tmp_path)
    (problem,) = check_tree(tmp_path)
    assert "clouds 0001 .." in problem.problem
    assert problem.remedy == "give the files of a frame one name"


def test_a_file_that_another_of_its_name_hides_is_told_by_check_and_on_opening(tmp_path, recwarn):
    write_recording(tmp_path, ("1", "2"))
    (tmp_path / "images" / "1.jpeg").write_bytes(b"")
    (tmp_path / "images" / "2.JPG").write_bytes(b"")
    (tmp_path / "points" / "2.bin").write_bytes(b"")  # an empty sweep, taken before 2.pcd
    (tmp_path / "calibration.json").write_text("{}")
    problems = list(check_tree(tmp_path))
    hidden = ["1.jpeg", "2.JPG", "2.pcd", "calibration.json"]
    assert [problem.path.name for problem in problems] == hidden
    assert problems[2].problem == "is not read, because 2.bin has the same name"
    open_dataset(tmp_path)
    said = "\n".join(str(warning.message) for warning in recwarn)
    assert f"{problems[0]} (2 like it)" in said
    assert str(problems[2]) in said
    assert str(problems[3]) in said


def test_frames_of_one_sensor_each_are_no_misnamed_ones_where_others_have_both(tmp_path, recwarn):
    write_recording(tmp_path, ("both", "dark", "deaf"))
    next((tmp_path / "images").glob("dark.*")).unlink()
    next((tmp_path / "points").glob("deaf.*")).unlink()
    assert len(open_dataset(tmp_path, sample_list=("dark", "deaf"), needs=())) == 2
    assert not recwarn.list


@pytest.mark.parametrize("content", [b"", b"no picture"])
def test_a_damaged_first_image_is_told_of_once_and_keeps_no_other_from_being_read(
    tmp_path, content
):
    write_recording(tmp_path, ("a", "b", "c"))
    (tmp_path / "images" / "a.jpg").write_bytes(content)
    (problem,) = check_tree(tmp_path)
    assert problem.path == tmp_path / "images" / "a.jpg"
    assert "neither a PNG nor a JPEG" in problem.problem
    assert open_dataset(tmp_path)[1].image_size == IMAGE.shape[:2]


def test_check_looks_at_depth_labels_and_times_too(tmp_path):
    write_recording(tmp_path, ("a", "b"))
    write_depth_png(tmp_path / "depth" / "a.png", np.ones((10, 20)))
    (tmp_path / "depth" / "b.png").write_bytes(b"no PNG")
    (tmp_path / "labels").mkdir()
    for name in "ab":
        line = "Car 0 0 0 10 10 5 5 1 1 1 1 1 9 0\n"
        (tmp_path / "labels" / f"{name}.txt").write_text(line if name == "b" else "")
    (tmp_path / "times.txt").write_text("a\t1\nb two\n")
    problems = {problem.path.name: problem.problem for problem in check_tree(tmp_path)}
    assert "is 10x20 (height x width), expected 375x1242" in problems["a.png"]
    assert "neither a PNG nor a JPEG" in problems["b.png"]
    assert "2D box with its maximum below its minimum" in problems["b.txt"]
    assert "line 2: value 1 is 'two'" in problems["times.txt"]


def test_an_image_of_another_size_is_told_beside_labels_that_do_not_fit_it(tmp_path):
    write_recording(tmp_path, ("a", "b"))
    write_rgb(tmp_path / "images" / "b.jpg", cv2.resize(IMAGE, (621, 188)))
    (tmp_path / "labels").mkdir()
    line = "Car 0 0 0 700 200 1100 300 1.5 1.6 4 5 1.6 20 0\n"
    for name in "ab":
        (tmp_path / "labels" / f"{name}.txt").write_text(line)
    problems = {problem.path.name: problem.problem for problem in check_tree(tmp_path)}
    assert problems.keys() == {"b.jpg", "b.txt"}
    assert "is 188x621 (height x width), expected 375x1242" in problems["b.jpg"]


def test_images_that_lie_on_their_side_are_told_to_be_turned(tmp_path):
    upright = CAMERA_MATRIX[[1, 0, 2]][:, [1, 0, 2]].tolist()
    write_recording(
        tmp_path, ("a",), camera_matrix=upright, image_size={"width": 375, "height": 1242}
    )
    problems = {problem.path.name: problem for problem in check_tree(tmp_path)}
    assert problems.keys() == {"a.jpg", "calibration.yaml"}
    assert problems["a.jpg"].remedy.startswith("rotate it as when the camera was calibrated")
    assert "or images turned by 90 degrees" in problems["calibration.yaml"].problem


def test_an_image_size_with_width_and_height_exchanged_is_told_once_and_its_remedy_works(tmp_path):
    write_recording(tmp_path, ("a",), image_size={"width": 375, "height": 1242})
    (problem,) = check_tree(tmp_path)
    assert problem.path.name == "calibration.yaml"
    assert problem.problem.startswith("image_size has width 375 and height 1242, but camera_matrix")
    assert "image 1242 wide and 375 high: exchange width and height" in problem.problem
    with pytest.raises(ValueError, match=r"calibration.yaml: image_size has width 375"):
        open_dataset(tmp_path)[0]
    write_calibration(tmp_path, image_size={"width": 1242, "height": 375})
    assert open_dataset(tmp_path)[0].image_size == (375, 1242)


def test_a_cloud_of_which_nothing_is_left_is_a_problem_of_check(tmp_path):
    write_recording(tmp_path, ("a", "b"), cloud=".npy")
    np.save(tmp_path / "points" / "a.npy", np.full((50, 4), np.nan))
    np.save(tmp_path / "points" / "b.npy", np.zeros((0, 4)))  # a sweep of zero points is a sweep
    with (
        pytest.warns(UserWarning, match="none is left"),
        pytest.warns(UserWarning, match="b.npy: holds no point, of 2 point clouds"),
    ):
        (problem,) = check_tree(tmp_path)
    assert problem.path.name == "a.npy"
    assert problem.problem == "holds no point: all 50 rows are not finite or at 0, 0, 0"


@pytest.mark.parametrize(
    ("intensities", "said"),
    [
        (np.linalg.norm(POINTS[:, :3], axis=1), "intensities are the points' distances"),
        (np.full(len(POINTS), 7), "all intensities are 7, so reflectances"),
        (POINTS[:, 3], "intensities are below a hundredth of max"),
    ],
)
def test_intensities_without_use_are_a_problem_of_check_and_told_on_opening(
    tmp_path, recwarn, intensities, said
):
    write_recording(tmp_path)
    cloud = tmp_path / "points" / "a.npy"
    (tmp_path / "points" / "a.pcd").unlink()
    np.save(cloud, np.column_stack((POINTS[:, :3], intensities)))
    assert list(summarize_tree(tmp_path))
    (problem,) = check_tree(tmp_path)
    assert problem.path == cloud
    assert problem.problem.startswith(said)
    assert not recwarn.list
    with pytest.warns(UserWarning, match=f"a.npy: {said}"):
        open_dataset(tmp_path)
    np.save(cloud, POINTS * np.float32([1, 1, 1, 0]))  # the LiDAR measures none
    assert not list(check_tree(tmp_path))


def test_recordings_travel_between_processes(tmp_path):
    write_recording(tmp_path, ("a",))
    copy = pickle.loads(pickle.dumps(open_dataset(tmp_path)))
    assert torch.equal(copy[0].points, open_dataset(tmp_path)[0].points)


def test_a_lens_that_folds_its_images_is_told_by_check_and_named_on_reading(tmp_path):
    lens = {"coefficients": [-5, 0, 0, 0], "undistort": True}
    write_recording(tmp_path, ("a",), lens=lens)
    (problem,) = [each for each in check_tree(tmp_path) if "lens" in each.problem]
    assert problem.path == tmp_path / "calibration.yaml"
    assert "folds the picture of 375x1242" in problem.problem
    with pytest.raises(FileError, match=r"images/a.jpg: cannot be undistorted: the lens folds"):
        RecordingDataset(tmp_path, needs=())[0]
