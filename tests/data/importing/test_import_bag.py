import re
import shutil

import cv2
import numpy as np
import pytest
import torch
import yaml
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin

from sightline.cli.main import main
from sightline.data.check import check_tree
from sightline.data.formats.image_file import read_rgb
from sightline.data.formats.recording_calibration import read_recording_calibration
from sightline.data.importing import import_bag
from sightline.data.importing.bag import CLOUD, TRANSFORMS, kind_of, open_bag
from sightline.data.importing.bag_topics import choose_topics
from sightline.data.importing.import_recording import import_recording
from sightline.data.importing.writer import write_cloud
from sightline.data.open import open_dataset
from sightline.geometry.tilt import Tilt
from tests.data.recordings import (
    BASE_FROM_LIDAR,
    CAMERA_FROM_BASE,
    CAMERA_FROM_LIDAR,
    CAMERA_MATRIX,
    IMAGE,
    POINTS,
    SAMPLE,
    BagMaker,
    Ros1BagMaker,
    calibration_entries,
    usual_topics,
    write_bag,
    write_nuscenes,
)


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bags") / "drive", 2)


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_drive_comes_out_of_a_bag_as_it_was_simulated(tmp_path, storage):
    bag = write_bag(tmp_path / "drive", 2, storage=storage)
    report = import_recording(bag, tmp_path / "out")
    assert (report.written, report.skipped) == (2, 0)
    text = str(report)
    assert "paired 2 of 3 images and 2 sweeps by header time, 8.0 ms apart at most" in text
    assert "dropped 1 images and 0 sweeps" in text
    assert "% of the points of frame 000000 fall into the image" in text
    assert "warning" not in text
    dataset = open_dataset(tmp_path / "out")
    assert dataset.sample_ids == ("000000", "000001")
    sample = dataset[1]
    assert torch.equal(sample.points[:-1], SAMPLE.points[:-1])
    assert torch.equal(sample.image[:, 1:], SAMPLE.image[:, 1:])
    assert sample.timestamp_s == pytest.approx(0.1)
    ours, true = sample.calibration.image_from_lidar, SAMPLE.calibration.image_from_lidar
    torch.testing.assert_close(ours, true, rtol=0, atol=1e-9)


def test_a_lone_mcap_file_needs_no_metadata_and_check_has_no_complaint(bag, tmp_path, capsys):
    (path,) = bag.glob("*.mcap")
    assert main(["import", str(path), str(tmp_path / "out")]) == 0
    assert "2 frames written" in capsys.readouterr().out
    assert main(["check", str(tmp_path / "out")]) == 0
    assert "m above it\nno problems" in capsys.readouterr().out


def test_an_interrupted_import_goes_on_and_gives_the_same(bag, tmp_path, monkeypatch):
    import_recording(bag, tmp_path / "whole")

    def stop(out, *rest):
        if out == tmp_path / "out":  # not the staged first frame
            raise KeyboardInterrupt
        write_cloud(out, *rest)

    with monkeypatch.context() as patched:
        patched.setattr(import_bag, "write_cloud", stop)
        with pytest.raises(KeyboardInterrupt):
            import_recording(bag, tmp_path / "out")
    assert not list((tmp_path / "out" / "points").glob("*"))
    (told,) = [str(each) for each in check_tree(tmp_path / "out") if "times.txt" in str(each)]
    assert "times.txt: 1 of 2 lines name no frame (000001)" in told
    assert import_recording(bag, tmp_path / "out").written == 2
    (tmp_path / "out" / "images" / "000001.png").unlink()
    report = import_recording(bag, tmp_path / "out")
    assert (report.written, report.skipped) == (1, 1)
    for path in sorted((tmp_path / "whole").rglob("*")):
        other = tmp_path / "out" / path.relative_to(tmp_path / "whole")
        assert path.is_dir() or path.read_bytes() == other.read_bytes()


