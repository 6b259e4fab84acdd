import json
import math
import pickle
import shutil
import warnings

import cv2
import numpy as np
import pytest
import torch
import yaml
from scipy.spatial.transform import Rotation

from sightline.data.check import check_tree, summarize_tree
from sightline.data.image_file import write_rgb
from sightline.data.kitti_calibration import CalibrationMatrices
from sightline.data.map_png import write_depth_png
from sightline.data.open import open_dataset
from sightline.data.recording import RecordingDataset
from sightline.data.recording_calibration import (
    RecordingCalibration,
    read_recording_calibration,
    recording_calibration_text,
)
from sightline.files.problem import FileError
from sightline.geometry.tilt import Tilt
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.level import level_sample
from tests.data.recordings import (
    CAMERA_FROM_LIDAR,
    CAMERA_MATRIX,
    IMAGE,
    POINTS,
    SAMPLE,
    calibration_entries,
    write_cloud_file,
    write_recording,
)

LABELS = PACKAGED_FRAMES / "training" / "label_2" / "000000.txt"


def rewrite_calibration(folder, **changes):
    text = yaml.safe_dump(calibration_entries(**changes))
    (folder / "calibration.yaml").write_text(text)


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
    with pytest.raises(FileError, match=r"is 188x621 .*, expected 375x1242 as in a.jpg"):
        open_dataset(tmp_path)[1]
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
    rewrite_calibration(tmp_path, image_size={"width": 1242, "height": 375})
    sample = open_dataset(tmp_path)[0]
    assert (sample.image is None, sample.points is None) == (folder == "images", folder == "points")
    assert sample.image_size == (375, 1242)
    assert list(check_tree(tmp_path)) == []
    with pytest.raises(ValueError, match=rf"lacks {folder} of 2 of 2 frames \(a, b\)"):
        open_dataset(tmp_path, parts=("image", "points"))


def test_a_lens_is_made_good_for_only_where_that_is_asked_for(tmp_path):
    lens = {"model": "plumb_bob", "coefficients": [-0.2, 0.05, 0, 0]}
    write_recording(tmp_path, ("a",), picture=".png", lens=lens)
    with pytest.raises(FileError, match=r"lens has distortion, .* write `undistort: true`"):
        open_dataset(tmp_path)[0]
    rewrite_calibration(tmp_path, lens=lens | {"undistort": True})
    straight = open_dataset(tmp_path)[0].image.permute(1, 2, 0).numpy()
    expected = cv2.undistort(IMAGE, CAMERA_MATRIX, np.array(lens["coefficients"]))
    assert np.abs(straight.astype(int) - expected).mean() < 0.5


TURNED = {
    "is probably inverted": np.linalg.inv(CAMERA_FROM_LIDAR),
    "has the identity for its rotation": np.eye(4),
    "has its axes swapped": np.diag([1.0, -1, -1, 1]) @ CAMERA_FROM_LIDAR,
    "probably in degrees where radians": None,
    "probably in millimetres": CAMERA_FROM_LIDAR * np.array([[1, 1, 1, 1000]] * 3 + [[1] * 4]),
}


@pytest.mark.parametrize("cause", TURNED)
def test_each_mistake_in_a_mount_is_named_by_opening_and_by_check(tmp_path, cause):
    wrong = TURNED[cause]
    if wrong is None:  # R = Rz(90 rad) .. instead of degrees
        wrong = CAMERA_FROM_LIDAR.copy()
        angles_deg = Rotation.from_matrix(wrong[:3, :3]).as_euler("XYZ", degrees=True)
        wrong[:3, :3] = Rotation.from_euler("XYZ", angles_deg).as_matrix()
    write_recording(tmp_path, ("a",), camera_from_lidar=wrong.tolist())
    with pytest.warns(UserWarning, match=cause):
        open_dataset(tmp_path)
    (problem,) = check_tree(tmp_path)
    assert cause in problem.problem
    assert problem.path == tmp_path / "calibration.yaml"


