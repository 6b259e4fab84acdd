"""Detection in sweeps by a trained network, and what edge cases give."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.cli.main import main
from sightline.data.formats.image_file import read_rgb
from sightline.data.formats.kitti_conversion import kitti_from_detections
from sightline.data.formats.kitti_labels import read_results
from sightline.detection3d.files import write_results
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.tilt import Tilt
from sightline.geometry.transforms import transform_points
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.level import level_sample
from tests.detection3d.frames import (
    COMPACT,
    NAMES,
    SWEEP,
    TINY,
    simulated_frames,
    write_network,
)


@pytest.fixture(scope="module", params=[TINY, COMPACT], ids=["points", "pillars"])
def weights(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    write_network(path, request.param)
    return path


@pytest.fixture(scope="module")
def predictor(weights):
    return Detection3DPredictor.load(weights)


@pytest.fixture(scope="module")
def sample():
    return simulated_frames()[0]


def same(a, b):
    return (
        a.class_names == b.class_names
        and torch.equal(a.boxes.tensor, b.boxes.tensor)
        and torch.equal(a.scores, b.scores)
    )


def test_it_answers_alike_each_time_the_surest_first(predictor, sample):
    found = predictor(sample)
    assert len(found.scores) > 0
    assert set(found.class_names) <= set(NAMES)
    assert torch.equal(found.scores, found.scores.sort(descending=True).values)
    assert (found.boxes.sizes > 0).all()
    assert same(found, predictor(sample))
    assert same(found, pickle.loads(pickle.dumps(predictor))(sample))


@pytest.mark.parametrize("count", [0, 1, 2, 30])
def test_tiny_sweeps_have_an_answer(predictor, sample, count):
    found = predictor(replace(sample, points=sample.points[1000 : 1000 + count]))
    assert len(found.scores) <= 20
    assert found.boxes.tensor.isfinite().all()
    if count == 0:
        assert found.class_names == ()


def test_a_sweep_in_other_axes_warns(predictor, sample):
    x, y, z, reflectance = sample.points.unbind(dim=1)
    as_camera = torch.stack((-y, -z, x, reflectance), dim=1)
    with pytest.warns(UserWarning, match="its axes are x forward, y left, z up"):
        predictor(replace(sample, points=as_camera))


def test_points_that_are_not_finite_and_absent_sweeps_are_refused(predictor, sample):
    points = sample.points.clone()
    points[3, 2] = torch.nan
    with pytest.raises(ValueError, match="1 points with NaN or infinite values"):
        predictor(replace(sample, points=points))
    with pytest.raises(ValueError, match="has no sweep, so nothing can be detected"):
        predictor(replace(sample, points=None))


def test_boxes_come_back_in_the_sweeps_own_height(tmp_path, sample):
    """A raised sweep with the matching height offset gives the same boxes, lower by the offset."""
    offset = 0.5
    write_network(tmp_path / "plain.safetensors")
    raised = replace(TINY, input=replace(SWEEP, height_offset_m=offset, in_view=False))
    write_network(tmp_path / "raised.safetensors", raised)
    write_network(
        tmp_path / "plain.safetensors", replace(TINY, input=replace(SWEEP, in_view=False))
    )
    lowered = sample.points - sample.points.new_tensor([0, 0, offset, 0])
    plain, mounted = (
        Detection3DPredictor.load(tmp_path / f"{name}.safetensors") for name in ("plain", "raised")
    )
    expected = plain(replace(sample, points=lowered + lowered.new_tensor([0, 0, offset, 0])))
    found = mounted(replace(sample, points=lowered))
    moved = found.boxes.tensor + found.boxes.tensor.new_tensor([0, 0, offset, 0, 0, 0, 0])
    torch.testing.assert_close(moved, expected.boxes.tensor, atol=1e-4, rtol=0)


@pytest.mark.parametrize("up_m", [-0.5, 0.75])
def test_a_lidar_of_another_height_gets_the_same_boxes_in_its_own_frame(predictor, sample, up_m):
    """What is found does not hang on where the LiDAR's frame has its origin."""
    exact = (sample.points * 1024).round() / 1024  # so that no digit is lost on the way
    sample = replace(sample, points=exact)
    old_from_new = torch.eye(4, dtype=torch.float64)
    old_from_new[2, 3] = up_m
    moved = replace(
        sample,
        points=sample.points - sample.points.new_tensor([0, 0, up_m, 0]),
        calibration=replace(
            sample.calibration,
            camera_from_lidar=sample.calibration.camera_from_lidar @ old_from_new,
        ),
        lidar_height_m=KITTI_LIDAR_HEIGHT_M + up_m,
    )
    for expected, found in zip(
        predictor.both_stages(sample), predictor.both_stages(moved), strict=True
    ):
        shift = expected.boxes.tensor.new_tensor([0, 0, up_m, 0, 0, 0, 0])
        assert len(expected.scores)
        torch.testing.assert_close(
            found.boxes.tensor, expected.boxes.tensor - shift, atol=1e-3, rtol=0
        )
        torch.testing.assert_close(found.scores, expected.scores, atol=1e-4, rtol=0)


