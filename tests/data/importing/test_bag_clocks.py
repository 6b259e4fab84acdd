import shutil
from functools import partial

import cv2
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from sightline.data.importing.bag import open_bag
from sightline.data.importing.bag_clocks import find_set_back
from sightline.data.importing.import_recording import import_recording
from sightline.data.open import open_dataset
from tests.data.recordings import (
    CAMERA_FROM_LIDAR,
    IMAGE,
    POINTS,
    BagMaker,
    Ros1BagMaker,
    calibration_entries,
)

YEAR_NS = 366 * 86_400 * 10**9
START_NS = 40 * YEAR_NS
SMALL = np.ascontiguousarray(IMAGE[::8, ::8])
FEW = (POINTS * np.float32([1, 1, 1, 255]))[::20]


class OddBag(BagMaker):
    """Bag with changed headers: `stamp` computes a stamp from frame and time."""

    def __init__(self, path, stamp=lambda _, time_ns: time_ns):
        super().__init__(path)
        self._stamp = stamp

    def header(self, frame, time_ns):
        return super().header(frame, self._stamp(frame, time_ns))


def write_drive(path, number=4, **bag_changes):
    """Write a drive of small images and clouds."""
    with OddBag(path, **bag_changes) as bag:
        matrix = np.array(calibration_entries()["camera_matrix"]) / [[8], [8], [1]]
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        for at in range(number):
            time_ns = START_NS + at * 10**8
            bag.info("/front/camera_info", time_ns, matrix=matrix, size=SMALL.shape[:2])
            picture = SMALL.copy()
            picture[0, :at] = 0  # no two pictures and clouds are equal
            bag.image("/front/image_raw", time_ns, picture=picture)
            bag.cloud("/points", time_ns + 8 * 10**6, points=FEW[: len(FEW) - at])
    return path


