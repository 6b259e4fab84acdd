import cv2
import numpy as np
import pytest

from sightline.data.importing.import_recording import import_recording
from sightline.data.open import open_dataset
from tests.data.recordings import CAMERA_FROM_LIDAR, IMAGE, POINTS, BagMaker, calibration_entries

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