@pytest.mark.parametrize(
    ("tilt", "yaw_deg"),
    [(Tilt(roll_deg=3.0, pitch_deg=12.0), 0.0), (Tilt(roll_deg=0.0, pitch_deg=0.0), 90.0)],
    ids=["tilted", "turned"],
)
def test_a_lidar_that_is_tilted_or_turned_gets_the_same_boxes_in_its_own_frame(
    predictor, sample, tilt, yaw_deg, tmp_path
):
    cos, sin = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    turn = np.eye(4)
    turn[:2, :2] = [[cos, sin], [-sin, cos]]
    level_from_lidar = torch.from_numpy(turn @ tilt.level_from_lidar)
    points = sample.points.clone()
    points[:, :3] = transform_points(level_from_lidar.T, points[:, :3])
    camera_from_lidar = sample.calibration.camera_from_lidar @ level_from_lidar
    mounted = replace(
        sample,
        points=points,
        calibration=replace(sample.calibration, camera_from_lidar=camera_from_lidar),
        level_from_lidar=level_from_lidar,
        objects=None,
    )
    exact = replace(sample, points=level_sample(mounted).points)  # to the last bit
    expected, found = predictor(exact), predictor(mounted)
    assert len(expected.scores)
    torch.testing.assert_close(
        transform_points(level_from_lidar, found.boxes.centers),
        expected.boxes.centers,
        atol=1e-3,
        rtol=0,
    )
    for name, each, detections in (("level", exact, expected), ("own", mounted, found)):
        write_results(tmp_path / f"{name}.txt", each, detections)
    level, own = (read_results(tmp_path / f"{name}.txt") for name in ("level", "own"))
    assert own.class_names == level.class_names
    np.testing.assert_allclose(own.locations, level.locations, atol=0.02)
    turned = np.degrees(own.rotation_y - level.rotation_y)
    np.testing.assert_allclose((turned + 180) % 360, 180, atol=1)
    np.testing.assert_allclose(own.boxes2d, level.boxes2d, atol=0.1)


def test_the_command_writes_kittis_result_files(weights, predictor, sample, tmp_path):
    out = tmp_path / "results"
    command = ["predict", "detection3d", str(PACKAGED_FRAMES), str(out), "--workers", "1"]
    assert main([*command, "--weights", str(weights)]) == 0
    written = read_results(out / "000000.txt")
    expected = kitti_from_detections(predictor(sample), sample.calibration, sample.image_size)
    assert written.class_names == expected.class_names
    np.testing.assert_allclose(written.locations, expected.locations, atol=0.01)
    np.testing.assert_allclose(written.boxes2d, expected.boxes2d, atol=0.01)
    np.testing.assert_allclose(written.alpha, expected.alpha, atol=0.01)


def test_a_frame_is_drawn_with_what_was_found(weights, tmp_path):
    out = tmp_path / "frame.png"
    command = ["show", str(PACKAGED_FRAMES), "000000", "--weights", str(weights)]
    assert main([*command, "--out", str(out)]) == 0
    assert read_rgb(out).size
