"""Clouds that are moved, turned, scaled or mirrored, by labels: cars whose sides the LiDAR sees."""

import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.data.check import check_tree
from sightline.data.checks.label_alignment import LabelledSweep, check_label_alignment
from sightline.data.checks.tree_checks import find_trees
from sightline.data.formats.kitti_calibration import CalibrationMatrices, read_object_matrices
from sightline.data.formats.kitti_labels import parse_objects, read_labels
from sightline.data.formats.velodyne import read_sweep
from sightline.data.layouts.kitti_trees import ObjectFrame
from sightline.data.open import open_dataset

CAMERA_FROM_LIDAR = np.array(
    [[0.0, -1.0, 0.0, 0.1], [0.0, 0.0, -1.0, -0.1], [1.0, 0.0, 0.0, -0.3], [0, 0, 0, 1]]
)
SIZE_HWL = (1.5, 1.6, 3.9)


def turn(degrees, axis="z"):
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return turned


def move(axis, metres):
    moved = np.eye(4)
    moved[axis, 3] = metres
    return moved


MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


def scene(seed, *, change=None, num_objects=4, write=lambda y, rotation: (y, rotation)):
    """Cars ahead with points on their sides; the cloud is changed, or what the labels hold."""
    rng = np.random.default_rng(seed)
    lines, clouds = [], []
    for _ in range(num_objects):
        x, z, rotation = rng.uniform(-12, 12), rng.uniform(8, 35), rng.uniform(-3, 3)
        y, written = write(1.6, rotation)
        lines.append(f"Car 0 0 0 100 100 200 200 1.5 1.6 3.9 {x:.2f} {y} {z:.2f} {written:.2f}")
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
    changed_from_camera = (np.eye(4) if change is None else change) @ np.linalg.inv(
        CAMERA_FROM_LIDAR
    )
    points = camera @ changed_from_camera[:3, :3].T + changed_from_camera[:3, 3]
    return LabelledSweep(
        objects=parse_objects("\n".join(lines).encode(), "labels", with_scores=False),
        matrices=CalibrationMatrices(
            image_from_camera=np.eye(3, 4), camera_from_lidar=CAMERA_FROM_LIDAR
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
    return check_label_alignment(frames, lambda frame: scene(int(frame.sample_id), **settings))


def test_sound_frames_raise_no_doubt(tmp_path):
    assert told(tmp_path, 5) == []
    assert told(tmp_path, 60) == []
    assert told(tmp_path, 0) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (turn(3.0), "off by -3.0 degrees of yaw"),
        (turn(-1.5), "off by +1.5 degrees of yaw"),
        (turn(6.0), "off by -6.0 degrees of yaw"),
        (turn(3.5, "y"), "off by -3.5 degrees of pitch"),
        (turn(-3.5, "y"), "off by +3.5 degrees of pitch"),
        (turn(5.0, "x"), "off by -5.0 degrees of roll"),
        (move(2, 1.0), "off by -1.0 m along the LiDAR's z axis (up)"),
        (move(2, -0.6), "off by +0.6 m along the LiDAR's z axis (up)"),
        (move(1, 0.8), " m along the LiDAR's y axis (left)"),
        (move(0, -1.4), " m along the LiDAR's x axis (forward)"),
        (np.diag([0.3048, 0.3048, 0.3048, 1.0]), "clouds not in metres (factor 3.281)"),
        (MIRROR, "of mirrored clouds"),
        (turn(180), "turned by +180 degrees about the LiDAR's z axis"),
        (turn(90), "turned by -90 degrees about the LiDAR's z axis"),
    ],
)
def test_a_change_to_all_clouds_is_told_with_its_remedy(tmp_path, change, said):
    (problem,) = told(tmp_path, 12, change=change)
    assert "are probably " in problem
    assert said in problem


@pytest.mark.parametrize(("step", "said"), [(1, "previous"), (-1, "next")])
@pytest.mark.parametrize("drive_m", [None, 1.5])  # other streets, or one drive
def test_clouds_of_the_neighbouring_frame_are_told(tmp_path, step, said, drive_m):
    frames = [
        ObjectFrame(sample_id=str(number), points=tmp_path, calibration=tmp_path, objects=tmp_path)
        for number in range(12)
    ]

    def read(frame):
        number = int(frame.sample_id)
        if drive_m is None:
            return replace(scene(number + 1), points=scene(number + 1 + step).points)
        sweep = scene(7, num_objects=12)
        camera_moved = np.array([0, 0, -drive_m * number])
        objects = replace(sweep.objects, locations=sweep.objects.locations + camera_moved)
        lidar_moved = np.float32([-drive_m * (number + step), 0, 0, 0])
        return replace(sweep, objects=objects, points=sweep.points + lidar_moved)

    problems = check_label_alignment(frames, read)
    assert f"fit the clouds of the {said} frame better than their own" in problems[0].problem
    assert "shifted by one frame" in problems[0].remedy