def test_a_bag_that_was_replaced_or_has_grown_does_not_mix_with_its_import(tmp_path):
    def record(name, number, since_s):
        with BagMaker(tmp_path / name) as bag:
            bag.transforms("/tf_static", 1, camera_optical__lidar=CAMERA_FROM_LIDAR)
            for at in range(number):
                time_ns = since_s * 10**9 + at * 10**8
                bag.info("/front/camera_info", time_ns)
                bag.image("/front/image_raw", time_ns)
                bag.cloud("/points", time_ns)
        (path,) = (tmp_path / name).glob("*.mcap")
        return path

    day = tmp_path / "day"
    day.mkdir()
    shutil.copy(record("late", 3, 200), day / "drive_2.mcap")
    import_recording(day, tmp_path / "out")
    before = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()}
    told = r"source_bytes \d+ instead of \d+, times_s 3 from 200\.0+ to 200\.2.* instead of"
    shutil.copy(record("early", 2, 100), day / "drive_1.mcap")
    with pytest.raises(ValueError, match=f"{told} 5 from 100"):
        import_recording(day, tmp_path / "out")
    (day / "drive_1.mcap").unlink()
    shutil.copy(record("other", 3, 100), day / "drive_2.mcap")
    with pytest.raises(ValueError, match=r"times_s 3 from 200.* instead of 3 from 100"):
        import_recording(day, tmp_path / "out")
    assert {path: path.read_bytes() for path in before} == before


def test_an_address_is_no_source():
    with pytest.raises(ValueError, match=r"^s3://bucket/drive is an address, and import reads"):
        import_recording("s3://bucket/drive", "out")


def test_another_import_does_not_mix_with_one_that_is_there(bag, tmp_path):
    import_recording(bag, tmp_path / "out")
    with pytest.raises(ValueError, match=r"made with max_gap_s 0\.05 instead of 0\.01"):
        import_recording(bag, tmp_path / "out", max_gap_s=0.01)


@pytest.mark.parametrize("further", [None, "compressedDepth", "zstd", "theora", "ffmpeg"])
def test_compressed_pictures_keep_their_bytes_and_come_before_other_copies(tmp_path, further):
    _, encoded = cv2.imencode(".jpg", IMAGE)
    with BagMaker(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 1, camera_optical__lidar=CAMERA_FROM_LIDAR)
        bag.info("/front/camera_info", 10**9)
        bag.image("/front/image_raw", 10**9)
        bag.jpeg("/front/image_raw/compressed", 10**9, encoded.tobytes())
        if further is not None:
            bag.jpeg(f"/front/image_raw/{further}", 10**9, encoded.tobytes())
        bag.cloud("/points", 10**9)
    import_recording(tmp_path / "drive", tmp_path / "out")
    assert (tmp_path / "out" / "images" / "000000.jpg").read_bytes() == encoded.tobytes()


def test_topics_that_are_counted_are_those_that_are_listed(tmp_path):
    _, encoded = cv2.imencode(".jpg", IMAGE)
    with BagMaker(tmp_path / "drive") as bag:
        for name in ("/left", "/right"):
            bag.image(f"{name}/image_raw", 10**9)
            bag.jpeg(f"{name}/image_raw/compressed", 10**9, encoded.tobytes())
    listed = "/left/image_raw/compressed (CompressedImage, 1), /right/image_raw/compressed"
    with pytest.raises(ValueError, match=re.escape("CompressedImage): " + listed)) as refused:
        import_recording(tmp_path / "drive", tmp_path / "out")
    assert "has 2 topics of images" in str(refused.value)


