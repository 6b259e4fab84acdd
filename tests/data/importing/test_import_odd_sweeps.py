"""Bags with odd sweeps: turned sensors, other scales of intensities, first turns that are odd."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from sightline.data.check import check_tree
from sightline.data.formats.recording_calibration import read_recording_calibration
from sightline.data.importing.import_recording import ImportReport, import_recording
from sightline.data.open import open_dataset
from sightline.files.problem import FileError
from tests.data.recordings import BASE_FROM_LIDAR, CAMERA_FROM_BASE, POINTS, SAMPLE, BagMaker

FULL = POINTS * np.float32([1, 1, 1, 255])
BY_AZIMUTH = np.argsort(np.arctan2(FULL[:, 1], FULL[:, 0]))


def imported(folder, sweeps, base_from_lidar=BASE_FROM_LIDAR, **options) -> ImportReport:
    """Import a bag with these sweeps, an image for each."""
    with BagMaker(folder / "drive") as bag:
        bag.transforms(
            "/tf_static",
            10**9,
            base_link__lidar=base_from_lidar,
            camera_optical__base_link=CAMERA_FROM_BASE,
        )
        for number, points in enumerate(sweeps):
            time_ns = 2 * 10**9 + number * 10**8
            bag.info("/front/camera_info", time_ns)
            bag.image("/front/image_raw", time_ns)
            bag.cloud("/points", time_ns, points=np.float32(points))
    return import_recording(folder / "drive", folder / "out", **options)


def distinct(points, count):
    """Sweeps that differ in the intensity of their last point."""
    sweeps = np.repeat(points[None], count, axis=0)
    sweeps[:, -1, 3] = np.arange(count)
    return list(sweeps)


def test_a_lidar_that_is_level_by_tf_and_tilted_by_the_road_is_told(tmp_path):
    turned = FULL.copy()
    turned[:, :3] = FULL[:, :3] @ Rotation.from_euler("y", 6, degrees=True).as_matrix().T
    report = str(imported(tmp_path / "turned", distinct(turned, 3)))
    assert (
        "warning: by TF the LiDAR is level on the vehicle, by the road in its clouds it" in report
    )
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_euler("y", -6, degrees=True).as_matrix()
    for folder, sweep, pose in (
        ("level", FULL, BASE_FROM_LIDAR),
        ("right", turned, BASE_FROM_LIDAR @ mount),
    ):
        report = str(imported(tmp_path / folder, distinct(sweep, 3), pose))
        assert "level on the vehicle" not in report
    calibration = tmp_path / "turned" / "out" / "calibration.yaml"
    calibration.write_text(calibration.read_text() + "lidar_tilt_deg: {roll: 0, pitch: 6}\n")
    again = str(import_recording(tmp_path / "turned" / "drive", tmp_path / "turned" / "out"))
    assert "level on the vehicle" not in again


@pytest.mark.parametrize(
    ("axis", "angle_deg", "said"),
    [
        ("x", 180, "the LiDAR's -z points up, by its calibration and the road: clouds are written"),
        ("y", 180, "points x, y, z become x, -y, -z"),
        ("x", 90, "the LiDAR's y points up"),
        ("x", -90, "the LiDAR's -y points up"),
        ("y", 90, "the LiDAR's -x points up"),
    ],
)
def test_a_lidar_upside_down_or_on_its_side_is_turned(tmp_path, axis, angle_deg, said):
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()
    turned = FULL.copy()
    turned[:, :3] = FULL[:, :3] @ mount[:3, :3]
    report = str(imported(tmp_path, distinct(turned, 2), BASE_FROM_LIDAR @ mount))
    assert said in report
    assert "warning" not in report
    sample = open_dataset(tmp_path / "out")[0]
    torch.testing.assert_close(sample.points[:-1], SAMPLE.points[:-1])
    torch.testing.assert_close(
        sample.calibration.image_from_lidar.float(), SAMPLE.calibration.image_from_lidar.float()
    )


@pytest.mark.parametrize(("axis", "angle_deg"), [("z", 30), ("z", 90), ("x", 180), ("x", 0)])
def test_the_calibration_of_an_import_does_for_another_of_the_same_rig(tmp_path, axis, angle_deg):
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()
    turned = FULL.copy()
    turned[:, :3] = FULL[:, :3] @ mount[:3, :3]
    imported(tmp_path, distinct(turned, 2), BASE_FROM_LIDAR @ mount)
    first, again = tmp_path / "out", tmp_path / "again"
    import_recording(tmp_path / "drive", again, calibration=first / "calibration.yaml")
    text = (first / "calibration.yaml").read_text()
    (first / "calibration.yaml").write_text(text.partition("clouds_from_source")[0])
    assert "is kept" not in str(
        import_recording(tmp_path / "drive", first)
    )  # of an earlier version
    (first / "calibration.yaml").write_text(text)
    assert ("clouds_from_source" in (first / "calibration.yaml").read_text()) == (angle_deg > 0)
    one, other = (read_recording_calibration(each / "calibration.yaml") for each in (first, again))
    for name in ("camera_from_lidar", "image_from_camera"):
        matrices = [getattr(each.matrices, name) for each in (one, other)]
        np.testing.assert_allclose(*matrices, atol=1e-9)
    for path in sorted((first / "points").iterdir()):
        clouds = [np.fromfile(each / "points" / path.name, np.float32) for each in (first, again)]
        np.testing.assert_allclose(*clouds, atol=1e-4)


@pytest.mark.parametrize(("axis", "angle_deg"), [("x", 0), ("x", 180), ("y", 180), ("x", 90)])
def test_a_turned_lidar_keeps_its_tilt_by_tf(tmp_path, axis, angle_deg):
    turn, pitch = np.eye(4), np.eye(4)
    turn[:3, :3] = Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()
    pitch[:3, :3] = Rotation.from_euler("y", -2.5, degrees=True).as_matrix()
    mount = pitch @ turn
    turned = FULL.copy()
    turned[:, :3] = FULL[:, :3] @ mount[:3, :3]
    imported(tmp_path, distinct(turned, 2), BASE_FROM_LIDAR @ mount)
    tilt = read_recording_calibration(tmp_path / "out" / "calibration.yaml").lidar_tilt
    assert (tilt.roll_deg, tilt.pitch_deg) == pytest.approx((0.0, -2.5), abs=1e-3)


@pytest.mark.parametrize("is_upright", [True, False])
def test_the_calibration_of_a_lidar_upside_down_for_clouds_without_that_is_refused(
    tmp_path, is_upright
):
    """They are upright, or show no road."""
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_euler("yx", [11, 180], degrees=True).as_matrix()
    turned = FULL.copy()
    turned[:, :3] = FULL[:, :3] @ mount[:3, :3]
    imported(tmp_path, distinct(turned, 2), BASE_FROM_LIDAR @ mount)
    calibration = tmp_path / "out" / "calibration.yaml"
    assert "clouds_from_source" in calibration.read_text()
    other = FULL if is_upright else turned[FULL[:, 2] > 0]
    (tmp_path / "other").mkdir()
    with pytest.raises(
        FileError, match=r"calibration\.yaml: does not fit the clouds of this bag: "
    ):
        imported(tmp_path / "other", distinct(other, 2), calibration=calibration)


def test_a_lidar_upside_down_whose_calibration_is_of_one_upright_is_refused(tmp_path):
    with pytest.raises(FileError, match=r"-z points up: .*convert only the points"):
        imported(tmp_path, distinct(FULL * np.float32([1, -1, -1, 1]), 2))


@pytest.mark.parametrize(
    ("largest", "scale"),
    [(0.99, 1), (99, 255), (255, 255), (1020, 1023), (4080, 4095), (60_000, 65535)],
)
def test_the_scale_of_intensities_is_guessed_by_bits(tmp_path, largest, scale):
    points = POINTS * np.float32([1, 1, 1, largest / POINTS[:, 3].max()])
    report = str(imported(tmp_path, [points]))
    assert f"intensities of 0 to {scale}\n" in report
    found = open_dataset(tmp_path / "out")[0].points[:, 3].max()
    assert found == pytest.approx(largest / scale, rel=1e-3)


@pytest.mark.parametrize(("scale", "guessed"), [(1000, 1023), (200, 255)])
def test_later_sweeps_above_the_guessed_scale_are_kept_and_told(tmp_path, scale, guessed):
    sweeps = distinct(POINTS * np.float32([1, 1, 1, scale]), 13)
    for number in (1, 7):  # between the sweeps that are tried
        sweeps[number][: len(POINTS) // 2, 3] = 1500
    report = str(imported(tmp_path, sweeps))
    assert f"intensities of 0 to {guessed}" in report
    assert "13 frames written" in report
    assert "warning: 2 sweeps, e.g. that of frame 000001, have more than one point in a" in report
    assert open_dataset(tmp_path / "out")[1].points[:, 3].max() == 1
    (tmp_path / "given").mkdir()
    given = imported(tmp_path / "given", sweeps, max_intensity=2000.0)
    assert "have more than one point" not in str(given)


@pytest.mark.parametrize("empty", [0.0, np.nan])
def test_the_scale_is_exceeded_by_points_with_an_echo_alone(tmp_path, empty):
    sweeps = distinct(np.repeat(FULL, 2, axis=0), 13)
    for sweep in sweeps:
        sweep[::2, :3] = empty
        sweep[::2, 3] = 65535
    sweeps[1][1 : len(FULL) : 32, 3] = 600  # 1.6 % of the echoes, 0.8 % of the rows
    report = str(imported(tmp_path, sweeps))
    assert "intensities of 0 to 255" in report
    assert "13 frames written" in report
    assert "warning: 1 sweeps, e.g. that of frame 000001, have more than one point in a" in report


def test_one_bright_sweep_does_not_decide_the_scale_of_intensities(tmp_path):
    sweeps = distinct(FULL, 5)
    sweeps[3][::20, 3] = 600
    report = str(imported(tmp_path, sweeps))
    assert "intensities of 0 to 255" in report
    assert "warning: 1 sweeps, e.g. that of frame 000003, have more than one point in a" in report


@pytest.mark.parametrize("fault", ["negative", "millimetres"])
def test_one_faulty_sweep_does_not_decide_the_scale_of_intensities(tmp_path, fault):
    sweeps = distinct(FULL, 5)
    if fault == "negative":
        sweeps[2][5, 3] = -3
    else:
        sweeps[0][:, :3] *= 1000
    report = str(imported(tmp_path, sweeps))
    assert "intensities of 0 to 255" in report
    assert "warning: dropped 1 unreadable frames; the first: " in report
    assert open_dataset(tmp_path / "out")[0].points[:, 3].max() > 0.9


def test_doubtful_intensities_are_told_once_and_refuse_no_import(tmp_path):
    constant = [points.copy() for points in distinct(FULL, 3)]
    for number, points in enumerate(constant):
        points[:, 3] = 100
        points[-1, 0] += number  # sweeps differ
    report = str(imported(tmp_path, constant))
    assert report.count("warning") == 1
    said = "warning: in 3 of 3 sweeps, e.g. that of frame 000000, all intensities are 100, so"
    assert said in report
    assert "3 frames written" in report
    (tmp_path / "sorted").mkdir()
    report = str(imported(tmp_path / "sorted", [FULL[np.argsort(FULL[:, 3])]]))
    assert "that of frame 000000, intensities only rise along the cloud" in report


def test_a_doubt_about_one_sweep_has_no_remedy_for_all(tmp_path):
    sweeps = distinct(FULL, 6)
    sweeps[3][:, 3] /= 200
    report = str(imported(tmp_path, sweeps))
    said = "warning: in 1 of 6 sweeps, e.g. that of frame 000003, intensities are below a hundredth"
    assert said in report
    assert "look at what the LiDAR delivered in these frames" in report
    assert "--max-intensity" not in report


def test_doubts_of_different_kinds_are_told_apart(tmp_path):
    sweeps = distinct(FULL, 5)
    sweeps[0][:, 3] = np.linalg.norm(sweeps[0][:, :3], axis=1)
    for number in (1, 2):
        sweeps[number][:, 3] = number
    report = str(imported(tmp_path, sweeps))
    assert "in 1 of 5 sweeps, e.g. that of frame 000000, intensities are the points' dist" in report
    assert "in 2 of 5 sweeps, e.g. that of frame 000001, all intensities are 1, so" in report


@pytest.mark.parametrize("bright", [(0,), (3, 4), (3, 6, 9), range(13), (1, 7)])
def test_retroreflectors_above_shares_are_limited_and_told(tmp_path, bright):
    sweeps = [points / np.float32([1, 1, 1, 255]) for points in distinct(FULL, 13)]
    for number in bright:  # 0, 3, 6, 9 and 12 are tried
        sweeps[number][::40, 3] = 1.5
    for folder, scale in (("guessed", None), ("given", 1.0)):
        (tmp_path / folder).mkdir()
        report = str(imported(tmp_path / folder, sweeps, max_intensity=scale))
        assert "13 frames written" in report
        assert "intensities of 0 to 1\n" in report
        assert f"warning: {len(bright)} sweeps, e.g. that of frame {bright[0]:06}, have " in report
        assert "one point in a hundred above 1, the intensity of a reflectance of 1" in report
        found = open_dataset(tmp_path / folder / "out")[bright[0]].points
        np.testing.assert_array_equal(found.numpy()[:, 3], sweeps[bright[0]][:, 3].clip(max=1))


def test_a_few_far_brighter_points_do_not_decide_the_scale_of_shares(tmp_path):
    sweeps = [points / np.float32([1, 1, 1, 255]) for points in distinct(FULL, 6)]
    for sweep in sweeps:
        sweep[::40, 3] = 1.5
        sweep[::30, 3] = np.geomspace(1.5, 10_000, len(sweep[::30]))
    report = str(imported(tmp_path, sweeps))
    assert "intensities of 0 to 1\n" in report
    assert "warning: 6 sweeps, e.g. that of frame 000000, have more than one point" in report


def test_doubts_are_those_of_the_intensities_before_they_are_limited(tmp_path):
    sweeps = distinct(FULL, 6)
    for sweep in sweeps:
        sweep[:, 3] = np.linalg.norm(sweep[:, :3], axis=1)
    farthest = float(np.quantile(sweeps[0][:, 3], 0.95))
    report = str(imported(tmp_path, sweeps, max_intensity=farthest))
    assert "in 6 of 6 sweeps, e.g. that of frame 000000, intensities are the points' dist" in report


@pytest.mark.parametrize("scale", [1.0, 255.0])
def test_sweeps_far_above_a_given_scale_are_dropped(tmp_path, scale):
    sweeps = distinct(FULL * np.float32([1, 1, 1, scale / 255]), 6)
    sweeps[5][::8, 3] = 2 * scale
    report = str(imported(tmp_path, sweeps, max_intensity=scale))
    assert "5 frames written" in report
    assert "warning: dropped 1 unreadable frames; the first: " in report


@pytest.mark.parametrize("num_dark", [1, 3, 4])
def test_dark_sweeps_of_whole_numbers_are_not_taken_for_shares(tmp_path, num_dark):
    sweeps = distinct(FULL, 5)
    for sweep in sweeps:
        sweep[:, 3] = sweep[:, 3].round()
    for number, sweep in enumerate(sweeps[:num_dark]):
        sweep[:, 3] = np.arange(len(sweep)) % (20 + number) == 0
        sweep[::400, 3] = 2
    report = str(imported(tmp_path, sweeps))
    assert "intensities of 0 to 255" in report
    assert "5 frames written" in report


def test_dark_sweeps_with_some_far_brighter_points_are_not_taken_for_shares(tmp_path):
    sweeps = distinct(FULL / np.float32([1, 1, 1, 10_000]), 5)  # as in fog
    for sweep in sweeps:
        sweep[::20, 3] *= 10_000
    assert "intensities of 0 to 255" in str(imported(tmp_path, sweeps))


@pytest.mark.parametrize("num_zero", [3, 4])
def test_sweeps_of_zeros_do_not_decide_the_scale_of_intensities(tmp_path, num_zero):
    sweeps = distinct(FULL, 5)
    for number, sweep in enumerate(sweeps[:num_zero]):
        sweep[:, 3] = 0
        sweep[-1, 0] += number
    report = str(imported(tmp_path, sweeps))
    assert "intensities of 0 to 255" in report
    assert "5 frames written" in report


def test_a_doubtful_first_sweep_is_told_and_refuses_no_others(tmp_path):
    report = str(imported(tmp_path, [FULL[BY_AZIMUTH[:10]], *distinct(FULL, 3)]))
    assert "warning: frame 000000 holds only 10 points, expected thousands" in report
    assert "4 frames written" in report


def test_sweeps_above_the_guessed_scale_are_counted_once(tmp_path):
    bright = FULL.copy()
    bright[::2, 3] = 1000
    # The first is doubtful, so the second is tried, too.
    report = str(imported(tmp_path, [FULL[BY_AZIMUTH[:10]], bright, *distinct(FULL, 7)]))
    assert "warning: 1 sweeps, e.g. that of frame 000001, have more than one point" in report


def test_several_doubtful_and_empty_first_sweeps_refuse_no_others(tmp_path):
    ten = [FULL[BY_AZIMUTH[each : each + 10]] for each in (0, 20)]
    report = str(imported(tmp_path, [*[FULL[:0]] * 4, *ten, *distinct(FULL, 4)]))
    assert "10 frames written" in report
    assert "warning: frame 000004 holds only 10 points" in report
    assert "by the road in its clouds the LiDAR is" in report


def test_a_lidar_that_starts_late_is_judged_by_later_sweeps(tmp_path):
    down = distinct(FULL * np.float32([1, -1, -1, 1]), 3)
    with pytest.raises(FileError, match=r"-z points up"):
        imported(tmp_path, [*[FULL[:0]] * 6, *down])


def test_doubtful_sweeps_alone_are_refused(tmp_path):
    sweeps = [FULL[BY_AZIMUTH[each : each + 10]] for each in (0, 20, 40)]
    with pytest.raises(FileError, match="unusable recording: it holds only 10 points"):
        imported(tmp_path, sweeps)
    assert not (tmp_path / "out").exists()


def test_a_first_sweep_of_a_part_of_a_turn_does_not_blame_the_calibration(tmp_path, recwarn):
    behind = FULL[BY_AZIMUTH[:3000]] * np.float32([-1, 1, 1, 1])
    report = str(imported(tmp_path, [behind, *distinct(FULL, 3)]))
    assert "100.0 % of the points of frame 000001 fall into the image" in report
    assert "warning" not in report
    open_dataset(tmp_path / "out")
    assert not recwarn.list
    (problem,) = check_tree(tmp_path / "out")
    assert "projects only 0 of the 3000 points of frame 000000" in problem.problem
    assert problem.remedy.endswith("part of a turn or of another time: leave its frame out")


def test_an_empty_first_sweep_is_not_the_one_that_is_judged(tmp_path):
    (tmp_path / "down").mkdir()
    down = distinct(FULL * np.float32([1, -1, -1, 1]), 3)
    with pytest.raises(FileError, match="-z points up"):
        imported(tmp_path / "down", [down[0][:0], *down])
    aside = np.stack((-FULL[:, 1], FULL[:, 0], FULL[:, 2], FULL[:, 3]), axis=1)
    report = str(imported(tmp_path, [aside[:0], *distinct(aside, 3)]))
    said = f"projects only 0 of the {len(FULL)} points of frame 000001 into the image"
    assert said in report
    with pytest.warns(UserWarning, match=said):
        open_dataset(tmp_path / "out")
