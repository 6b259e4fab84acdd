import json
import shutil
import warnings

import cv2
import numpy as np
import pytest

from sightline.cli.main import main
from sightline.data.formats.velodyne import read_sweep, write_sweep
from sightline.data.sharding import write_shards
from sightline.health.shipped import choose_shipped
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.data import recordings, trees


def test_a_drive_is_printed_drawn_and_written(tmp_path, capsys):
    picture, report = tmp_path / "health.png", tmp_path / "health.json"
    given = ["health", str(PACKAGED_FRAMES), "--picture", str(picture), "--json", str(report)]
    assert main(given) == 0
    out = capsys.readouterr().out
    assert "000000" in out
    assert "000001" in out
    frames = json.loads(report.read_text())["frames"]
    assert [frame["frame"] for frame in frames] == ["000000", "000001"]
    assert all(frame["alarms"] == dict.fromkeys(frame["alarms"], False) for frame in frames)
    assert cv2.imread(str(picture)).shape[1] == 1000


@pytest.mark.parametrize(
    ("sensor", "file"), [("camera", "image_2/000001.png"), ("lidar", "velodyne/000001.bin")]
)
def test_a_sensor_that_delivered_nothing_is_a_result(tmp_path, capsys, sensor, file):
    tree = tmp_path / "KITTI"
    shutil.copytree(PACKAGED_FRAMES, tree)
    (tree / "training" / file).unlink()
    assert main(["health", str(tree), "--json", str(tmp_path / "health.json")]) == 0
    frames = json.loads((tmp_path / "health.json").read_text())["frames"]
    assert frames[1][sensor] == {"score": 0.0, "worst_check": "absent"}
    assert frames[1]["alignment"] is None
    assert frames[1]["alarms"] == {**frames[0]["alarms"], sensor: True}
    assert "absent" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("thinned", "is_reported"), [(("000000", "000001"), True), (("000000",), False)]
)
def test_limits_of_fewer_beams_are_chosen_and_reported_where_all_sweeps_have_fewer_rings(
    tmp_path, recwarn, thinned, is_reported
):
    shutil.copytree(PACKAGED_FRAMES, tmp_path / "KITTI")
    for name in thinned:
        path = tmp_path / "KITTI" / "training" / "velodyne" / f"{name}.bin"
        points = read_sweep(path)
        ring = np.cumsum(np.diff(np.arctan2(points[:, 1], points[:, 0]), prepend=0) < -1)
        write_sweep(path, points[ring % 2 == 0])
    report = tmp_path / "health.json"
    assert main(["health", str(tmp_path / "KITTI"), "--json", str(report)]) == 0
    content = json.loads(report.read_text())
    assert ("32 beams" in content["limits"]["lidar"]) == is_reported
    assert any("judged as of 32 beams" in each for each in content["warnings"]) == is_reported
    assert any("judged as of 32 beams" in str(each.message) for each in recwarn.list) == is_reported
    assert content["frames"][1]["alarms"]["lidar"] is not is_reported


@pytest.mark.parametrize("suffix", [".jpg", ".JPG", ".jpeg"])
@pytest.mark.parametrize("layout", ["recording", "tree", "drive", "shards"])
def test_pictures_are_recognised_as_jpeg_by_most_files_of_the_used_frames(
    tmp_path, monkeypatch, layout, suffix
):
    names = ("000000", "000001", "000002")
    if layout == "recording":
        data = recordings.write_recording(tmp_path / "data", names)
    elif layout == "drive":
        data = trees.write_drive(tmp_path / "data")
    else:
        data = trees.write_object_tree(tmp_path / "data", *names)
    pictures = sorted(data.rglob("image*/**/*.*g"))
    for number, picture in enumerate(pictures):
        written = picture.with_suffix(".png" if number == 0 else suffix)
        image = cv2.imread(str(picture))
        picture.unlink()
        written.write_bytes(cv2.imencode(written.suffix.lower(), image)[1].tobytes())
    if layout == "shards":
        write_shards(data, tmp_path / "shards", frames_per_shard=2)
        data = tmp_path / "shards"
    asked = []
    monkeypatch.setattr(
        "sightline.health.shipped.choose_shipped",
        lambda checks, **given: asked.append(given["are_jpeg_files"]) or choose_shipped(checks),
    )
    (tmp_path / "two.txt").write_text("".join(f"{each.stem}\n" for each in pictures[:2]))
    for given in ([], ["--sample-list", str(tmp_path / "two.txt")]):
        with warnings.catch_warnings(action="ignore"):  # the pictures are small
            assert main(["health", str(data), *given]) == 0
    assert asked == [True, False]


def test_the_kind_of_sensors_can_be_given(tmp_path):
    report = tmp_path / "health.json"
    given = ["--images", "jpeg", "--lidar-beams", "32", "--json", str(report)]
    assert main(["health", str(PACKAGED_FRAMES), *given]) == 0
    assert json.loads(report.read_text())["limits"] == {
        "camera": "shipped, JPEG pictures (as given)",
        "lidar": "shipped, 32 beams (as given)",
    }


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["health", "nowhere"], "nowhere: does not exist"),
        (["health", str(PACKAGED_FRAMES), "--limits", "none.json"], "none.json"),
        (["health", str(PACKAGED_FRAMES), "--fit-first", "9"], "at least 10 frames, got 9"),
        (["health", str(PACKAGED_FRAMES), "--fit-first", "10"], "at least 10 frames"),
        (["health", str(PACKAGED_FRAMES), "--lidar-beams", "8"], "64, 32, 16 beams, got 8"),
        (
            ["health", str(PACKAGED_FRAMES), "--lidar-beams", "64", "--limits", "l.json"],
            "leave these out",
        ),
        (["health-limits", str(PACKAGED_FRAMES), "limits.json"], "at least 100 clean frames"),
        (
            ["evaluate", "calibration", "r", "l", "--out", "o"],
            "--out needs --fit-results and one --calibrator",
        ),
        (["evaluate", "calibration", "r", "l", "--calibrator", "platt"], "results to fit on"),
        (
            ["evaluate", "calibration", "r", "l", "--fit-list", "train.txt"],
            "results to fit on",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(tmp_path, monkeypatch, capsys, given, message):
    monkeypatch.chdir(tmp_path)
    assert main(given) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert not (tmp_path / "limits.json").exists()