def test_lens_distortion_is_refused_and_straightened_on_request(tmp_path):
    lens = (-0.3, 0.1, 0.0, 0.0, 0.0)
    bag = write_bag(tmp_path / "drive", 1, distortion=lens)
    with pytest.raises(ValueError, match=r"/front/camera_info: the lens distorts .* --undistort"):
        import_recording(bag, tmp_path / "out")
    import_recording(bag, tmp_path / "out", undistort=True)
    raw = read_rgb(tmp_path / "out" / "images" / "000000.png")
    np.testing.assert_array_equal(raw[:, 1:], IMAGE[:, 1:])
    straight = open_dataset(tmp_path / "out")[0].image.permute(1, 2, 0).numpy()
    matrix = np.array(calibration_entries()["camera_matrix"])
    expected = cv2.undistort(IMAGE, matrix, np.array(lens))
    assert np.abs(straight.astype(int) - expected).mean() < 0.5


@pytest.mark.parametrize("write", [write_bag, write_nuscenes])
def test_straight_images_need_no_undistortion_and_that_is_told(tmp_path, write):
    write(tmp_path / "drive")
    for undistort in (True, False):
        report = import_recording(tmp_path / "drive", tmp_path / "out", undistort=undistort)
        assert ("--undistort has no effect" in str(report)) == undistort


@pytest.mark.parametrize("model", ["equidistant", "fisheye"])
def test_a_fisheye_of_zeros_is_no_pinhole(tmp_path, model):
    bag = write_bag(tmp_path / "drive", 1, distortion=(0.0,) * 4, model=model)
    with pytest.raises(ValueError, match=r"the lens distorts \(equidistant: 0, 0, 0, 0\)"):
        import_recording(bag, tmp_path / "out")
    import_recording(bag, tmp_path / "out", undistort=True)
    straight = open_dataset(tmp_path / "out")[0].image.permute(1, 2, 0).numpy()
    assert np.abs(straight.astype(int) - IMAGE).mean() > 5


@pytest.mark.parametrize("distortion", [(), (0.0,) * 5])
@pytest.mark.parametrize("model", ["", "none", "pinhole", "plumb_bob", "rational_polynomial"])
def test_a_pinhole_without_coefficients_is_straight(tmp_path, model, distortion):
    bag = write_bag(tmp_path / "drive", 1, distortion=distortion, model=model)
    import_recording(bag, tmp_path / "out")
    assert "lens" not in (tmp_path / "out" / "calibration.yaml").read_text()


def two_cameras(bag):
    for name in ("/left", "/right"):
        bag.info(f"{name}/camera_info", 10**9)
        bag.image(f"{name}/image_raw", 10**9)
    bag.cloud("/points", 10**9)
    bag.transforms("/tf", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)


def no_sweep(bag):
    bag.info("/camera_info", 10**9)
    bag.image("/image_raw", 10**9)


def no_info(bag):
    bag.image("/front/image_raw", 10**9)
    bag.cloud("/points", 10**9)
    bag.transforms("/tf_static", 1, camera_optical__lidar=CAMERA_FROM_LIDAR)


def no_way(bag):
    bag.info("/front/camera_info", 10**9)
    bag.image("/front/image_raw", 10**9)
    bag.cloud("/points", 10**9)
    bag.transforms("/tf_static", 1, camera_optical__base=CAMERA_FROM_BASE)


def far_apart(bag):
    bag.info("/front/camera_info", 10**9)
    bag.transforms("/tf_static", 1, camera_optical__lidar=CAMERA_FROM_LIDAR)
    bag.image("/front/image_raw", 10**9)
    bag.cloud("/points", 9 * 10**9)


def without_z(bag):
    bag.info("/front/camera_info", 10**9)
    bag.transforms("/tf_static", 1, camera_optical__lidar=CAMERA_FROM_LIDAR)
    bag.image("/front/image_raw", 10**9)
    bag.cloud("/points", 10**9, names=("x", "y", "range", "intensity"))


def other_size(bag):
    bag.info("/front/camera_info", 10**9, size=(100, 200))
    bag.transforms("/tf_static", 1, camera_optical__lidar=CAMERA_FROM_LIDAR)
    bag.image("/front/image_raw", 10**9)
    bag.cloud("/points", 10**9)