def boxes_of_cars(sample):
    return sample.objects.boxes3d.tensor[sample.objects.has_box3d]


@pytest.mark.parametrize("yaw_deg", [8, -50, 90, 179])
def test_a_lidar_that_is_mounted_turned_keeps_its_frame_and_its_level_one_looks_ahead(
    tmp_path, yaw_deg
):
    old_from_new = np.eye(4)
    old_from_new[:3, :3] = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()
    mounted = CAMERA_FROM_LIDAR @ old_from_new.T
    write_recording(tmp_path, ("a",), cloud=".npy", camera_from_lidar=mounted.tolist())
    places = POINTS[:, :3].astype(np.float64) @ old_from_new[:3, :3].T
    write_cloud_file(
        tmp_path / "points" / "a.npy", np.column_stack((places, POINTS[:, 3])).astype(np.float32)
    )
    (tmp_path / "labels").mkdir()
    shutil.copy(LABELS, tmp_path / "labels" / "a.txt")
    mounted_sample = open_dataset(tmp_path)[0]
    torch.testing.assert_close(
        mounted_sample.points[:, :3].double(), torch.from_numpy(places), rtol=0, atol=2e-5
    )
    sample = level_sample(mounted_sample)
    torch.testing.assert_close(sample.points, SAMPLE.points, rtol=0, atol=2e-5)
    ours, true = sample.calibration.image_from_lidar, SAMPLE.calibration.image_from_lidar
    torch.testing.assert_close(ours, true, rtol=0, atol=1e-9)
    boxes, expected = sample.objects.boxes3d.tensor, SAMPLE.objects.boxes3d.tensor
    # KITTI's files are of camera 0, whose centre is not the recording's.
    torch.testing.assert_close(boxes[:, 3:], expected[:, 3:], rtol=0, atol=1e-9)
    turned = boxes_of_cars(mounted_sample)[:, 6] - boxes_of_cars(sample)[:, 6]
    turned = torch.rad2deg(turned) - yaw_deg
    torch.testing.assert_close((turned + 180) % 360, torch.full_like(turned, 180))
    assert list(check_tree(tmp_path)) == []
    (summary,) = summarize_tree(tmp_path)
    assert f"the camera looks {yaw_deg} degrees (counter-clockwise)" in str(summary)


