import sqlite3
from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from sightline.data.formats.recording_calibration import read_recording_calibration
from sightline.data.importing.bag import open_bag
from sightline.data.importing.bag_messages import image_file_from_message, image_from_message
from sightline.data.importing.bag_sectors import describe_parts_of_turns
from sightline.data.importing.import_recording import import_recording
from tests.data.recordings import (
    CAMERA_FROM_LIDAR,
    CAMERA_MATRIX,
    BagMaker,
    usual_topics,
    write_bag,
)

LONG = "\x1b[31m" + "x" * 9000
MOVED = CAMERA_FROM_LIDAR.copy()
MOVED[0, 3] += 0.5


@pytest.mark.parametrize(
    "transforms",
    [
        {"camera_optical__base": MOVED, "base__lidar": np.eye(4)},  # a second parent
        {"lidar__camera_optical": CAMERA_FROM_LIDAR},  # and back by the same
        {"lidar__a": np.eye(4), "a__camera_optical": np.eye(4)},  # a loop
    ],
)
def test_ways_through_tf_that_differ_are_told(tmp_path, transforms):
    with BagMaker(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 10**9, **transforms)
        usual_topics(bag, number=1)
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert "warning: TF has several chains from lidar to camera_optical that differ by" in report
    assert "the shortest is used, through lidar and camera_optical" in report


def test_ways_through_tf_that_agree_are_no_matter(tmp_path):
    with BagMaker(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__a=CAMERA_FROM_LIDAR, a__lidar=np.eye(4))
        bag.transforms("/tf_static", 10**9, lidar__camera_optical=np.linalg.inv(CAMERA_FROM_LIDAR))
        usual_topics(bag, number=1)
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert "several chains" not in report


def test_odometry_of_sensors_is_no_way_between_them(tmp_path):
    drive = tmp_path / "drive"
    with BagMaker(drive) as bag:
        fixed = {"camera_optical__a": CAMERA_FROM_LIDAR, "a__b": np.eye(4), "b__lidar": np.eye(4)}
        bag.transforms("/tf_static", 10**9, **fixed)
        for number in range(3):  # the shorter way, at two moments of a moving vehicle
            moved = np.eye(4)
            moved[0, 3] = number
            bag.transforms("/tf", 10**9 + number, odom__lidar=moved)
            bag.transforms("/tf", 10**9 + number, odom__camera_optical=moved @ MOVED)
        bag.info("/front/camera_info", 10**9)
        bag.image("/front/image_raw", 10**9)
        bag.cloud("/points", 10**9)
    report = str(import_recording(drive, tmp_path / "out"))
    assert "chains" not in report
    assert "moves" not in report
    written = read_recording_calibration(tmp_path / "out" / "calibration.yaml")
    np.testing.assert_allclose(written.matrices.camera_from_lidar, CAMERA_FROM_LIDAR, atol=1e-9)


def without_frames(bag):
    bag.header = lambda _, time_ns: BagMaker.header(bag, "", time_ns)
    usual_topics(bag)


def with_long_frames(bag):
    plain = bag.header
    bag.header = lambda frame, time_ns: plain(f"{frame}{LONG}", time_ns)
    usual_topics(bag)


def many_frames(bag):
    bag.transforms("/tf_static", 10**9, **{f"a{at}__b{at}": np.eye(4) for at in range(40)})
    bag.info("/front/camera_info", 10**9)
    bag.image("/front/image_raw", 10**9)
    bag.cloud("/points", 10**9)


ODD = {
    "no message of /points names its frame": without_frames,
    "has no chain from frame 'lidar.x1b": with_long_frames,
    "it has frames a0, a1, a10, a11, a12 and 75 more": many_frames,
    "only zeros: the camera is not calibrated": lambda bag: usual_topics(
        bag, matrix=CAMERA_MATRIX * 0
    ),
}


@pytest.mark.parametrize("expected", ODD)
def test_headers_and_calibrations_that_say_nothing_are_named_in_one_short_line(tmp_path, expected):
    with BagMaker(tmp_path / "drive") as bag:
        ODD[expected](bag)
    with pytest.raises(ValueError, match=expected) as raised:
        import_recording(tmp_path / "drive", tmp_path / "out")
    assert len(str(raised.value)) < 700


def test_names_and_encodings_of_any_length_are_shown_in_short():
    message = SimpleNamespace(encoding=LONG, format=LONG, data=np.zeros(9, np.uint8))
    for read in (image_from_message, image_file_from_message):
        with pytest.raises(ValueError, match="topic /aaa") as raised:
            read(message, "/" + "a" * 9000)
        assert len(str(raised.value)) < 500


def test_times_of_receipt_of_no_clock_are_named(tmp_path):
    bag = write_bag(tmp_path / "drive", 1, storage=StoragePlugin.SQLITE3)
    (path,) = bag.glob("*.db3")
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("update messages set timestamp = 9223372036854775807")
    with pytest.raises(ValueError, match=r"unreadable messages of .*: its time of receipt, 9223"):
        import_recording(path, tmp_path / "out")