@pytest.mark.parametrize(
    ("write", "said"),
    [
        (lambda y, rotation: (y - 0.75, rotation), "the y of the box's centre"),
        (lambda y, rotation: (y, -rotation), "a negated rotation_y"),
        (lambda y, rotation: (y, -rotation - math.pi / 2), "the LiDAR frame's yaw"),
        (lambda y, rotation: (y, rotation + math.pi / 2), "a rotation_y that is a quarter turn"),
        (lambda y, rotation: (y, rotation - math.pi / 2), "a rotation_y that is a quarter turn"),
    ],
)
def test_labels_of_another_convention_are_told_as_faults_of_the_labels(tmp_path, write, said):
    labels = tmp_path / "labels.txt"
    frame = ObjectFrame(sample_id="", points=tmp_path, calibration=tmp_path, objects=labels)
    frames = [replace(frame, sample_id=str(number)) for number in range(12)]
    (problem,) = found(frames, write=write)
    assert f"are probably written with {said}" in problem.problem
    assert problem.path == labels
    assert ("boxes do not tell front from rear" in problem.remedy) == ("centre" not in said)


def in_lidar(sweep, *, heights):
    """Write x, y, z and the yaw of the LiDAR's frame, at a part of each height over the bottom."""
    lidar_from_camera = np.linalg.inv(CAMERA_FROM_LIDAR)
    locations = sweep.objects.locations - np.outer(
        heights * sweep.objects.dimensions_hwl[:, 0], (0, 1, 0)
    )
    objects = replace(
        sweep.objects,
        locations=locations @ lidar_from_camera[:3, :3].T + lidar_from_camera[:3, 3],
        rotation_y=-sweep.objects.rotation_y - math.pi / 2,
    )
    return replace(sweep, objects=objects)


@pytest.mark.parametrize(("heights", "said"), [(0.0, "of box bottoms"), (0.5, "of box centres")])
def test_labels_in_the_frame_of_the_lidar_are_told_though_all_boxes_are_empty(
    tmp_path, heights, said
):
    frame = ObjectFrame(sample_id="", points=tmp_path, calibration=tmp_path, objects=tmp_path)
    frames = [replace(frame, sample_id=str(number)) for number in range(12)]
    (problem,) = check_label_alignment(
        frames, lambda each: in_lidar(scene(int(each.sample_id)), heights=heights)
    )
    assert "x, y, z are in the LiDAR's frame and rotation_y is its yaw" in problem.problem
    assert said in problem.problem
    assert "before 0 and 0" in problem.problem
    assert "in the camera's frame (x right, y down, z forward)" in problem.remedy


@pytest.mark.parametrize(("num_points", "is_told"), [(None, True), (0, False), (10, False)])
def test_boxes_without_points_after_every_change_are_told_unless_the_clouds_are_at_fault(
    tmp_path, num_points, is_told
):
    labels = tmp_path / "labels.txt"
    frame = ObjectFrame(sample_id="", points=tmp_path, calibration=tmp_path, objects=labels)
    frames = [replace(frame, sample_id=str(number)) for number in range(12)]

    def read(each):
        sweep = scene(int(each.sample_id))
        x, y, z = sweep.objects.locations.T
        points = sweep.points[:num_points]
        return replace(
            sweep,
            points=points,
            objects=replace(sweep.objects, locations=np.column_stack((x, y - 12, z / 2))),
        )

    problems = check_label_alignment(frames, read)
    assert len(problems) == is_told
    for problem in problems:
        assert problem.path == labels
        assert "at most partly hidden, 48 have no point in their 3D box" in problem.problem


def test_labels_half_a_height_too_low_are_named_beside_a_move_of_the_clouds(tmp_path):
    frame = ObjectFrame(sample_id="", points=tmp_path, calibration=tmp_path, objects=tmp_path)
    frames = [replace(frame, sample_id=str(number)) for number in range(12)]
    (problem,) = found(frames, write=lambda y, rotation: (y + 0.75, rotation))
    assert "off by -0.8 m along the LiDAR's z axis" in problem.problem  # all are of one height
    assert "other possible faults: written half of their height too low" in problem.remedy