def in_millimetres(bag):
    bag.info("/front/camera_info", 10**9)
    bag.transforms("/tf_static", 1, camera_optical__lidar=CAMERA_FROM_LIDAR)
    bag.image("/front/image_raw", 10**9)
    bag.cloud("/points", 10**9, points=POINTS * np.float32([1000, 1000, 1000, 1]))


def not_finite(bag):
    bag.info("/front/camera_info", 10**9)
    wrong = CAMERA_FROM_LIDAR.copy()
    wrong[0, 3] = np.nan
    bag.transforms("/tf_static", 1, camera_optical__lidar=wrong)
    bag.image("/front/image_raw", 10**9)
    bag.cloud("/points", 10**9)


def no_such_lens(bag):
    bag.info("/front/camera_info", 10**9, distortion=(0.1,) * 7)
    bag.image("/front/image_raw", 10**9)
    bag.cloud("/points", 10**9)


def an_unknown_lens(bag):
    bag.info("/front/camera_info", 10**9, model="ds")
    bag.image("/front/image_raw", 10**9)
    bag.cloud("/points", 10**9)


def a_fisheye_without_numbers(bag):
    bag.info("/front/camera_info", 10**9, model="equidistant", distortion=())
    bag.image("/front/image_raw", 10**9)
    bag.cloud("/points", 10**9)


def no_rectification(bag):
    bag.info("/front/camera_info", 10**9, rectification=np.diag((2.0, 2.0, 2.0)))
    bag.transforms("/tf_static", 1, camera_optical__lidar=CAMERA_FROM_LIDAR)
    bag.image("/front/image_rect", 10**9)
    bag.cloud("/points", 10**9)


def not_rectified_by_its_name(bag):
    bag.info("/front/camera_info", 10**9, distortion=(0.1,) * 5)
    bag.transforms("/tf_static", 1, camera_optical__lidar=CAMERA_FROM_LIDAR)
    bag.image("/front/image_direct", 10**9)
    bag.cloud("/points", 10**9)