def test_points_that_the_image_does_not_show_are_told_with_their_share(tmp_path):
    write_recording(tmp_path, ("a",), cloud=".npy")
    write_cloud_file(tmp_path / "points" / "a.npy", POINTS * np.float32([-1, -1, 1, 1]))
    with pytest.warns(UserWarning, match=r"projects only \d+ of the \d+ points of frame a into"):
        open_dataset(tmp_path)
    assert len(list(check_tree(tmp_path))) == 1


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"camera_matrix": [[1, 0], [0, 1]]},
            "camera_matrix is invalid, expected a matrix of 3x3 or 3x4 numbers",
        ),
        ({"camera_matrix": CAMERA_MATRIX.T.tolist()}, "expected 0 0 1: it is probably transposed"),
        ({"camera_matrix": (-CAMERA_MATRIX).tolist()}, "third row"),
        ({"camera_from_lidar": CAMERA_FROM_LIDAR.T.tolist()}, "0 0 0 1: it is probably transposed"),
        ({"camera_from_lidar": [[float("nan")] * 4] * 3}, "holds NaN, infinite or absurdly large"),
        ({"camera_from_lidar": [[0] * 4] * 3}, "holds no rotation"),
        ({"max_intensity": "bright"}, "max_intensity is invalid, expected a positive number"),
        ({"lidar_height_m": 173}, "lidar_height_m is 173, expected the LiDAR's height above"),
        ({"lidar_height_m": 10**400}, "lidar_height_m is 1000"),
        ({"lidar_tilt_deg": 3}, "lidar_tilt_deg is 3, expected {roll: .., pitch: ..}"),
        ({"lidar_tilt_deg": {"roll": 3}}, "expected {roll: .., pitch: ..}"),
        ({"lidar_tilt_deg": {"roll": 3, "pitch": 90}}, "each from -45 to 45"),
        ({"lidar_tilt_deg": {"roll": 3, "pitch": math.nan}}, "each from -45 to 45"),
        ({"lidar_tilt_deg": {"roll": True, "pitch": 0}}, "expected {roll: .., pitch: ..}"),
        ({"camera_matrix": [[10**400] * 3] * 3}, "NaN, infinite or absurdly large values"),
        ({"camera_matrix": [["700", 0, 5]] * 3}, "camera_matrix holds '700', expected numbers"),
        ({"camera_matrix": [[True, 0, 5]] * 3}, "camera_matrix holds True, expected numbers"),
        ({"camera_matrix": [[None, 0, 5]] * 3}, "camera_matrix holds None, expected numbers"),
        (
            {"camera_matrix": [[0] * 9]},
            "camera_matrix is invalid, expected a matrix of 3x3 or 3x4 numbers",
        ),
        ({"camera_matrix": np.zeros((3, 3)).tolist()}, "only zeros: the camera is not"),
        ({"image_size": [375, 1242]}, "image_size is invalid, expected {width: .., height: ..}"),
        ({"image_size": {"width": 0, "height": 1}}, "expected width and height in whole pixels"),
        (
            {"image_size": {"width": True, "height": True}},
            "expected width and height in whole pixels",
        ),
        ({"lens": [0.1]}, "lens is invalid, expected"),
        ({"camera_matrix": [[7e-1, 0, 5], [0, 7e-1, 5], [0, 0, 1]]}, "are probably in millimetres"),
        ({"camera_matrix": [[7e3, 0, 5], [0, 7, 5], [0, 0, 1]]}, "expected both alike"),
        ({"image_size": {"width": 60000, "height": 60000}}, "image_size is 60000x60000, more than"),
        (
            {
                "image_size": {"width": 1242, "height": 375},
                "lens": {"coefficients": [-5, 0, 0, 0], "undistort": True},
            },
            "lens folds the picture of 375x1242 over itself",
        ),
        ({"lens": {"coefficients": "1234"}}, "lens has invalid coefficients, expected a list"),
        ({"lens": {"coefficients": [10**400] * 4}}, "expected 4 or 5 finite numbers"),
        ({"lens": {"coefficients": ["0.1"] * 4}}, "lens: coefficients holds '0.1', expected"),
        (
            {"lens": {"coefficients": [0.1]}},
            "expected 4 or 5 finite numbers for the model plumb_bob",
        ),
        (
            {"lens": {"coefficients": [0.1] * 4, "model": "pinhole"}},
            "lens has the unknown model 'pinhole', expected one of",
        ),
        ({"focal": 3}, "has the unknown entry 'focal'"),
    ],
)
def test_a_calibration_that_makes_no_sense_is_refused_by_file_and_entry(tmp_path, changes, said):
    write_recording(tmp_path, ("a",))
    rewrite_calibration(tmp_path, **changes)
    with pytest.raises(FileError) as caught:
        read_recording_calibration(tmp_path / "calibration.yaml")
    assert said in caught.value.problem.problem
    (problem,) = check_tree(tmp_path)
    assert said in problem.problem


@pytest.mark.parametrize("text", ["", "[1, 2]", "{", "a: [b", "\x00", "- !!python/object:x {}"])
def test_what_is_no_calibration_file_is_refused(tmp_path, text):
    path = tmp_path / "calibration.yaml"
    path.write_text(text)
    with pytest.raises(FileError, match=r"docs/recordings.md|holds a NUL byte"):
        read_recording_calibration(path)