LIDAR_STAMPS = {
    "all 0": (lambda _: 0, "header stamps of /points are all 0"),
    "negative": (lambda _: -(10**9), "header stamps of /points are not above 0"),
    "constant": (lambda _: START_NS, "header stamps of /points stand still"),
    "falling": (lambda at: 2 * START_NS - at, "header stamps of /points fall from message"),
    "microseconds": (lambda at: at // 1000, "header stamps of /points are in microseconds"),
    "milliseconds": (lambda at: at // 10**6, "header stamps of /points are in milliseconds"),
    "years": (lambda at: at + 10 * YEAR_NS, "header stamps of /points are 10 years after"),
    "set back": (
        lambda at: at - (at > START_NS + 10**8) * 10**11,
        "header stamps of /points go back by 99",
    ),
}


@pytest.mark.parametrize("case", LIDAR_STAMPS)
def test_stamps_that_tell_no_time_are_told_and_receipt_counts(tmp_path, case):
    lidar_stamp, expected = LIDAR_STAMPS[case]

    def stamp(frame, time_ns):
        return lidar_stamp(time_ns) if frame == "lidar" else time_ns

    bag = write_drive(tmp_path / "drive", stamp=stamp)
    report = str(import_recording(bag, tmp_path / "out"))
    assert "paired 4 of 4 images and 4 sweeps by received time, 8.0 ms apart" in report
    assert f"warning: {expected}" in report
    assert "messages are paired by the time of receipt" in report
    assert open_dataset(tmp_path / "out")[1].timestamp_s == 0.1


def test_a_clock_of_both_sensors_of_its_own_is_taken_and_told(tmp_path):
    bag = write_drive(tmp_path / "drive", stamp=lambda _, at: at - START_NS + 10**9)
    report = str(import_recording(bag, tmp_path / "out"))
    assert "by header time" in report
    assert "header stamps of all sensors are 40.1 years before receipt" in report


def test_microseconds_of_both_sensors_are_no_clock_of_their_own(tmp_path):
    bag = write_drive(tmp_path / "drive", stamp=lambda _, at: at // 1000)
    report = str(import_recording(bag, tmp_path / "out"))
    assert "by received time, 8.0 ms apart" in report
    assert "image_raw are in microseconds instead of nanoseconds: messages are paired by" in report
    assert "not in seconds" not in report


@pytest.mark.parametrize(("late_ns", "is_told"), [(2 * 10**8, False), (10**9, True)])
def test_stamps_of_separate_clocks_are_doubted(tmp_path, late_ns, is_told):
    def stamp(frame, time_ns):
        return time_ns + late_ns * (frame == "lidar")

    bag = write_drive(tmp_path / "drive", stamp=stamp)
    report = str(import_recording(bag, tmp_path / "out", max_gap_s=5.0))
    doubt = "warning: header stamps of /points are 1 s later against their receipt than those of /f"
    assert (doubt in report) == is_told


@pytest.mark.parametrize("stepping", ["lidar", "both"])
def test_a_clock_that_is_set_within_the_drive_is_told(tmp_path, stepping):
    """The sensor's stamps are a second early at first."""

    def stamp(frame, time_ns):
        is_early = time_ns < START_NS + 95 * 10**7 and (stepping == "both" or frame == "lidar")
        return time_ns - 10**9 * is_early

    bag = write_drive(tmp_path / "drive", number=20, stamp=stamp)
    report = str(import_recording(bag, tmp_path / "out", max_gap_s=5.0))
    doubt = "warning: header stamps of /points step by 1 s against those of /front/image_raw within"
    assert (doubt in report) == (stepping == "lidar")


def test_a_clock_of_the_recorder_and_one_sensor_that_is_set_is_told(tmp_path):
    """The camera's stamps and all times of receipt jump; the LiDAR has a clock of its own."""
    set_ns, step_ns = START_NS + 95 * 10**7, 10**9

    def stamp(frame, time_ns):
        return time_ns - step_ns * (frame == "lidar" and time_ns > set_ns + step_ns // 2)

    with OddBag(tmp_path / "drive", stamp) as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        bag.info("/front/camera_info", 10**9)
        for at in range(20):
            time_ns = START_NS + at * 10**8 + step_ns * (at >= 10)
            bag.image("/front/image_raw", time_ns)
            bag.cloud("/points", time_ns + 10**7, points=FEW[: len(FEW) - at])
    report = str(import_recording(tmp_path / "drive", tmp_path / "out", max_gap_s=5.0))
    assert "header stamps of /front/image_raw step by 1 s against those of /points" in report


def test_a_camera_that_stalls_and_is_late_from_then_on_is_no_step_of_a_clock(tmp_path):
    """Its pictures of a second are lost, and the others are received a second late."""
    late_ns = 10**9

    def stamp(frame, time_ns):
        is_late = frame == "camera_optical" and time_ns > START_NS + 2 * 10**9
        return time_ns - late_ns * is_late

    with OddBag(tmp_path / "drive", stamp) as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        bag.info("/front/camera_info", 10**9)
        for at in range(40):
            time_ns = START_NS + at * 10**8
            bag.cloud("/points", time_ns, points=FEW[: len(FEW) - at])
            if at < 10 or 20 <= at < 30:
                bag.image("/front/image_raw", time_ns + late_ns * (at >= 20))
    assert "step by" not in str(import_recording(tmp_path / "drive", tmp_path / "out"))


def test_a_sensor_that_starts_late_is_no_step_of_a_clock(tmp_path):
    with OddBag(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        bag.info("/front/camera_info", 10**9)
        for at in range(20):
            time_ns = START_NS + at * 10**8 + 5 * 10**9 * (at >= 9)
            bag.image("/front/image_raw", time_ns)
            if at >= 9:
                bag.cloud("/points", time_ns, points=FEW[: len(FEW) - at])
    assert "step by" not in str(import_recording(tmp_path / "drive", tmp_path / "out"))


def test_messages_that_are_received_late_are_no_step_of_a_clock(tmp_path):
    late_ns = 2 * 10**9

    def stamp(frame, time_ns):
        is_late = frame == "lidar" and time_ns > START_NS + late_ns
        return time_ns - late_ns * is_late

    with OddBag(tmp_path / "drive", stamp) as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        bag.info("/front/camera_info", 10**9)
        for at in range(20):
            time_ns = START_NS + at * 10**8
            bag.image("/front/image_raw", time_ns)
            bag.cloud("/points", time_ns + late_ns * (at >= 10), points=FEW[: len(FEW) - at])
    report = str(import_recording(tmp_path / "drive", tmp_path / "out", max_gap_s=5.0))
    assert "step by" not in report


def test_a_few_stamps_that_are_not_set_are_filled_in(tmp_path):
    first = START_NS + 8 * 10**6
    bag = write_drive(tmp_path / "drive", stamp=lambda _, at: 0 if at == first else at)
    report = str(import_recording(bag, tmp_path / "out"))
    assert "paired 4 of 4 images and 4 sweeps by header time" in report
    assert "warning: 1 of 4 header stamps of /points are not set, or days off" in report


def test_a_drive_without_any_clock_is_refused(tmp_path):
    with OddBag(tmp_path / "drive", lambda _, __: 0) as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        for _ in range(3):
            bag.info("/front/camera_info", 10**9)
            bag.image("/front/image_raw", 10**9)
            bag.cloud("/points", 10**9)
    with pytest.raises(ValueError, match=r"are all 0, and all 3 messages of .* cannot be paired"):
        import_recording(tmp_path / "drive", tmp_path / "out")
    with pytest.raises(ValueError, match=r"all 3 messages of .* try --clock header"):
        import_recording(tmp_path / "drive", tmp_path / "out", clock="received")


SET_BACK_NS = 1_985 * 10**6
SET_BACK = "warning: times of receipt of /front/image_raw go back by 1.89 s within the bag, as "


def write_set_back_drive(path, maker=BagMaker, *, order=None, has_own_clock=False, late_ms=5):
    """Write 40 frames; the recorder's clock is set back after 20, stamps are of it or sound.

    Each frame's number is in its picture, and is the number of points that it lacks.
    """
    with maker(path) as bag:
        bag.transforms("/tf_static", START_NS, camera_optical__lidar=CAMERA_FROM_LIDAR)
        write = bag.write
        for at in range(40) if order is None else order:
            true_ns, set_ns = START_NS + at * 10**8, SET_BACK_NS * (at >= 20 and order is None)
            stamp_ns = true_ns - set_ns * (not has_own_clock)
            late_ns = late_ms * 10**6 + true_ns - set_ns - stamp_ns
            bag.write = lambda topic, message, ns, late=late_ns: write(topic, message, ns + late)
            matrix = np.array(calibration_entries()["camera_matrix"]) / [[8], [8], [1]]
            bag.info("/front/camera_info", stamp_ns, matrix=matrix, size=SMALL.shape[:2])
            picture = SMALL.copy()
            picture[0, 0] = at
            bag.image("/front/image_raw", stamp_ns, picture=picture)
            bag.cloud("/points", stamp_ns + 10**7, points=FEW[: len(FEW) - at])
    return path


def frames_of(recording):
    """Numbers of the images and sweeps of a recording of `write_set_back_drive`."""
    samples = list(open_dataset(recording))
    return [(int(each.image[0, 0, 0]), len(FEW) - len(each.points)) for each in samples]


@pytest.mark.parametrize("storage", ["mcap", "no index", "sqlite3", "ros 1"])
def test_a_recorders_clock_that_is_set_back_is_told(tmp_path, storage):
    if storage == "ros 1":
        bag = write_set_back_drive(tmp_path / "drive.bag", Ros1BagMaker)
    elif storage == "sqlite3":
        plugin = partial(BagMaker, storage=StoragePlugin.SQLITE3)
        bag = write_set_back_drive(tmp_path / "drive", plugin)
    else:
        bag = write_set_back_drive(tmp_path / "drive")
        if storage == "no index":
            content = (bag / "drive.mcap").read_bytes()
            (bag / "drive.mcap").write_bytes(content[:-28] + bytes(20) + content[-8:])
    for clock in ("header", "received"):
        report = str(import_recording(bag, tmp_path / clock, clock=clock))
        assert f"by {clock} time, 5.0 ms apart" in report
        assert SET_BACK in report
        expected = f"have the times from {START_NS // 10**9}.020 to {START_NS // 10**9 + 1}.915 s"
        assert expected in report
        assert "--clock header" not in report


def test_stamps_of_another_clock_than_the_recorders_that_is_set_back_count(tmp_path):
    bag = write_set_back_drive(tmp_path / "drive", has_own_clock=True)
    report = str(import_recording(bag, tmp_path / "out"))
    assert "paired 40 of 40 images and 40 sweeps by header time, 10.0 ms apart" in report
    assert "warning" not in report
    assert frames_of(tmp_path / "out") == [(at, at) for at in range(40)]
    report = str(import_recording(bag, tmp_path / "received", clock="received"))
    assert SET_BACK in report
    assert report.count("or take --clock header, which rises") == 1


ORDERS = {
    "parts joined in another order": [*range(20, 40), *range(20)],
    "by name": sorted(range(40), key=str),
    "reversed": range(39, -1, -1),
    "at random": np.random.default_rng(0).permutation(40).tolist(),
}


@pytest.mark.parametrize("order", ORDERS)
def test_messages_that_are_written_in_another_order_are_no_clock_that_is_set_back(tmp_path, order):
    bag = write_set_back_drive(tmp_path / "drive", order=ORDERS[order])
    report = str(import_recording(bag, tmp_path / "out"))
    assert "warning" not in report
    assert frames_of(tmp_path / "out") == [(at, at) for at in range(40)]


def test_two_recorders_of_the_same_messages_are_no_clock_that_is_set_back(tmp_path):
    for name, first, late_ms in (("a", 0, 5), ("b", 10, 9)):
        write_set_back_drive(tmp_path / name, order=range(first, 40), late_ms=late_ms)
        (tmp_path / name / f"{name}.mcap").rename(tmp_path / f"{name}.mcap")
        shutil.rmtree(tmp_path / name)
    report = str(import_recording(tmp_path, tmp_path.with_name("out")))
    assert "go back" not in report
    assert frames_of(tmp_path.with_name("out")) == [(at, at) for at in range(40)]


def test_a_damaged_index_of_messages_leaves_a_drive_readable(tmp_path):
    bag = write_set_back_drive(tmp_path / "drive", order=range(40))
    path = bag / "drive.mcap"
    with open_bag(path) as opened:
        (topic,) = (each for each in opened.topics if each.name == "/points")
        assert len(opened.times_in_files(topic)) == 40
        chunk = opened._readers[0].chunks[0]
    content = bytearray(path.read_bytes())
    for at in chunk.message_index_offsets.values():
        content[at] = 0x70
    path.write_bytes(content)
    with open_bag(path) as opened:
        assert opened.times_in_files(topic) is None
    assert import_recording(bag, tmp_path / "out").written == 40


def test_few_messages_are_no_clock_that_is_set_back():
    for times in ([], [5], [5 * 10**9, 4 * 10**9], [0, 10**9, 2 * 10**9, 16 * 10**8, 3 * 10**9]):
        assert find_set_back(np.array(times, np.int64)) is None


class RenamedBag(OddBag):
    """Bag with one frame renamed from the third message on."""

    def __init__(self, path, renamed, **changes):
        super().__init__(path, **changes)
        self.renamed = renamed

    def header(self, frame, time_ns):
        late = frame == self.renamed and time_ns > START_NS + 150 * 10**6
        return super().header("rear" if late else frame, time_ns)


@pytest.mark.parametrize(
    ("renamed", "topic"), [("lidar", "/points"), ("camera_optical", "/front/image_raw")]
)
def test_messages_of_another_frame_are_dropped_and_told(tmp_path, renamed, topic, monkeypatch):
    monkeypatch.setitem(globals(), "OddBag", lambda path: RenamedBag(path, renamed))
    bag = write_drive(tmp_path / "drive")
    report = import_recording(bag, tmp_path / "out")
    assert report.written == 2
    expected = rf"warning: dropped 2 of 4 messages of {topic} that are in frame rear, not {renamed}"
    assert expected in str(report)
    (tmp_path / "calibration.yaml").write_text((tmp_path / "out" / "calibration.yaml").read_text())
    report = import_recording(
        bag, tmp_path / "all", calibration=tmp_path / "calibration.yaml", max_intensity=255.0
    )
    assert report.written == 4
    assert "warning: kept 2 of 4 messages" in str(report)


@pytest.mark.parametrize("compressed", [False, True])
def test_black_pictures_are_counted(tmp_path, compressed):
    _, encoded = cv2.imencode(".png", IMAGE[..., ::-1])
    _, black = cv2.imencode(".png", IMAGE * 0)
    with OddBag(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        for at in range(3):
            time_ns = (at + 1) * 10**9
            bag.info("/front/camera_info", time_ns)
            if compressed:
                content = black if at else encoded
                bag.jpeg("/front/image_raw/compressed", time_ns, content.tobytes())
            else:
                bag.image("/front/image_raw", time_ns, picture=IMAGE * int(at == 0))
            bag.cloud("/points", time_ns)
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert "warning: 2 of 3 images have a single colour, e.g. that of frame 000001" in report
