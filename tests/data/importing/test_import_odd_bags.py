import bz2
import errno
import pathlib

import cv2
import lz4.frame
import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from scipy.spatial.transform import Rotation

from sightline.data.check import check_tree
from sightline.data.importing import bag_files, bag_limits
from sightline.data.importing.import_recording import import_recording
from sightline.data.open import open_dataset
from sightline.files.problem import FileError
from tests.data.formats.test_image_file import with_exif
from tests.data.recordings import (
    BASE_FROM_LIDAR,
    CAMERA_FROM_BASE,
    CAMERA_FROM_LIDAR,
    CAMERA_MATRIX,
    IMAGE,
    POINTS,
    BagMaker,
    Ros1BagMaker,
    usual_topics,
    write_bag,
)


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bags") / "drive", 2)


def test_a_frame_that_cannot_be_read_is_dropped_and_told(tmp_path):
    picture = IMAGE.copy()
    with BagMaker(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        for at in range(4):
            time_ns = 2 * 10**9 + at * 10**8
            bag.info("/front/camera_info", time_ns)
            picture[:8, : 8 * at] = 0  # no two pictures are equal
            content = cv2.imencode(".jpg", picture)[1].tobytes()
            bag.jpeg("/front/image_raw/compressed", time_ns, content[:999] if at < 1 else content)
            bag.cloud("/points", time_ns, names=("x", "y", "zz" if at == 2 else "z", "i"))
    report = import_recording(tmp_path / "drive", tmp_path / "out")
    assert report.written == 2
    assert "warning: dropped 2 unreadable frames; the first: topic" in str(report)
    assert open_dataset(tmp_path / "out").sample_ids == ("000001", "000003")
    assert import_recording(tmp_path / "drive", tmp_path / "out").skipped == 2


def test_exif_orientations_of_images_are_told_wherever_they_are(tmp_path):
    with BagMaker(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        for at in range(4):
            time_ns = 2 * 10**9 + at * 10**8
            bag.info("/front/camera_info", time_ns)
            content = cv2.imencode(".jpg", np.roll(IMAGE, at))[1].tobytes()
            turned = with_exif(content, "<", 6) if at == 2 else content
            bag.jpeg("/front/image_raw/compressed", time_ns, turned)
            bag.cloud("/points", time_ns)
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert "000002.jpg: has EXIF orientation 6, of 4 pictures: pixels are used as stored" in report


def test_messages_that_cannot_be_decoded_and_stamps_that_stand_twice_are_counted(tmp_path):
    with BagMaker(tmp_path / "drive") as bag:
        usual_topics(bag)
        bag.image("/front/image_raw", 2 * 10**9)
        bag._writer.write(
            bag._connections["/points"], 3 * 10**9, b"\x00\x01\x00\x00\xff\xff\xff\xff"
        )
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert "warning: dropped 1 unreadable messages of /points" in report
    assert "warning: 1 images and 0 sweeps repeat the header time of an earlier one" in report


def test_what_a_bag_says_of_its_types_and_services_is_not_followed(tmp_path):
    write_bag(tmp_path / "drive", 1)
    (path,) = (tmp_path / "drive").glob("*.mcap")
    content = path.read_bytes()
    damaged = content.replace(b"uint32 point_step", b"string point_step")
    assert damaged != content
    path.write_bytes(damaged)
    assert import_recording(path, tmp_path / "out").written == 1


@pytest.mark.parametrize(
    ("entry", "fault"),
    [
        ("relative_file_paths: [../other.mcap]", "names .*/other.mcap, which does not exist"),
        (
            "relative_file_paths: [.hidden.mcap]",
            "entry 1 is '.hidden.mcap', which begins with a dot",
        ),
        ("relative_file_paths: [7]", "entry 1 is 7"),
        ("relative_file_paths: []", "lacks relative_file_paths"),
        ("relative_file_paths: &a [*a]", "alias"),
        ("<<: {a: b}", "has a merge"),
    ],
)
def test_metadata_that_lead_elsewhere_or_expand_are_one_line(tmp_path, entry, fault):
    write_bag(tmp_path / "drive", 1)
    (tmp_path / "drive" / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  {entry}\n")
    with pytest.raises(FileError, match=rf"metadata.yaml: .*{fault}"):
        import_recording(tmp_path / "drive", tmp_path / "out")


@pytest.mark.parametrize(
    "mode", [CompressionMode.FILE, CompressionMode.MESSAGE, CompressionMode.STORAGE]
)
def test_a_packed_bag_is_read_within_a_limit_and_refused_beyond(tmp_path, mode, monkeypatch):
    bag = BagMaker(tmp_path / "drive")
    bag._writer.set_compression(mode, CompressionFormat.ZSTD)
    with bag:
        usual_topics(bag, number=1)
    assert import_recording(tmp_path / "drive", tmp_path / "out").written == 1
    monkeypatch.setattr(bag_limits, "MAX_DECOMPRESSED_BYTES", 1000)
    monkeypatch.setattr(bag_files, "_MAX_COMPRESSION_RATIO", 1)
    with pytest.raises(
        ValueError, match=r"declares|decompress to more than 1000 bytes|decompresses to more"
    ):
        import_recording(tmp_path / "drive", tmp_path / "other")
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize("full", ["tempfile.mkdtemp", "pathlib.Path.open"])
def test_a_full_temporary_folder_is_told_as_such(tmp_path, monkeypatch, full):
    bag = BagMaker(tmp_path / "drive")
    bag._writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with bag:
        usual_topics(bag, number=1)
    before = pathlib.Path.open

    def refuse(*given, **named):
        if full == "pathlib.Path.open" and "ab" not in given:
            return before(*given, **named)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(full, refuse)
    with pytest.raises(FileError, match=r"temporary folder.*no space left on device; set TMPDIR"):
        import_recording(tmp_path / "drive", tmp_path / "out")


@pytest.mark.parametrize("bits", [2**33, 2**62, 2**64 - 1])
def test_a_record_that_claims_more_than_is_left_is_named(tmp_path, bits):
    with BagMaker(tmp_path / "drive") as bag:
        usual_topics(bag, number=1)
    (path,) = (tmp_path / "drive").glob("*.mcap")
    content = bytearray(path.read_bytes())
    content[9:17] = bits.to_bytes(8, "little")  # the length of the first record
    path.write_bytes(content)
    with pytest.raises(ValueError, match=f"at byte 17 claims {bits} bytes, but .* are left"):
        import_recording(path, tmp_path / "out")


@pytest.mark.parametrize(
    "compression", [Ros1Writer.CompressionFormat.LZ4, Ros1Writer.CompressionFormat.BZ2]
)
def test_a_chunk_of_ros_1_that_unpacks_beyond_the_limit_is_one_line(
    tmp_path, compression, monkeypatch
):
    with Ros1BagMaker(tmp_path / "drive.bag", compression=compression) as bag:
        usual_topics(bag, number=1)
    monkeypatch.setattr(bag_limits, "MAX_DECOMPRESSED_BYTES", 1000)
    with pytest.raises(ValueError, match="decompress to more than 1000 bytes"):
        import_recording(tmp_path / "drive.bag", tmp_path / "out")


@pytest.mark.parametrize("pack", [bz2.compress, lz4.frame.compress])
def test_unpacking_stops_at_its_limit(pack):
    new = {bz2.compress: bz2.BZ2Decompressor}.get(pack, lz4.frame.LZ4FrameDecompressor)
    packed = pack(bytes(10**7))
    assert bag_limits.decompressed(new, packed, 10**7) == bytes(10**7)
    with pytest.raises(ValueError, match="decompress to more than 9999999 bytes"):
        bag_limits.decompressed(new, packed, 10**7 - 1)
    with pytest.raises(ValueError, match="cut short"):
        bag_limits.decompressed(new, packed[:-20], 10**8)


def test_an_import_of_a_bag_into_its_folder_is_refused(bag):
    for out in (bag, bag / "out", bag.parent):
        with pytest.raises(ValueError, match="beside it"):
            import_recording(bag, out)


def small_bags(folder):
    """Bags of tiny images and clouds in each format, by suffix."""
    picture, points = IMAGE[::8, ::8], (POINTS * np.float32([1, 1, 1, 255]))[::100]
    for name, maker in (
        ("mcap", BagMaker(folder / "mcap")),
        ("db3", BagMaker(folder / "db3", storage=StoragePlugin.SQLITE3)),
        ("bag", Ros1BagMaker(folder / "a.bag")),
    ):
        with maker as bag:
            bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
            matrix = CAMERA_MATRIX / [[8], [8], [1]]
            bag.info("/front/camera_info", 10**9, matrix=matrix, size=picture.shape[:2])
            bag.image("/front/image_raw", 10**9, picture=np.ascontiguousarray(picture))
            bag.cloud("/points", 10**9, points=points)
        (path,) = (folder / name).glob(f"*.{name}") if name != "bag" else (folder / "a.bag",)
        yield name, path.read_bytes()


def outcome(work):
    """Error message of bad data; None: no error."""
    try:
        work()
    except ValueError as error:
        return str(error)
    return None


@pytest.mark.filterwarnings("ignore")
def test_damaged_bags_give_a_recording_or_one_line(tmp_path):
    random = np.random.default_rng(3)
    outcomes = []
    for name, content in small_bags(tmp_path):
        for number in range(16):
            damaged = bytearray(content)
            for _ in range(random.integers(1, 20)):
                near_end = random.integers(2) * max(len(content) - 3000, 0)
                damaged[near_end + random.integers(min(len(content), 3000))] = random.integers(256)
            path = tmp_path / f"damaged.{name}"
            path.write_bytes(damaged[: random.integers(len(content))] if number < 3 else damaged)
            out = tmp_path / f"{name}{number}"
            outcomes.append(outcome(lambda path=path, out=out: import_recording(path, out)))
    lines = [line for line in outcomes if line is not None]
    assert len(lines) > 10
    assert all(line.isprintable() for line in lines)


class HalvedBag(BagMaker):
    """Writes clouds whose width, or images whose height, is half of their data's."""

    def write(self, topic, message, time_ns):
        if topic == self.halved and topic == "/points":
            message.width, message.row_step = message.width // 2, message.row_step // 2
        elif topic == self.halved:
            message.height //= 2
        super().write(topic, message, time_ns)


@pytest.mark.parametrize(
    ("topic", "told"),
    [
        ("/points", f"2 messages of /points hold {2 * (len(POINTS) - len(POINTS) // 2)} points"),
        ("/front/image_raw", f"2 messages of /front/image_raw hold {2 * 188} rows"),
    ],
)
def test_data_beyond_the_size_of_messages_are_told_once_with_counts(tmp_path, topic, told):
    with HalvedBag(tmp_path / "drive") as bag:
        bag.halved = topic
        usual_topics(bag, size=(IMAGE.shape[0] // (2 if "image" in topic else 1), IMAGE.shape[1]))
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert f"warning: {told} more than their width and height declare: these are left" in report
    write_bag(tmp_path / "whole", 1)
    assert "declare" not in str(import_recording(tmp_path / "whole", tmp_path / "other"))


def test_messages_of_a_second_kind_in_a_topic_are_told_and_no_second_node(tmp_path):
    content = cv2.imencode(".jpg", IMAGE)[1].tobytes()
    with BagMaker(tmp_path / "drive") as bag:
        usual_topics(bag)
        del bag._connections["/front/image_raw"]
        for number in range(3):
            bag.jpeg("/front/image_raw", 3 * 10**9 + number * 10**8, content)
            bag.cloud("/points", 3 * 10**9 + number * 10**8)
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert (
        "warning: topic /front/image_raw (Image, 2) has messages of other kinds, which are left "
        "out: /front/image_raw (CompressedImage, 3); give each kind a topic of its own"
    ) in report
    assert "nodes" not in report


def test_a_topic_that_two_nodes_publish_is_told(tmp_path):
    with Ros1BagMaker(tmp_path / "drive.bag") as bag:
        bag.transforms("/tf_static", 1, camera_optical__lidar=CAMERA_FROM_LIDAR)
        bag.info("/front/camera_info", 10**9)
        for number, node in enumerate(("/first", "/second"), start=1):
            bag.connect("/points", "sensor_msgs/msg/PointCloud2", callerid=node)
            bag.image("/front/image_raw", number * 10**9)
            bag.cloud("/points", number * 10**9)
    report = str(import_recording(tmp_path / "drive.bag", tmp_path / "out"))
    assert "warning: topic /points is published by 2 nodes (/first, /second): all their" in report
    assert "topic /front/image_raw is published" not in report


def test_an_import_that_was_stopped_is_told_as_such(tmp_path):
    import_recording(write_bag(tmp_path / "drive", 3), tmp_path / "out")
    for path in (tmp_path / "out").glob("*/000002.*"):
        path.unlink()
    (problem,) = check_tree(tmp_path / "out")
    assert "1 of 3 lines name no frame" in problem.problem
    assert problem.remedy.startswith("run `sightline import` again, which was probably stopped")


def test_a_static_transform_goes_before_another_one_told_the_other_way(tmp_path):
    moved = CAMERA_FROM_LIDAR.copy()
    moved[0, 3] += 0.5
    with BagMaker(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 1, lidar__camera_optical=np.linalg.inv(CAMERA_FROM_LIDAR))
        bag.transforms("/tf", 10**9, camera_optical__lidar=moved)
        bag.info("/front/camera_info", 10**9)
        bag.image("/front/image_raw", 10**9)
        bag.cloud("/points", 10**9)
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert "moves relative to" in report
    used = open_dataset(tmp_path / "out")[0].calibration.camera_from_lidar
    np.testing.assert_allclose(used, CAMERA_FROM_LIDAR, atol=1e-6)


@pytest.mark.parametrize("robot", ["a", "b"])
def test_transforms_come_from_the_topics_beside_the_sensors(tmp_path, robot):
    mounts = {"a": CAMERA_FROM_LIDAR.copy(), "b": CAMERA_FROM_LIDAR.copy()}
    mounts["b"][0, 3] += 0.5
    with BagMaker(tmp_path / "drive") as bag:
        for name, mount in mounts.items():
            bag.transforms(f"/{name}/tf_static", 1, camera_optical__lidar=mount)
            bag.info(f"/{name}/cam/camera_info", 10**9)
            bag.image(f"/{name}/cam/image_raw", 10**9)
            bag.cloud(f"/{name}/points", 10**9)
    topics = {"camera_topic": f"/{robot}/cam/image_raw", "lidar_topic": f"/{robot}/points"}
    report = str(import_recording(tmp_path / "drive", tmp_path / "out", **topics))
    assert "moves relative to" not in report
    used = open_dataset(tmp_path / "out")[0].calibration.camera_from_lidar
    np.testing.assert_allclose(used, mounts[robot], atol=1e-6)


def test_topics_of_contradicting_transforms_are_named(tmp_path):
    moved = CAMERA_FROM_LIDAR.copy()
    moved[0, 3] += 0.5
    with BagMaker(tmp_path / "drive") as bag:
        usual_topics(bag)
        bag.transforms("/other/tf_static", 10**9, camera_optical__lidar=moved)
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert "it is in topics /other/tf_static, /tf_static" in report


def test_a_mount_of_which_a_part_is_another_robots_is_told(tmp_path):
    moved = CAMERA_FROM_BASE.copy()
    moved[0, 3] += 0.5
    mounts = {
        "a": {"base__lidar": BASE_FROM_LIDAR, "camera_optical__base": CAMERA_FROM_BASE},
        "b": {"camera_optical__base": moved},
    }
    reports = {}
    for name in mounts:
        with BagMaker(tmp_path / name) as bag:
            for robot, transforms in mounts.items():
                bag.transforms(f"/{robot}/tf_static", 1, **transforms)
            bag.info(f"/{name}/cam/camera_info", 10**9)
            bag.image(f"/{name}/cam/image_raw", 10**9)
            bag.cloud(f"/{name}/points", 10**9)
        reports[name] = str(import_recording(tmp_path / name, tmp_path / f"{name}_out"))
    assert "the transform of lidar in base is only in /a/tf_static, which contra" in reports["b"]
    assert "contradicts" not in reports["a"]


BASE_FROM_CAMERA = np.linalg.inv(CAMERA_FROM_BASE)
CHAIN = {"base__lidar": BASE_FROM_LIDAR, "base__camera_optical": BASE_FROM_CAMERA}


def turned_and_moved(mount, offset_m=0.0, yaw_deg=0.0):
    changed = mount.copy()
    changed[0, 3] += offset_m
    changed[:3, :3] = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix() @ mount[:3, :3]
    return changed


def import_transforms(folder, transforms):
    """Report of the import of a robot's bag with transforms of (topic, time), and their mount."""
    with BagMaker(folder / "drive") as bag:
        for (topic, time_ns), each in transforms.items():
            bag.transforms(topic, time_ns, **each)
        bag.info("/robot/camera/camera_info", 10**9)
        bag.image("/robot/camera/image_raw", 10**9)
        bag.cloud("/robot/points", 10**9)
    report = str(import_recording(folder / "drive", folder / "out"))
    return report, open_dataset(folder / "out")[0].calibration.camera_from_lidar


@pytest.mark.parametrize(
    ("near", "own", "told"),
    [
        (
            "/robot/tf_static",
            CHAIN | {"base__lidar": turned_and_moved(BASE_FROM_LIDAR, 0.15)},
            "of lidar in base by 0.15 m and 0 degrees",
        ),
        (
            "/robot/tf_static",
            {"base__lidar": turned_and_moved(BASE_FROM_LIDAR, 0.0, 3.0)},
            "of lidar in base by 0 m and 3 degrees",
        ),
        (
            "/robot/tf_static",
            {"lidar__base": np.linalg.inv(turned_and_moved(BASE_FROM_LIDAR, 0.15))},
            "of base in lidar by 0.15 m and 0 degrees",
        ),
        (
            "/robot/camera/tf_static",
            {"base__camera_optical": turned_and_moved(BASE_FROM_CAMERA, 0.0, 3.0)},
            "of camera_optical in base by 0 m and 3 degrees",
        ),
        (
            "/robot/lidar/tf",
            {"base__lidar": turned_and_moved(BASE_FROM_LIDAR, 0.5)},
            "of lidar in base by 0.5 m and 0 degrees",
        ),
    ],
)
def test_a_mount_that_differs_in_a_further_topic_is_told_with_both_topics(
    tmp_path, near, own, told
):
    report, used = import_transforms(tmp_path, {("/tf_static", 1): CHAIN, (near, 1): own})
    assert (
        f"warning: /tf_static differs from {near} in the transform {told}: the latter is taken, as "
        "it is beside the sensors; if it is wrong, give the LiDAR's mount by --calibration"
    ) in report
    assert report.count("/tf_static differs") == 1
    assert "another robot" not in report
    assert np.abs(used.numpy() - CAMERA_FROM_LIDAR).max() > 0.01


@pytest.mark.parametrize(
    "relayed",
    [
        {("/tf_static", 1): CHAIN, ("/robot/tf_static", 1): CHAIN},
        {("/tf", 9): CHAIN}
        | {
            (topic, at): {"odom__base": turned_and_moved(np.eye(4), at / 10)}
            for topic in ("/robot/tf", "/tf")
            for at in range(1, 4)
        },
        {("/tf", 9): CHAIN}  # two estimators of a vehicle at rest
        | {
            (topic, 1): {"odom__base": turned_and_moved(np.eye(4), x)}
            for x, topic in enumerate(("/robot/tf", "/tf"))
        },
    ],
)
def test_equal_transforms_and_odometry_in_two_topics_are_no_contradiction(tmp_path, relayed):
    report, used = import_transforms(tmp_path, relayed)
    assert "/tf" not in report
    np.testing.assert_allclose(used, CAMERA_FROM_LIDAR, atol=1e-6)


@pytest.mark.parametrize(
    ("far", "changed", "told"),
    [
        ("/other/tf_static", {"base__lidar": turned_and_moved(BASE_FROM_LIDAR, 0.5)}, ", as anoth"),
        (
            "/tf_static",
            {name: turned_and_moved(mount, 0.5) for name, mount in CHAIN.items()},
            ", of camera_optical in base by 0.5 m and 0 degrees: the",
        ),
    ],
)
def test_transforms_of_another_robot_or_another_base_are_told_without_a_warning(
    tmp_path, far, changed, told
):
    transforms = {("/robot/tf_static", 1): CHAIN, (far, 1): CHAIN | changed}
    report, used = import_transforms(tmp_path, transforms)
    assert (
        f"{far} differs from /robot/tf_static in the transform of lidar in base by 0.5 m and 0 "
        f"degrees{told}"
    ) in report
    assert f"warning: {far}" not in report
    np.testing.assert_allclose(used, CAMERA_FROM_LIDAR, atol=1e-6)


def test_a_contradiction_beside_the_chain_is_a_warning_for_another_robots_topic_only(tmp_path):
    for far, warning in (("/other/tf_static", "warning: "), ("/tf_static", "")):
        transforms = {
            ("/robot/tf_static", 1): {
                "base__camera_optical": BASE_FROM_CAMERA,
                "base__wheel": np.eye(4),
            },
            (far, 1): {
                "base__lidar": BASE_FROM_LIDAR,
                "base__wheel": turned_and_moved(np.eye(4), 0.5),
            },
        }
        report, _ = import_transforms(tmp_path / f"{bool(warning)}", transforms)
        told = (
            f"the transform of lidar in base is only in {far}, which contradicts /robot/tf_static "
            "in the transform of wheel in base by 0.5 m and 0 degrees, as another robot's does"
        )
        assert f"{warning}{told}" in report
        assert warning or f"warning: {told}" not in report