def test_a_calibration_is_written_so_that_it_is_read_back_bit_by_bit(tmp_path):
    path = tmp_path / "calibration.yaml"
    lens = {"model": "equidistant", "coefficients": [0.1, 1e-7, 0, 0.3], "undistort": True}
    changes = {"lens": lens, "image_size": {"width": 1242, "height": 375}, "lidar_height_m": 2.1}
    changes["lidar_tilt_deg"] = {"roll": 0.5, "pitch": -11.25}
    path.write_text(yaml.safe_dump(calibration_entries(**changes)))
    read = read_recording_calibration(path)
    path.write_text(recording_calibration_text(read))
    again = read_recording_calibration(path)
    for name in ("image_from_camera", "camera_from_lidar"):
        ours, theirs = getattr(read.matrices, name), getattr(again.matrices, name)
        np.testing.assert_array_equal(ours, theirs)
    assert (again.image_size, again.max_intensity) == ((375, 1242), 255)
    assert again.lidar_height_m == 2.1
    assert again.lidar_tilt == Tilt(roll_deg=0.5, pitch_deg=-11.25)
    assert (again.lens.model, again.lens.coefficients) == ("equidistant", (0.1, 1e-7, 0.0, 0.3))


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


def test_a_calibration_that_was_corrected_is_read_again(tmp_path):
    write_recording(tmp_path, ("a",))
    assert open_dataset(tmp_path)[0].calibration.camera_from_lidar[0, 3] != 0.5
    moved = CAMERA_FROM_LIDAR.copy()
    moved[0, 3] = 0.5
    rewrite_calibration(tmp_path, camera_from_lidar=moved.tolist())
    assert open_dataset(tmp_path)[0].calibration.camera_from_lidar[0, 3] == 0.5


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


def test_a_recording_without_a_calibration_is_known_as_one(tmp_path):
    write_recording(tmp_path, ("a",))
    (tmp_path / "calibration.yaml").unlink()
    with pytest.raises(ValueError, match=r"without a calibration; write calibration.yaml beside"):
        open_dataset(tmp_path)
    (problem,) = check_tree(tmp_path)
    assert problem.problem == "holds images or points without a calibration"


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
    write_recording(tmp_path, ("a",), image_size={"width": 375, "height": 1242})
    (problem,) = check_tree(tmp_path)
    assert problem.remedy.startswith("rotate it as when the camera was calibrated")


def test_the_height_of_the_lidar_is_that_of_the_file_or_told_by_some_clouds(tmp_path):
    write_recording(tmp_path, ("a", "b", "c"), cloud=".npy")
    write_cloud_file(tmp_path / "points" / "b.npy", POINTS[:25])  # shows no road
    assert open_dataset(tmp_path, sample_list=("b",))[0].lidar_height_m == pytest.approx(
        1.73, abs=0.1
    )
    rewrite_calibration(tmp_path, lidar_height_m=2.31)
    with pytest.warns(UserWarning, match=r"lidar_height_m is 2.31, but the road .* gives 1.7"):
        assert open_dataset(tmp_path)[0].lidar_height_m == 2.31
    (summary,) = summarize_tree(tmp_path)
    assert "above it" not in str(summary)
    assert "warning: lidar_height_m is 2.31" in str(summary)
    rewrite_calibration(tmp_path)
    for place, name in enumerate("abc"):
        write_cloud_file(tmp_path / "points" / f"{name}.npy", POINTS[: 25 + place])
    with pytest.warns(UserWarning, match=r"too little of the road .*: KITTI's 1.73 m is"):
        assert open_dataset(tmp_path)[0].lidar_height_m is None
    (summary,) = summarize_tree(tmp_path)
    assert "warning: its clouds show too little of the road" in str(summary)
    assert "KITTI's 1.73 m is assumed" in str(summary)


def test_the_height_is_not_spoken_of_where_no_cloud_can_be_read(tmp_path):
    write_recording(tmp_path, ("a",), cloud=".npy")
    for content in (b"nothing", None):
        path = tmp_path / "points" / "a.npy"
        path.write_bytes(content) if content else np.save(path, np.full((50, 4), np.nan))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            open_dataset(tmp_path)
        assert not any("road" in str(each.message) for each in caught)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            (summary,) = summarize_tree(tmp_path)
        assert "road" not in str(summary)
        cause = "1 of 1 checked clouds cannot be read" if content else "checked clouds are empty"
        assert cause in str(summary)


