"""Files of the Rerun viewer, read by its own reader."""

import errno
import importlib
from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import project_points
from sightline.structures.objects import Objects
from sightline.structures.predictions import DepthMap, Detections2D, Detections3D, Perception
from sightline.visualization import rerun_file
from sightline.visualization.rerun_file import pinhole_of, write_rerun


def some_perception(sample):
    depth_m = torch.full(sample.image_size, 12.0)
    return Perception(
        detections2d=Detections2D(
            class_names=("Car",),
            boxes=Boxes2D(torch.tensor([[150.0, 40.0, 240.0, 90.0]])),
            scores=torch.tensor([0.75]),
        ),
        detections3d=Detections3D(
            class_names=("Car",),
            boxes=Boxes3D(torch.tensor([[12.0, 0.0, -0.9, 4.0, 1.7, 1.5, 0.3]])),
            scores=torch.tensor([0.5]),
        ),
        depth=DepthMap(depth_m=depth_m, valid=depth_m > 0),
    )


def as_plain(column):
    """Python values of a column; times in nanoseconds."""
    is_time = str(column.type).startswith("duration")
    return (column.cast("int64") if is_time else column).to_pylist()


@pytest.fixture
def rows(sample, tmp_path):
    """File of two frames, the second without sensors."""
    pytest.importorskip("rerun.chunk")
    whole = replace(sample, timestamp_s=2.5)
    blind = replace(sample, image=None, points=None, timestamp_s=2.6)
    path = tmp_path / "scene.rrd"
    assert write_rerun(path, [(whole, some_perception(sample)), (blind, Perception())]) == 2
    return read(path)


def read(path):
    """Contents of a file: rows with frame numbers, by entity."""
    reader = pytest.importorskip("rerun.chunk").RrdReader(path)
    assert len(reader.recordings()) == 1
    assert len(reader.blueprints()) == 1
    found = {}
    for each in reader.stream():
        batch = each.to_record_batch()
        table = {name: as_plain(batch.column(name)) for name in batch.schema.names}
        for number, frame in enumerate(table.get("frame", ())):
            values = {name: column[number] for name, column in table.items()}
            found.setdefault(each.entity_path, {}).setdefault(frame, {}).update(values)
    return found


def test_every_part_stands_on_the_time_line(rows):
    parts = ("points", "boxes", "camera", "camera/image", "camera/boxes", "camera/depth")
    assert {f"/lidar/{part}" for part in parts} <= set(rows)
    for part in parts:
        assert sorted(rows[f"/lidar/{part}"]) == [0, 1]
    assert rows["/lidar/points"][0]["time"] == 2_500_000_000


def test_points_and_boxes_are_those_of_the_frame(rows, sample):
    points = np.array(rows["/lidar/points"][0]["Points3D:positions"])
    assert points == pytest.approx(sample.points[:, :3].numpy())
    boxes = rows["/lidar/boxes"][0]
    assert boxes["Boxes3D:labels"] == ["Car 0.50"]
    assert np.array(boxes["Boxes3D:half_sizes"]) == pytest.approx(np.array([[2.0, 0.85, 0.75]]))
    assert rows["/lidar/camera/boxes"][0]["Boxes2D:labels"] == ["Car 0.75"]
    assert rows["/lidar/camera/depth"][0]["DepthImage:meter"] == [256.0]


def test_joined_objects_replace_the_detections(sample, tmp_path):
    objects = Objects(
        class_names=("Car", "Cyclist"),
        boxes2d=Boxes2D(torch.tensor([[150.0, 40.0, 240.0, 90.0], [torch.nan] * 4]).double()),
        boxes3d=Boxes3D(torch.tensor([[12.0, 0, -0.9, 4, 1.7, 1.5, 0.3]] * 2).double()),
        origins=("lifted", "measured"),
        scores=torch.tensor([0.9, 0.8]).double(),
        scores3d=torch.tensor([0.2, 0.8]).double(),
        image_support=torch.tensor([0.5, 0.0]).double(),
        lidar_support=torch.tensor([0.0, 0.8]).double(),
        num_points=torch.tensor([0, 5]),
    )
    pytest.importorskip("rerun.chunk")
    path = tmp_path / "scene.rrd"
    write_rerun(path, [(sample, replace(some_perception(sample), objects=objects))])
    found = read(path)
    in_space = found["/lidar/boxes"][0]
    assert in_space["Boxes3D:labels"] == ["Car 0.90 C lifted", "Cyclist 0.80 L measured"]
    assert in_space["Boxes3D:radii"] == pytest.approx([0.01, 0.03])
    assert found["/lidar/camera/boxes"][0]["Boxes2D:labels"] == ["Car 0.90 C"]


