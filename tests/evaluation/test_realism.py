import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.kitti_conversion import kitti_from_labels
from sightline.data.formats.kitti_files import read_object_calibration
from sightline.data.formats.kitti_labels import KittiObjects, read_labels, write_objects
from sightline.data.formats.velodyne import read_sweep, write_sweep
from sightline.evaluation.realism import RealismReport, Statistic, evaluate_realism
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.simulation.generate import simulate
from sightline.simulation.settings import SimulationConfig
from sightline.structures.labels import ObjectLabels
from tests.simulation.small_streets import make_tiny_street

pytestmark = pytest.mark.filterwarnings("ignore:.*is compared with itself")


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("frames")
    config = SimulationConfig(seed=3, image_size=(94, 310), focal_px=180.0)
    simulate(out, frames=3, config=config, workers=1, streets=make_tiny_street)
    return out


@pytest.fixture
def copied(frames: Path, tmp_path: Path) -> Path:
    return shutil.copytree(frames, tmp_path / "copy")


def row(report: RealismReport, name: str) -> Statistic:
    return next(row for row in report.statistics if row.name == name)


def test_a_data_set_is_like_itself(frames: Path):
    report = evaluate_realism(frames, frames)
    compared = [row for row in report.statistics if row.ratio is not None]
    assert len(compared) > 20
    assert all(row.ratio == 1 for row in compared)
    assert not any(row.differs for row in report.statistics)


def test_statistics_are_those_of_the_files(frames: Path, copied: Path):
    rng = np.random.default_rng(0)
    for path in (copied / "training/image_2").glob("*.png"):
        write_rgb(path, rng.integers(99, 102, (94, 310, 3), dtype=np.uint8))
    report = evaluate_realism(copied, frames)
    assert row(report, "image brightness").simulated == pytest.approx(100, abs=0.1)
    assert row(report, "image gradient 0 to 4").simulated == 1
    assert row(report, "image darker than 32, below the horizon").simulated == 0
    sweeps = [read_sweep(path) for path in (frames / "training/velodyne").glob("*.bin")]
    assert row(report, "points in a whole sweep").real == np.mean([len(s) for s in sweeps])
    assert 0 < row(report, "points in the image").real < len(sweeps[0]) / 4
    assert row(report, "Car height [m]").real == pytest.approx(1.5)
    assert row(report, "Car length [m]").real == pytest.approx(4.0)


def test_points_on_a_car_are_counted_within_its_turned_box(copied: Path):
    calibration = read_object_calibration(copied / "training/calib/000000.txt")
    yaw = 0.5
    box = torch.tensor([[12.0, 1.0, -1.0, 4.0, 1.6, 1.5, yaw]], dtype=torch.float64)
    cars = ObjectLabels(
        class_names=("Car",) * 5,
        boxes2d=Boxes2D(torch.tensor([[100.0, 20, 200, 60]] * 5, dtype=torch.float64)),
        boxes3d=Boxes3D(box.repeat(5, 1)),
        truncation=torch.zeros(5, dtype=torch.float64),
        occlusion=torch.zeros(5, dtype=torch.int64),
        alpha=torch.zeros(5, dtype=torch.float64),
    )
    ends = [(along, across, 0.0) for along in (-1.9, 1.9) for across in (-0.7, 0.7)]
    beyond = [(2.1, 0.0, 0.0), (0.0, 0.9, 0.0), (1.0, -0.5, 0.8), (1.0, -0.5, -0.8)]
    canonical = np.array(ends + beyond)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    points = np.zeros((8, 4), np.float32)
    points[:, :3] = canonical @ turn.T + (12.0, 1.0, -1.0)
    points[:, 3] = [0, 0.2, 0.3, 0.7, 1, 1, 1, 1]
    for name in ("000000", "000001", "000002"):
        write_sweep(copied / f"training/velodyne/{name}.bin", points)
        objects = kitti_from_labels(cars, calibration)
        write_objects(copied / f"training/label_2/{name}.txt", objects)
    report = evaluate_realism(copied, None)
    assert row(report, "points on a free car, 10 to 15 m").simulated == 4
    assert row(report, "points on a free car, 10 to 15 m, 10 %").simulated == 4
    assert row(report, "points on a free car, 15 to 20 m").simulated is None
    assert row(report, "reflectance on free cars, 10 to 15 m").simulated == pytest.approx(0.25)
    assert row(report, "reflectance on free cars, share of zeros").simulated == 0.25


def label_file(path: Path, objects: list[tuple[str, tuple, tuple, float, float]]) -> None:
    """Writes objects of (class, size_hwl, location, rotation_y, height of the 2D box)."""
    names, sizes, locations, turns, heights = zip(*objects, strict=True)
    boxes = [(100.0, 100.0, 150.0, 100.0 + height) for height in heights]
    count = len(names)
    columns = KittiObjects(
        class_names=names,
        truncation=np.zeros(count),
        occlusion=np.full(count, 3.0),
        alpha=np.zeros(count),
        boxes2d=np.array(boxes),
        dimensions_hwl=np.array(sizes, np.float64),
        locations=np.array(locations, np.float64),
        rotation_y=np.array(turns),
    )
    write_objects(path, columns, decimals=None)