@pytest.mark.parametrize(
    ("fill", "expected"),
    [
        (two_cameras, r"/left/image_raw \(Image, 1\), /right/.*; choose one by --camera-topic"),
        (no_sweep, r"no topic of clouds \(PointCloud2\); its topics are /camera_info"),
        (no_info, r"no CameraInfo of /front/image_raw; give a calibration file by --calibration"),
        (
            no_way,
            r"no chain from frame 'lidar' \(topic /points\) to 'camera_optical'.* has frames base",
        ),
        (far_apart, r"no image of /front/image_raw and .* 8 s apart .* --clock received or"),
        (without_z, r"topic /points: has the fields x, y, range, intensity, but not z"),
        (other_size, r"/front/image_raw: image 0 is 375x1242 .* calibration is for 100x200"),
        (in_millimetres, r"topic /points: .* probably in millimetres; write them in metres"),
        (not_finite, r"/tf_static: the transform of lidar in camera_optical holds NaN or infinite"),
        (
            no_such_lens,
            r"/front/camera_info: the lens has 7 distortion coefficients, .* --calibration",
        ),
        (an_unknown_lens, r"/front/camera_info: the lens model 'ds' is unknown; .*--calibration"),
        (a_fisheye_without_numbers, r"the lens has 0 distortion coefficients, expected 4 finite"),
        (no_rectification, r"topic /front/camera_info: R is no rotation"),
        (not_rectified_by_its_name, r"/front/camera_info: the lens distorts"),
    ],
)
def test_a_bag_that_cannot_be_used_is_one_line_with_topic_and_remedy(
    tmp_path, capsys, fill, expected
):
    with BagMaker(tmp_path / "drive") as bag:
        fill(bag)
    assert main(["import", str(tmp_path / "drive"), str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    with pytest.raises(ValueError, match=expected):
        raise ValueError(error)


def test_a_transform_elsewhere_that_is_none_and_a_size_that_is_not_told_do_no_harm(tmp_path):
    broken = np.eye(4)
    broken[0, 3] = np.nan
    with BagMaker(tmp_path / "drive") as bag:
        bag.info("/front/camera_info", 10**9, size=(0, 0))
        bag.transforms("/tf", 10**9, map__gripper=broken)
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        bag.image("/front/image_raw", 10**9)
        bag.cloud("/points", 10**9)
    import_recording(tmp_path / "drive", tmp_path / "out")
    assert open_dataset(tmp_path / "out")[0].image_size == IMAGE.shape[:2]


def test_the_scale_of_intensities_is_not_guessed_from_a_first_sweep_that_is_empty(tmp_path):
    with BagMaker(tmp_path / "drive") as bag:
        bag.info("/front/camera_info", 10**9)
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        for number in range(3):
            time_ns = (10 + number) * 10**8
            bag.image("/front/image_raw", time_ns)
            bag.cloud("/points", time_ns, points=None if number else POINTS[:0])
    report = import_recording(tmp_path / "drive", tmp_path / "out")
    assert "intensities of 0 to 255" in str(report)
    assert "of the points of frame 000001 fall into the image" in str(report)
    torch.testing.assert_close(open_dataset(tmp_path / "out")[1].points[:-1], SAMPLE.points[:-1])


def test_a_drive_that_was_split_into_files_is_one(tmp_path, bag):
    (path,) = bag.glob("*.mcap")
    later = tmp_path / "later"
    with BagMaker(later) as split:
        split.image("/front/image_raw", 10**10)
        split.cloud("/points", 10**10)
    (tmp_path / "split").mkdir()
    shutil.copy(path, tmp_path / "split" / "drive_0.mcap")
    next(later.glob("*.mcap")).rename(tmp_path / "split" / "drive_1.mcap")
    assert import_recording(tmp_path / "split", tmp_path / "out").written == 3


def test_a_camera_is_chosen_by_its_topic_with_the_calibration_beside_it(tmp_path):
    with BagMaker(tmp_path / "drive") as bag:
        two_cameras(bag)
    report = import_recording(tmp_path / "drive", tmp_path / "out", camera_topic="/right/image_raw")
    assert "camera /right/image_raw" in str(report)
    assert "calibration /right/camera_info" in str(report)


def test_a_calibration_file_replaces_what_a_bag_does_not_tell(tmp_path):
    with BagMaker(tmp_path / "drive") as bag:
        no_info(bag)
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(calibration_entries()))
    import_recording(tmp_path / "drive", tmp_path / "out", calibration=path)
    assert torch.equal(open_dataset(tmp_path / "out")[0].points[:-1], SAMPLE.points[:-1])


def test_a_damaged_bag_or_none_at_all_is_one_line(tmp_path, bag, capsys):
    (path,) = bag.glob("*.mcap")
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(path.read_bytes()[:5000])
    (tmp_path / "empty").mkdir()
    for source, expected in (
        (damaged, "cannot be read as a ROS bag|is damaged"),
        (tmp_path / "empty", "is neither a bag"),
        (tmp_path / "nowhere", "does not exist"),
    ):
        assert main(["import", str(source), str(tmp_path / "out")]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert any(part in error for part in expected.split("|"))


def matrix_of(folder):
    return np.array(yaml.safe_load((folder / "calibration.yaml").read_text())["camera_matrix"])


FULL = CAMERA_MATRIX * [[2], [3], [1]]
HEIGHT, WIDTH = IMAGE.shape[:2]
BINNED = {"matrix": FULL, "binning": (2, 3)}
SHIFTED = np.add(CAMERA_MATRIX, [[0, 0, 40], [0, 0, 30], [0, 0, 0]])


@pytest.mark.parametrize(
    "info",
    [
        {**BINNED, "size": (3 * HEIGHT, 2 * WIDTH)},
        {**BINNED, "size": (3 * HEIGHT + 1, 2 * WIDTH + 1)},
        {**BINNED, "size": (HEIGHT, WIDTH)},  # the images' own size beside the full matrix
        {**BINNED, "size": (0, 0)},
        {"size": (HEIGHT, WIDTH), "binning": (2, 2)},  # full images all the same
        {"matrix": SHIFTED, "size": (999, 1999), "region": (40, 30, HEIGHT, WIDTH)},
        {
            "matrix": SHIFTED * [[2], [2], [1]],
            "size": (2000, 4000),
            "region": (80, 60, 2 * HEIGHT, 2 * WIDTH),
            "binning": (2, 2),
        },
    ],
)
@pytest.mark.parametrize("picture", ["image_raw", "image_rect"])
def test_binning_and_region_of_camera_info_are_part_of_the_calibration(tmp_path, info, picture):
    with BagMaker(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        bag.info("/front/camera_info", 10**9, **info)
        bag.image(f"/front/{picture}", 10**9)
        bag.cloud("/points", 10**9)
    report = import_recording(tmp_path / "drive", tmp_path / "out")
    assert "CameraInfo has binning" in str(report)
    np.testing.assert_allclose(matrix_of(tmp_path / "out"), CAMERA_MATRIX)


def test_the_first_camera_info_that_is_a_calibration_is_taken_and_others_are_told(tmp_path):
    with BagMaker(tmp_path / "drive") as bag:
        for at, matrix in enumerate(
            (np.zeros((3, 3)), np.full((3, 3), np.nan), SHIFTED, CAMERA_MATRIX)
        ):
            bag.info("/front/camera_info", 10**9 + at, matrix=matrix)
        usual_topics(bag, infos=False)
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert (
        "2 of 4 messages of /front/camera_info are unusable or less usable than number 2" in report
    )
    assert "warning: 1 of 4 messages of /front/camera_info differ from number 2" in report
    np.testing.assert_array_equal(matrix_of(tmp_path / "out"), SHIFTED)


@pytest.mark.parametrize("focal", [0.0, -500.0, 1e308, np.inf])
def test_a_camera_info_that_no_reader_takes_is_refused_and_nothing_written(tmp_path, focal):
    matrix = CAMERA_MATRIX.copy()
    matrix[1, 1] = focal
    with BagMaker(tmp_path / "drive") as bag:
        usual_topics(bag, matrix=matrix)
    with pytest.raises(ValueError, match="topic /front/camera_info: camera_matrix"):
        import_recording(tmp_path / "drive", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("topic", ["/tf", "/tf_static"])
@pytest.mark.parametrize("length", [0.0, 0.5, np.nan])
def test_transforms_that_are_none_are_passed_over(tmp_path, topic, length):
    with BagMaker(tmp_path / "drive") as bag:
        bag.transforms(topic, 1, length=length, camera_optical__lidar=np.eye(4))
        bag.transforms(topic, 2, camera_optical__lidar=CAMERA_FROM_LIDAR)
        bag.info("/front/camera_info", 10**9)
        bag.image("/front/image_raw", 10**9)
        bag.cloud("/points", 10**9)
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert "left out 1 invalid transforms" in report
    assert torch.equal(open_dataset(tmp_path / "out")[0].points[:-1], SAMPLE.points[:-1])


def test_sensors_that_move_against_each_other_are_told(tmp_path):
    with BagMaker(tmp_path / "drive") as bag:
        usual_topics(bag)
        moved = CAMERA_FROM_LIDAR.copy()
        moved[0, 3] += 0.5
        bag.transforms("/tf", 3 * 10**9, camera_optical__lidar=moved)
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert "lidar moves relative to camera_optical in the drive, by 0.5 m" in report


@pytest.mark.parametrize(
    "spelling",
    [
        "sensor_msgs/PointCloud2",
        "sensor_msgs/msg/PointCloud2",
        "sensor_msgs::msg::dds_::PointCloud2_",
        "sensor_msgs/msg/pointcloud2",
    ],
)
def test_a_type_is_known_by_each_of_its_spellings(spelling):
    assert kind_of(spelling) == CLOUD
    assert kind_of("tf/tfMessage") == kind_of("tf2_msgs/TFMessage") == TRANSFORMS
    assert kind_of("my_msgs/msg/Image") == "my_msgs/msg/Image"


@pytest.mark.parametrize("compression", [None, *Ros1Writer.CompressionFormat])
def test_a_bag_of_ros_1_gives_the_same_packed_or_not(tmp_path, compression):
    with Ros1BagMaker(tmp_path / "drive.bag", compression=compression) as bag:
        usual_topics(bag, number=1)
    import_recording(tmp_path / "drive.bag", tmp_path / "out")
    sample = open_dataset(tmp_path / "out")[0]
    assert torch.equal(sample.points[:-1], SAMPLE.points[:-1])
    assert torch.equal(sample.image[:, 1:], SAMPLE.image[:, 1:])


@pytest.mark.parametrize(
    ("image", "infos", "chosen"),
    [
        ("/cam/rgb/image_raw", ("/cam/camera_info", "/other/camera_info"), "/cam/camera_info"),
        ("/cam/image_rect/compressed", ("/cam/camera_info", "/b/camera_info"), "/cam/camera_info"),
        ("/image", ("/camera_info",), "/camera_info"),
        ("/front/image", ("/calibration",), "/calibration"),
    ],
)
def test_the_camera_info_nearest_to_the_images_is_taken(tmp_path, image, infos, chosen):
    with BagMaker(tmp_path / "drive") as bag:
        for name in infos:
            bag.info(name, 10**9)
        if image.endswith("compressed"):
            bag.jpeg(image, 10**9, cv2.imencode(".png", IMAGE)[1].tobytes())
        else:
            bag.image(image, 10**9)
        bag.cloud("/points", 10**9)
    with open_bag(tmp_path / "drive") as bag:
        assert choose_topics(bag, image.lstrip("/"), "points", None).info.name == chosen


@pytest.mark.parametrize(("frame", "is_known"), [("base_link", True), ("base", False)])
def test_the_tilt_of_a_lidar_in_a_level_base_link_is_written(tmp_path, frame, is_known):
    tilt = Tilt(roll_deg=3.0, pitch_deg=12.0)
    base_from_lidar = BASE_FROM_LIDAR @ tilt.level_from_lidar
    points = (POINTS * np.float32([1, 1, 1, 255])).astype(np.float64)
    points[:, :3] = points[:, :3] @ tilt.level_from_lidar[:3, :3]
    with BagMaker(tmp_path / "drive") as bag:
        mounts = {f"{frame}__lidar": base_from_lidar, f"camera_optical__{frame}": CAMERA_FROM_BASE}
        bag.transforms("/tf_static", 10**9, **mounts)
        for time_ns in (2 * 10**9, 3 * 10**9):
            bag.info("/front/camera_info", time_ns)
            bag.image("/front/image_raw", time_ns)
            bag.cloud("/points", time_ns, points=points.astype(np.float32))
    report = import_recording(tmp_path / "drive", tmp_path / "out")
    written = read_recording_calibration(tmp_path / "out" / "calibration.yaml")
    assert (written.lidar_tilt is not None) == is_known
    if written.lidar_tilt is not None:
        assert written.lidar_tilt.roll_deg == pytest.approx(3.0)
        assert written.lidar_tilt.pitch_deg == pytest.approx(12.0)
    source = "by its calibration" if is_known else "by the road in its clouds"
    assert f"{source} the LiDAR is tilted, 1" in str(report)