def test_the_height_by_the_road_is_told_beside_a_given_one(tmp_path):
    write_recording(tmp_path, ("a", "b", "c"), cloud=".npy")
    rewrite_calibration(tmp_path, lidar_height_m=2.0)
    (summary,) = summarize_tree(tmp_path)
    assert "lidar_height_m is 2; by the road in its clouds the LiDAR is 1.7" in str(summary)


def test_a_principal_point_of_another_image_is_told_on_opening(tmp_path):
    write_recording(tmp_path, ("1", "2"))
    rewrite_calibration(tmp_path, camera_matrix=[[720, 0, 200], [0, 720, 180], [0, 0, 1]])
    with pytest.warns(UserWarning, match="has its principal point at"):
        open_dataset(tmp_path)


def test_a_cloud_of_which_nothing_is_left_is_a_problem_of_check(tmp_path):
    write_recording(tmp_path, ("a", "b"), cloud=".npy")
    np.save(tmp_path / "points" / "a.npy", np.full((50, 4), np.nan))
    np.save(tmp_path / "points" / "b.npy", np.zeros((0, 4)))  # a sweep of zero points is a sweep
    with pytest.warns(UserWarning, match="none is left"):
        (problem,) = check_tree(tmp_path)
    assert problem.path.name == "a.npy"
    assert problem.problem == "holds no point: all 50 rows are not finite or at 0, 0, 0"


def write_tilted_recording(folder, tilt, **changes):
    lidar_from_level = tilt.level_from_lidar.T
    mounted = CAMERA_FROM_LIDAR @ tilt.level_from_lidar
    write_recording(folder, ("a", "b", "c"), camera_from_lidar=mounted.tolist(), **changes)
    places = POINTS[:, :3].astype(np.float64) @ lidar_from_level[:3, :3].T
    cloud = np.column_stack((places, POINTS[:, 3])).astype(np.float32)
    for place, name in enumerate("abc"):
        write_cloud_file(folder / "points" / f"{name}.pcd", cloud[: len(cloud) - place])
    (folder / "labels").mkdir()
    for name in "abc":
        shutil.copy(LABELS, folder / "labels" / f"{name}.txt")


@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(3.0, 12.0), (0.0, -8.0), (-10.0, 0.0)])
def test_a_tilted_lidar_is_found_by_the_road_said_and_levelled(tmp_path, roll_deg, pitch_deg):
    tilt = Tilt(roll_deg=roll_deg, pitch_deg=pitch_deg)
    write_tilted_recording(tmp_path, tilt)
    with pytest.warns(UserWarning, match="the road in its clouds shows that the LiDAR is tilted, "):
        dataset = open_dataset(tmp_path)
    found = dataset[0].level_from_lidar.numpy()
    assert found[2, :3] @ tilt.up > math.cos(math.radians(1.0))
    assert dataset[0].lidar_height_m == pytest.approx(1.73, abs=0.1)
    (summary,) = summarize_tree(tmp_path)
    assert "by the road in its clouds the LiDAR is tilted, " in str(summary)
    assert list(check_tree(tmp_path)) == []


def test_a_tilt_that_the_calibration_gives_is_taken_and_labels_match_in_the_level_frame(tmp_path):
    tilt = Tilt(roll_deg=3.0, pitch_deg=12.0)
    write_tilted_recording(tmp_path, tilt, lidar_tilt_deg={"roll": 3.0, "pitch": 12.0})
    sample = open_dataset(tmp_path)[0]
    assert sample.lidar_height_m == pytest.approx(1.73, abs=0.1)
    level = level_sample(sample)
    torch.testing.assert_close(level.points, SAMPLE.points, rtol=0, atol=2e-3)
    (tmp_path / "level").mkdir()
    write_recording(tmp_path / "level", ("a",))
    (tmp_path / "level" / "labels").mkdir()
    shutil.copy(LABELS, tmp_path / "level" / "labels" / "a.txt")
    expected = open_dataset(tmp_path / "level")[0].objects.boxes3d.tensor
    torch.testing.assert_close(level.objects.boxes3d.tensor, expected, rtol=0, atol=1e-9)
    assert (boxes_of_cars(sample)[:, 2] - boxes_of_cars(level)[:, 2]).abs().max() > 1


