"""Yaw and mirroring of clouds, by labels: rooms of boxes whose faces the LiDAR sees."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sightline.data.calibration_text import CalibrationMatrices
from sightline.data.kitti_labels import parse_objects
from sightline.data.label_yaw import LabelledSweep, check_label_yaw
from sightline.data.object_tree import ObjectFrame
from sightline.data.open import open_dataset
from sightline.data.tree_checks import find_trees

CAMERA_FROM_LIDAR = np.array(
    [[0.0, -1.0, 0.0, 0.1], [0.0, 0.0, -1.0, -0.1], [1.0, 0.0, 0.0, -0.3], [0, 0, 0, 1]]
)
SIZE_HWL = (1.5, 1.6, 3.9)


def turn(yaw_deg):
    cos, sin = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    turned = np.eye(4)
    turned[:2, :2] = [[cos, -sin], [sin, cos]]
    return turned


def scene(seed, *, yaw_deg=0.0, is_mirrored=False, num_objects=4):
    """Cars ahead with points on their sides; the calibration turns clouds by `yaw_deg` too far."""
    rng = np.random.default_rng(seed)
    lines, clouds = [], []
    for _ in range(num_objects):
        x, z, rotation = rng.uniform(-12, 12), rng.uniform(8, 35), rng.uniform(-3, 3)
        lines.append(f"Car 0 0 0 100 100 200 200 1.5 1.6 3.9 {x:.2f} 1.6 {z:.2f} {rotation:.2f}")
        height, width, length = SIZE_HWL
        along, across = rng.uniform(-0.49, 0.49, (2, 200)) * np.array([[length], [width]])
        across[:100] = np.sign(across[:100]) * width * 0.48  # a side of the car
        cos, sin = math.cos(rotation), math.sin(rotation)
        up = rng.uniform(0.3, height, 200)
        clouds.append(
            np.column_stack(
                (x + cos * along + sin * across, 1.6 - up, z - sin * along + cos * across)
            )
        )
    camera = np.concatenate(clouds)
    lidar_from_camera = np.linalg.inv(CAMERA_FROM_LIDAR)
    points = camera @ lidar_from_camera[:3, :3].T + lidar_from_camera[:3, 3]
    if is_mirrored:
        points[:, 1] *= -1
    return LabelledSweep(
        objects=parse_objects("\n".join(lines).encode(), "labels", with_scores=False),
        matrices=CalibrationMatrices(
            image_from_camera=np.eye(3, 4), camera_from_lidar=CAMERA_FROM_LIDAR @ turn(yaw_deg)
        ),
        points=np.column_stack((points, np.full(len(points), 0.3))).astype(np.float32),
    )


def told(tmp_path, num_frames, **settings):
    frames = [
        ObjectFrame(sample_id=str(number), points=tmp_path, calibration=tmp_path, objects=tmp_path)
        for number in range(num_frames)
    ]
    return [each.problem for each in found(frames, **settings)]


def found(frames, **settings):
    return check_label_yaw(frames, lambda frame: scene(int(frame.sample_id), **settings))


def test_sound_frames_raise_no_doubt(tmp_path):
    assert told(tmp_path, 5) == []
    assert told(tmp_path, 60) == []
    assert told(tmp_path, 0) == []


@pytest.mark.parametrize("yaw_deg", [3.0, -3.0, 1.5, 6.0])
def test_a_calibration_that_is_off_in_yaw_is_told_with_the_angle(tmp_path, yaw_deg):
    (said,) = told(tmp_path, 5, yaw_deg=yaw_deg)
    assert f"seem to be off by {-yaw_deg:+.1f} degrees of yaw" in said


@pytest.mark.parametrize(("yaw_deg", "is_limit"), [(3.0, False), (8.0, True)])
def test_at_the_limit_of_the_search_other_causes_are_named(tmp_path, yaw_deg, is_limit):
    frame = ObjectFrame(sample_id="", points=tmp_path, calibration=tmp_path, objects=tmp_path)
    frames = [replace(frame, sample_id=str(number)) for number in range(5)]
    (problem,) = found(frames, yaw_deg=yaw_deg)
    assert ("scale or offset" in problem.remedy) == is_limit


def test_mirrored_clouds_are_told_as_such(tmp_path):
    (said,) = told(tmp_path, 5, is_mirrored=True)
    assert "seem to be of mirrored clouds" in said


def test_few_objects_and_frames_without_points_say_nothing(tmp_path):
    assert told(tmp_path, 2, yaw_deg=3.0) == []
    assert told(tmp_path, 9, yaw_deg=3.0, num_objects=1) == []
    frame = ObjectFrame(sample_id="0", objects=tmp_path)
    assert check_label_yaw([frame] * 20, lambda _: scene(0, yaw_deg=3.0)) == []
    whole = ObjectFrame(sample_id="0", points=tmp_path, calibration=tmp_path, objects=tmp_path)
    assert check_label_yaw([whole] * 20, lambda _: None) == []


@pytest.mark.parametrize(("change", "said"), [("yaw", "degrees of yaw"), ("mirror", "mirrored")])
def test_real_frames_are_told_only_where_they_are_changed(tmp_path, kitti_root, change, said):
    for name in [frame.sample_id for frame in open_dataset(kitti_root).frames][:12]:
        for part, end in (("image_2", "png"), ("label_2", "txt"), ("calib", "txt")):
            (tmp_path / "training" / part).mkdir(parents=True, exist_ok=True)
            file = f"{part}/{name}.{end}"
            (tmp_path / "training" / file).symlink_to(kitti_root / "training" / file)
        cloud = np.fromfile(kitti_root / "training" / "velodyne" / f"{name}.bin", "<f4")
        cloud = cloud.reshape(-1, 4)
        turned = turn(3.0) if change == "yaw" else np.diag([1.0, -1.0, 1.0, 1.0])
        cloud[:, :3] = cloud[:, :3] @ turned[:3, :3].T
        (tmp_path / "training" / "velodyne").mkdir(exist_ok=True)
        cloud.tofile(tmp_path / "training" / "velodyne" / f"{name}.bin")
    for root, expected in ((tmp_path, 1), (kitti_root, 0)):
        (tree,) = find_trees(root)
        (check,) = (each for each in tree.checks if each.subject == "agreement of frames")
        problems = [each.problem for each in check.run()]
        assert len(problems) == expected
        assert all(said in problem for problem in problems)