def test_statistics_of_objects_are_those_of_the_label_files(frames: Path, tmp_path: Path):
    heights = [1.4, 1.5, 1.6, 1.7, 1.8, 1.4, 1.6, 1.5, 1.9]
    cars = [
        # Beyond 30 m: bottoms 1 and 2 m below the camera. Yaw 4 or 10 degrees off an axis.
        ("Car", (h, 1.6, 2 * h + 1), (0.0, 1.0 + i % 2, 40.0), np.radians(94 + 6 * (i % 2)), 14.0)
        for i, h in enumerate(heights)
    ]
    label_file(tmp_path / "000000.txt", cars)
    people = [
        ("Pedestrian", (1.8, 0.6, 0.8), (x, 1.7, 10.0), 0.0, 24.0) for x in (0.0, 1.2, 4.0, 9.0)
    ]
    label_file(tmp_path / "000001.txt", people)
    report = evaluate_realism(frames, frames, real_labels=tmp_path)
    expected = {
        "frames without Car": 0.5,
        "frames with more than 8 Car": 0.5,
        "frames with more than 12 Car": 0.0,
        "frames with DontCare": 0.0,
        "labels under 15 px per frame": 4.5,
        "labels under 25 px per frame": 6.5,
        "Car occlusion 3": 1.0,
        "Car yaw within 5 degrees of an axis": 5 / 9,
        "Car bottom beyond 30 m [m], spread": np.std([1, 2] * 4 + [1]),
        "Car bottom beyond 30 m [m], half 16 to 84 %": 0.5,
        "Car length [m], not told by the front": 0.0,
        "Car length / height, 50%": np.median([2 + 1 / h for h in heights]),
        "Pedestrian within 1.5 m of another": 0.5,
    }
    found = {name: row(report, name).real for name in expected}
    assert found == pytest.approx(expected, abs=1e-9)


def test_boxes_are_compared_with_the_clipped_projection_of_the_3d_box(frames: Path, copied: Path):
    report = evaluate_realism(frames, copied)
    assert row(report, "Car box, IoU by the 3D box's").simulated == pytest.approx(1, abs=0.02)
    for path in (copied / "training/label_2").glob("*.txt"):
        objects = read_labels(path)
        wide = objects.boxes2d.copy()
        wide[:, 2] = wide[:, 0] + 0.5 * (wide[:, 2] - wide[:, 0])
        write_objects(path, replace(objects, boxes2d=wide))
    report = evaluate_realism(frames, copied)
    assert row(report, "Car box, IoU by the 3D box's").real == pytest.approx(0.5, abs=0.02)
    assert row(report, "Car box, width by the 3D box's").real == pytest.approx(0.5, abs=0.02)
    assert row(report, "Car box, height by the 3D box's").real == pytest.approx(1, abs=0.02)


def test_a_row_is_marked_where_the_sides_differ_by_more_than_a_quarter():
    like = Statistic(name="like", simulated=12.4, real=10.0)
    unlike = Statistic(name="unlike", simulated=7.4, real=10.0)
    lone = Statistic(name="lone", simulated=1.0, real=None)
    report = RealismReport(num_simulated=3, num_real=4, statistics=(like, unlike, lone))
    lines = report.table().plain.splitlines()
    marked = {line.split()[0]: line.endswith("*") for line in lines[1:-1]}
    assert marked == {"like": False, "unlike": True, "lone": False}
    assert lines[-1] == "* 1 of 2 differ by more than 25%"


def test_a_report_without_real_frames_has_one_column(frames: Path):
    report = evaluate_realism(frames, None, max_frames=2)
    assert (report.num_simulated, report.num_real) == (2, 0)
    assert all(row.real is None for row in report.statistics)
    assert report.to_json()["num_simulated"] == 2


def test_a_folder_without_frames_is_refused(frames: Path, tmp_path: Path):
    with pytest.raises(ValueError, match="holds no object tree of KITTI"):
        evaluate_realism(frames, tmp_path)
    with pytest.raises(ValueError, match="holds no label files"):
        evaluate_realism(frames, frames, real_labels=tmp_path)


def test_comparing_needs_no_pytorch():
    program = (
        "import sys, sightline.evaluation.realism\n"
        "assert 'torch' not in sys.modules, 'torch was imported'\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_real_frames_have_the_statistics_that_were_measured_beforehand(kitti_root: Path):
    report = evaluate_realism(kitti_root, kitti_root, max_frames=30)
    assert row(report, "points in the image").real == pytest.approx(18800, rel=0.03)
    assert row(report, "share of pixels with a point, 1216x352").real == pytest.approx(
        0.043, abs=0.002
    )
    assert 103_000 < row(report, "points in a whole sweep").real < 127_000
    assert row(report, "Car length [m]").real == pytest.approx(3.88, abs=0.2)
    assert row(report, "Car box, IoU by the 3D box's").real > 0.97
    assert row(report, "ground off a plane [m], median").real == pytest.approx(0.025, abs=0.008)