@pytest.mark.parametrize("parts", [1, 5])
def test_clouds_of_parts_of_a_turn_are_told(tmp_path, parts):
    angles = np.linspace(-3.1, 3.1, 2000, dtype=np.float32)
    turn = np.stack((np.cos(angles) * 9, np.sin(angles) * 9, angles * 0, angles * 0), axis=1)
    with BagMaker(tmp_path / "bag") as bag:
        for at in range(10):
            bag.cloud("/points", 10**9 + at * 10**7, points=np.array_split(turn, parts)[at % parts])
    with open_bag(tmp_path / "bag") as bag:
        found = describe_parts_of_turns(bag, "/points")
    assert len(found) == (parts > 1)
    assert all("show different sectors of 75 degrees one after the other" in line for line in found)


def test_a_recording_that_was_not_closed_is_named_with_its_repair(tmp_path):
    with BagMaker(tmp_path / "bag") as bag:
        bag.cloud("/points", 10**9)
    content = next((tmp_path / "bag").glob("*.mcap")).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(content) // 2])
    with pytest.raises(ValueError, match="was not closed or is cut short: repair it by `mcap rec"):
        import_recording(tmp_path / "cut.mcap", tmp_path / "out")


def test_an_mcap_file_without_a_profile_is_read_whatever_defines_its_messages(tmp_path):
    with BagMaker(tmp_path / "bag") as bag:
        usual_topics(bag, number=1)
    content = next((tmp_path / "bag").glob("*.mcap")).read_bytes()
    length = int.from_bytes(content[25:29], "little")  # of the program's name, after the profile
    header = bytes(4) + (length + 4).to_bytes(4, "little") + b"any " + content[29 : 29 + length]
    changed = content[:17] + header + content[29 + length :]
    (tmp_path / "any.mcap").write_bytes(changed.replace(b"ros2msg", b"another"))
    assert import_recording(tmp_path / "any.mcap", tmp_path / "out").written == 1


def test_messages_of_foxglove_are_named_with_the_way_on(tmp_path):
    with BagMaker(tmp_path / "bag") as bag:
        usual_topics(bag, number=1)
    content = next((tmp_path / "bag").glob("*.mcap")).read_bytes()
    content = content.replace(b"sensor_msgs/msg/PointCloud2", b"foxglove.schemas.PointCloud")
    (tmp_path / "fox.mcap").write_bytes(content.replace(b"ros2msg", b"flatbuf"))
    with pytest.raises(
        ValueError,
        match=r"of clouds .*/points \(foxglove.schemas.PointCloud, 1\).*; Foxglove's own messages "
        "are not read: convert them to ROS's",
    ):
        import_recording(tmp_path / "fox.mcap", tmp_path / "out")


def default_matrix(bag):
    bag.info("/front/camera_info", 10**9, matrix=np.eye(3))


def other_matrix(bag):
    bag.info("/front/camera_info", 10**9, matrix=CAMERA_MATRIX * np.array([[2.0], [2.0], [1.0]]))


def no_numbers_of_a_lens(bag):
    bag.info("/front/camera_info", 10**9, distortion=(np.nan,) * 5)


@pytest.mark.parametrize(
    ("first", "told"),
    [
        (
            default_matrix,
            "1 of 4 messages of /front/camera_info are unusable or less usable than number 1",
        ),
        (
            other_matrix,
            "warning: 1 of 4 messages of /front/camera_info differ from number 1",
        ),
        (
            no_numbers_of_a_lens,
            "1 of 4 messages of /front/camera_info are unusable or less usable than number 1",
        ),
    ],
)
def test_defaults_of_a_driver_before_its_calibration_are_not_used(tmp_path, first, told):
    with BagMaker(tmp_path / "drive") as bag:
        first(bag)
        usual_topics(bag, number=3)
    assert told in str(import_recording(tmp_path / "drive", tmp_path / "out"))
    written = read_recording_calibration(tmp_path / "out" / "calibration.yaml")
    np.testing.assert_array_equal(written.matrices.image_from_camera[:, :3], CAMERA_MATRIX)
    assert written.lens is None