def test_a_tilt_that_the_road_contradicts_is_told(tmp_path):
    write_recording(tmp_path, ("a",), lidar_tilt_deg={"roll": 0, "pitch": 12})
    (summary,) = summarize_tree(tmp_path)
    assert "by its calibration the LiDAR is tilted, 12.0 degrees nose down" in str(summary)
    assert "warning: lidar_tilt_deg is 12.0 degrees nose down" in str(summary)
    with pytest.warns(UserWarning, match="but the road in the sweeps gives none"):
        open_dataset(tmp_path)


def test_clouds_with_z_down_are_told_to_be_converted_with_their_calibration(tmp_path):
    turn = np.diag([1.0, -1, -1, 1])
    down = POINTS * np.float32([1, -1, -1, 1])
    both, cloud_alone = tmp_path / "both", tmp_path / "cloud"
    write_recording(both, ("a",), camera_from_lidar=(CAMERA_FROM_LIDAR @ turn).tolist())
    write_recording(cloud_alone, ("a",))
    for folder, said in (
        (both, "convert both, points and"),
        (cloud_alone, "convert only the points"),
    ):
        write_cloud_file(folder / "points" / "a.pcd", down)
        with pytest.warns(UserWarning, match=said):
            open_dataset(folder)
        problems = [each for each in check_tree(folder) if said in each.remedy]
        assert problems, said
        assert "-z points up" in problems[0].problem
        assert problems[0].path == folder / "points" / "a.pcd"


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_camera_matrix_of_another_resolution_is_told_once(tmp_path, factor):
    camera = np.diag([factor, factor, 1]) @ CAMERA_MATRIX
    write_recording(tmp_path, camera_matrix=camera.tolist())
    with pytest.warns(UserWarning, match="it is for another resolution"):
        open_dataset(tmp_path)
    (problem,) = check_tree(tmp_path)
    assert problem.path == tmp_path / "calibration.yaml"
    assert "but images are 375x1242" in problem.problem


def test_recordings_travel_between_processes(tmp_path):
    write_recording(tmp_path, ("a",))
    copy = pickle.loads(pickle.dumps(open_dataset(tmp_path)))
    assert torch.equal(copy[0].points, open_dataset(tmp_path)[0].points)


@pytest.mark.parametrize("focal_px", [0.0, -700.0, 1e308, math.nan, math.inf])
def test_a_calibration_that_no_reader_takes_is_not_written(focal_px):
    camera = np.pad(CAMERA_MATRIX.copy(), ((0, 0), (0, 1)))
    camera[0, 0] = camera[1, 1] = focal_px
    matrices = CalibrationMatrices(image_from_camera=camera, camera_from_lidar=CAMERA_FROM_LIDAR)
    with pytest.raises(ValueError, match=r"camera_matrix (holds NaN|has focal lengths)"):
        recording_calibration_text(RecordingCalibration(matrices=matrices))


def test_a_lens_that_folds_its_images_is_told_by_check_and_named_on_reading(tmp_path):
    lens = {"coefficients": [-5, 0, 0, 0], "undistort": True}
    write_recording(tmp_path, ("a",), lens=lens)
    (problem,) = [each for each in check_tree(tmp_path) if "lens" in each.problem]
    assert problem.path == tmp_path / "calibration.yaml"
    assert "folds the picture of 375x1242" in problem.problem
    with pytest.raises(FileError, match=r"images/a.jpg: cannot be undistorted: the lens folds"):
        RecordingDataset(tmp_path, needs=())[0]