@pytest.mark.parametrize(("degrees", "is_limit"), [(3.0, False), (8.0, True)])
def test_at_the_limit_of_the_search_more_is_said_to_be_possible(tmp_path, degrees, is_limit):
    frame = ObjectFrame(sample_id="", points=tmp_path, calibration=tmp_path, objects=tmp_path)
    frames = [replace(frame, sample_id=str(number)) for number in range(5)]
    (problem,) = found(frames, change=turn(degrees))
    assert ("the fault may be larger" in problem.remedy) == is_limit


def test_other_changes_that_explain_it_as_well_are_named(tmp_path):
    frame = ObjectFrame(sample_id="", points=tmp_path, calibration=tmp_path, objects=tmp_path)
    frames = [replace(frame, sample_id=str(number)) for number in range(12)]
    (problem,) = found(frames, change=turn(1.5, "y"))
    assert "; other possible faults: off by +0." in problem.remedy
    assert "m along the LiDAR's z axis (up)" in problem.remedy


def test_few_objects_and_frames_without_points_say_nothing(tmp_path):
    assert told(tmp_path, 2, change=turn(3.0)) == []
    assert told(tmp_path, 9, change=turn(3.0), num_objects=1) == []
    frame = ObjectFrame(sample_id="0", objects=tmp_path)
    assert check_label_alignment([frame] * 20, lambda _: scene(0, change=turn(3.0))) == []
    whole = ObjectFrame(sample_id="0", points=tmp_path, calibration=tmp_path, objects=tmp_path)
    assert check_label_alignment([whole] * 20, lambda _: None) == []


def copy_frames(root, out, changed):
    """Link twelve frames, copy one part of them, and return its files."""
    paths = []
    for name in [frame.sample_id for frame in open_dataset(root).frames][:12]:
        parts = (("image_2", "png"), ("velodyne", "bin"), ("label_2", "txt"), ("calib", "txt"))
        for part, end in parts:
            source = root / "training" / part / f"{name}.{end}"
            copy = out / "training" / part / f"{name}.{end}"
            copy.parent.mkdir(parents=True, exist_ok=True)
            if part == changed:
                shutil.copyfile(source, copy)
                paths.append(copy)
            else:
                copy.symlink_to(source)
    return paths


def disagreements(root):
    (tree,) = find_trees(root)
    (check,) = (each for each in tree.checks if each.subject == "agreement of frames")
    return [each.problem for each in check.run()]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (turn(3.0), "of yaw"),
        (MIRROR, "mirrored"),
        (move(2, 1.0), "z axis"),
        (turn(3, "y"), "pitch"),
        (turn(180), "turned by +180 degrees"),
    ],
)
def test_changed_real_frames_are_told(tmp_path, kitti_root, change, said):
    for path in copy_frames(kitti_root, tmp_path, "velodyne"):
        cloud = np.fromfile(path, "<f4").reshape(-1, 4)
        cloud[:, :3] = cloud[:, :3] @ change[:3, :3].T + change[:3, 3]
        cloud.tofile(path)
    (problem,) = disagreements(tmp_path)
    assert said in problem


@pytest.mark.parametrize(
    ("written", "said"),
    [
        (lambda size, place, turn: [*size[::-1], *place, turn], "order length, width, height"),
        (lambda size, place, turn: [*size, *place, math.degrees(turn)], "probably in degrees"),
    ],
)
def test_labels_of_other_units_or_orders_raise_no_doubt_about_the_clouds(
    tmp_path, kitti_root, written, said
):
    for path in copy_frames(kitti_root, tmp_path, "label_2"):
        rows = [line.split() for line in path.read_text().splitlines() if "DontCare" not in line]
        changed = [
            [*row[:8], *written(values[:3], values[3:6], values[6])]
            for row in rows
            for values in [list(map(float, row[8:15]))]
        ]
        path.write_text("\n".join(" ".join(map(str, row)) for row in changed))
    problems = [each.problem for each in check_tree(tmp_path, num_workers=1)]
    assert any(said in each for each in problems)
    assert not [each for each in problems if "hold" in each]


def test_real_frames_as_they_are_agree(kitti_root):
    assert disagreements(kitti_root) == []


def test_real_clouds_of_other_frames_are_told_without_blaming_the_calibration(kitti_root):
    frames = [frame for frame in open_dataset(kitti_root).frames if frame.objects][:30]
    others = {
        id(frame): other for frame, other in zip(frames, frames[7:] + frames[:7], strict=True)
    }

    def read(frame):
        return LabelledSweep(
            objects=read_labels(frame.objects),
            matrices=read_object_matrices(frame.calibration),
            points=read_sweep(others[id(frame)].points),
        )

    (problem,) = check_label_alignment(frames, read)
    assert "no single turn, move or change of convention mends it" in problem.problem