def test_a_lens_that_most_messages_have_is_refused_though_the_first_has_none(tmp_path):
    with BagMaker(tmp_path / "drive") as bag:
        bag.info("/front/camera_info", 10**9)
        usual_topics(bag, number=3, distortion=(-0.3, 0.1, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="the lens distorts"):
        import_recording(tmp_path / "drive", tmp_path / "out")


def report_of_poses(folder, poses, static=()):
    """Import a bag whose LiDAR has these poses one after the other, and return the report."""
    with BagMaker(folder / "drive") as bag:
        for pose in static:
            bag.transforms("/tf_static", 1, camera_optical__lidar=pose)
        for at, pose in enumerate(poses):
            bag.transforms("/tf", 10**9 + at, camera_optical__lidar=pose)
        bag.info("/front/camera_info", 10**9)
        bag.image("/front/image_raw", 10**9)
        bag.cloud("/points", 10**9)
    return str(import_recording(folder / "drive", folder / "out"))


@pytest.mark.parametrize(
    ("static", "poses"),
    [((), (np.eye(4), *[CAMERA_FROM_LIDAR] * 3)), ((CAMERA_FROM_LIDAR,), (MOVED,) * 3)],
)
def test_the_pose_of_most_messages_is_used_and_a_static_one_goes_before(tmp_path, static, poses):
    report = report_of_poses(tmp_path, poses, static)
    assert "lidar moves relative to camera_optical in the drive" in report
    written = read_recording_calibration(tmp_path / "out" / "calibration.yaml")
    np.testing.assert_allclose(written.matrices.camera_from_lidar, CAMERA_FROM_LIDAR, atol=1e-9)


def test_sensors_that_come_back_to_their_place_are_told(tmp_path):
    report = report_of_poses(tmp_path, (CAMERA_FROM_LIDAR, MOVED, CAMERA_FROM_LIDAR))
    assert "in the drive, by 0.5 m and 0 degrees at times" in report


def test_a_first_image_of_an_absurd_size_is_dropped_and_not_blamed_on_the_calibration(tmp_path):
    with BagMaker(tmp_path / "drive") as bag:
        damaged = bag.new(
            "sensor_msgs/msg/Image",
            header=bag.header("camera_optical", 10**9),
            height=2**31,
            width=2**31,
            encoding="rgb8",
            is_bigendian=0,
            step=0,
            data=np.zeros(9, np.uint8),
        )
        bag.write("/front/image_raw", damaged, 10**9)
        bag.cloud("/points", 10**9)
        usual_topics(bag)
    report = import_recording(tmp_path / "drive", tmp_path / "out")
    assert report.written == 2
    assert "dropped 1 unreadable frames; the first: topic /front/image_raw holds an" in str(report)


def test_a_bag_of_defaults_alone_is_refused_with_a_remedy_of_bags(tmp_path):
    with BagMaker(tmp_path / "drive") as bag:
        usual_topics(bag, matrix=np.eye(3))
    with pytest.raises(ValueError, match=r"focal lengths of 1 and 1 px.*give one by --calibration"):
        import_recording(tmp_path / "drive", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def import_in_frame(folder, frame, steps_m):
    """Import a bag whose clouds are in a frame that moves ahead by steps against the camera."""
    with BagMaker(folder / "drive") as bag:
        bag.transforms("/tf_static", 1, base_link__camera_optical=np.linalg.inv(CAMERA_FROM_LIDAR))
        for at, moved_m in enumerate(np.cumsum(steps_m)):
            pose = np.eye(4)
            pose[0, 3] = moved_m
            bag.transforms("/tf", 10**9 + at, **{f"{frame}__base_link": pose})
        bag.info("/front/camera_info", 10**9)
        bag.image("/front/image_raw", 10**9)
        bag.cloud("/points", 10**9, frame=frame)
    return str(import_recording(folder / "drive", folder / "out"))


@pytest.mark.parametrize(
    ("frame", "steps_m"),
    [
        ("odom", (0.0, 0.5)),
        ("robot1/Map", (0.0, 0.0, 0.0, 0.5)),  # at rest most of the time
        ("camera_init", (0.0, 0.5)),
        ("fixed", (0.0, 12.0, 12.0)),
        ("odom", (*[0.001] * 60, *[1.0] * 10, *[-1.0] * 10)),  # it ends where it began
    ],
)
def test_clouds_in_a_maps_or_odometrys_frame_are_refused_by_that_cause(tmp_path, frame, steps_m):
    with pytest.raises(ValueError, match="in the drive, as a map's or odometry's frame does") as it:
        import_in_frame(tmp_path, frame, steps_m)
    assert f"topic /points: clouds are in frame {frame}, which by TF moves by" in str(it.value)
    assert "choose the topic in the LiDAR's own frame by --lidar-topic" in str(it.value)


@pytest.mark.parametrize(
    ("frame", "steps_m", "moved"),
    [
        ("odom", (0.0, 0.0), None),
        ("odom", (0.0, 0.2), "0.2"),  # a drift at rest
        ("trailer", (0.0, 3.0, 3.0), "6"),
        ("lidar", (0.0, 0.0, 0.0, 50.0), "50"),  # a single wrong message
    ],
)
def test_clouds_in_frames_that_may_be_a_sensors_are_imported(tmp_path, frame, steps_m, moved):
    report = import_in_frame(tmp_path, frame, steps_m)
    assert ("moves relative to" in report) == (moved is not None)
    assert moved is None or f"in the drive, by {moved} m" in report