@pytest.mark.parametrize(
    "part", ["points", "boxes", "camera/image", "camera/boxes", "camera/depth"]
)
def test_what_a_frame_lacks_is_cleared(rows, part):
    later = rows[f"/lidar/{part}"][1]
    assert any(name.startswith("Clear") and value for name, value in later.items())


def test_a_frame_without_a_time_does_not_stand_at_that_of_the_one_before(sample, tmp_path):
    pytest.importorskip("rerun.chunk")
    frames = [replace(sample, timestamp_s=2.5), replace(sample, timestamp_s=None)]
    path = tmp_path / "scene.rrd"
    write_rerun(path, [(each, Perception()) for each in frames])
    points = read(path)["/lidar/points"]
    assert points[0]["time"] == 2_500_000_000
    assert points[1].get("time") is None


def test_depth_beyond_what_the_format_holds_is_left_out(sample, tmp_path):
    pytest.importorskip("rerun.chunk")
    depth_m = torch.full(sample.image_size, 12.0)
    depth_m[0, :2] = torch.tensor([256.0, 250.0])
    depth = DepthMap(depth_m=depth_m, valid=depth_m > 0)
    path = tmp_path / "scene.rrd"
    write_rerun(path, [(sample, Perception(depth=depth))])
    buffer = read(path)["/lidar/camera/depth"][0]["DepthImage:buffer"]
    steps = np.asarray(buffer, np.uint8).reshape(-1).view(np.uint16)
    assert steps[:3].tolist() == [0, 250 * 256, 12 * 256]


def test_what_a_network_in_training_finds_is_written(sample, tmp_path):
    pytest.importorskip("rerun.chunk")
    found = some_perception(sample)
    boxes2d = Boxes2D(found.detections2d.boxes.tensor.requires_grad_())
    boxes3d = Boxes3D(found.detections3d.boxes.tensor.requires_grad_())
    trained = replace(
        found,
        detections2d=replace(found.detections2d, boxes=boxes2d),
        detections3d=replace(found.detections3d, boxes=boxes3d),
        depth=replace(found.depth, depth_m=found.depth.depth_m.requires_grad_()),
    )
    assert write_rerun(tmp_path / "scene.rrd", [(sample, trained)]) == 1


def test_the_pinhole_sees_points_where_the_calibration_does(calibration):
    shifted = calibration.image_from_camera.clone()
    shifted[:, 3] = torch.tensor([12.0, -3.0, 0.02])  # the way to camera 2, as in KITTI's P2
    moved = Calibration(image_from_camera=shifted, camera_from_lidar=calibration.camera_from_lidar)
    matrix, lidar_from_camera = pinhole_of(moved)
    points = torch.tensor([[10.0, 1.0, -0.5], [25.0, -4.0, 1.0]], dtype=torch.float64)
    homogeneous = np.linalg.inv(lidar_from_camera) @ np.c_[points, np.ones(2)].T
    seen = matrix @ homogeneous[:3]
    expected = project_points(points, moved)
    np.testing.assert_allclose((seen[:2] / seen[2]).T, expected.pixels.numpy())
    np.testing.assert_allclose(seen[2], expected.depths.numpy())


def test_without_the_library_it_says_what_to_install(tmp_path, monkeypatch):
    def missing(name):
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(ValueError, match=r"pip install '\.\[viz\]'"):
        write_rerun(tmp_path / "scene.rrd", [])


def test_a_full_disk_is_named_at_once_and_leaves_nothing(sample, tmp_path, monkeypatch):
    pytest.importorskip("rerun")

    def fail(source, file):
        file.write(source.read(1000))
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(rerun_file.shutil, "copyfileobj", fail)
    frames = [(sample, Perception())] * 3
    with pytest.raises(ValueError, match=r"scene\.rrd cannot be written: no space left on device"):
        write_rerun(tmp_path / "scene.rrd", frames)
    assert not list(tmp_path.iterdir())


def test_an_error_of_a_frame_leaves_nothing(sample, tmp_path):
    pytest.importorskip("rerun")

    def frames():
        yield sample, Perception()
        raise ValueError("frame 2 is damaged")

    with pytest.raises(ValueError, match="frame 2 is damaged"):
        write_rerun(tmp_path / "scene.rrd", frames())
    assert not list(tmp_path.iterdir())
