import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from sightline.files.problem import FileError
from sightline.simulation.random_rigs import random_rig
from sightline.simulation.rig_sensors import mount
from sightline.simulation.rigs import RIG_NAMES, Rig, choose_rig, named_rig

MINE = """
camera:
  image_size: {width: 640, height: 360}
  focal_px: 500
  height_m: 1.4
  pitch_deg: 2.5
lidar:
  fans: [[10, -10, 5], [-12, -20, 3]]
  height_m: 1.9
"""


@pytest.fixture
def file(tmp_path):
    def write(text):
        path = tmp_path / "mine.yaml"
        path.write_text(text)
        return path

    return write


DATA_SHEETS = {  # rings, top and bottom [degrees], width of the picture [px] and its view [degrees]
    "kitti": (64, 2.0, -25.0, 1242, 81),
    "nuscenes": (32, 10.67, -30.67, 1600, 65),
    "waymo": (64, 2.4, -17.6, 1920, 50),
    "argoverse2": (64, 25.0, -25.0, 2048, 63),
    "view-of-delft": (64, 2.0, -25.0, 1936, 66),
    "pandaset": (64, 15.0, -25.0, 1920, 52),
    "once": (40, 15.0, -25.0, 1920, 91),
    "os1-64": (64, 22.5, -22.5, 1920, 82),
    "os1-128": (128, 22.5, -22.5, 1440, 41),
    "vls-128": (128, 15.0, -25.0, 1280, 90),
    "robot-vlp16": (16, 15.0, -15.0, 1280, 69),
}


def test_the_table_of_data_sheets_has_all_rigs_with_rings():
    assert {*DATA_SHEETS, "livox-horizon"} == set(RIG_NAMES)


@pytest.mark.parametrize("name", DATA_SHEETS)
def test_named_rigs_have_the_rings_and_views_of_their_data_sheets(name):
    rings, top, bottom, width, view_deg = DATA_SHEETS[name]
    rig = named_rig(name)
    elevations = [laser.elevation_deg for laser in mount(rig).lidar.lasers]
    assert (len(elevations), elevations[0], elevations[-1]) == (rings, top, bottom)
    assert rig.camera.image_size[1] == width
    assert rig.camera.width_deg == pytest.approx(view_deg, abs=1)
    assert rig.source


def test_the_denser_rings_of_a_measured_layout_are_as_in_its_data_sheet():
    elevations = named_rig("pandaset").lidar.elevations_deg
    fine = [ring for ring in elevations if -6 <= ring <= 2]
    np.testing.assert_allclose(np.diff(fine), -1 / 6, atol=1e-3)


def test_random_rigs_are_valid_different_and_the_same_for_a_seed():
    rigs = [random_rig(np.random.default_rng(seed)) for seed in range(300)]
    assert rigs[:5] == [random_rig(np.random.default_rng(seed)) for seed in range(5)]
    assert len({rig.camera for rig in rigs}) == len(rigs)
    cameras, lidars = [rig.camera for rig in rigs], [rig.lidar for rig in rigs]
    for camera in cameras:
        height, width = camera.image_size
        assert 500 <= camera.focal_px <= 2500
        assert 28 < camera.width_deg < 102
        assert height / width <= 0.75
        assert 1.1 <= camera.height_m <= 2.5
        assert max(abs(camera.pitch_deg) / 8, abs(camera.roll_deg) / 3) <= 1
        horizon = camera.principal[1] - camera.focal_px * np.tan(np.radians(camera.pitch_deg))
        assert 0.1 * height < horizon < 0.8 * height
    assert {len(lidar.elevations_deg) for lidar in lidars} == {0, 16, 32, 40, 64, 128}
    assert all((lidar.rosette is None) == bool(lidar.elevations_deg) for lidar in lidars)
    assert all(1.2 <= lidar.height_m <= 2.5 and 60 <= lidar.range_m <= 200 for lidar in lidars)
    assert all(0.1 <= lidar.azimuth_step_deg <= 0.4 for lidar in lidars)
    assert 0.05 < np.mean([lidar.reflectance == 0 for lidar in lidars]) < 0.3
    assert 0.05 < np.mean([camera.bonnet_m > 0 for camera in cameras]) < 0.5
    assert 0.2 < np.mean([camera.dirt > 0 for camera in cameras]) < 0.5
    assert 0.35 < np.mean([camera.readout_ms > 0 for camera in cameras]) < 0.65
    assert max(camera.dirt for camera in cameras) <= 0.8
    assert max(camera.readout_ms for camera in cameras) <= 35
    assert {lidar.order for lidar in lidars} == {"rings", "firings", "none"}
    roofs = [lidar for lidar in lidars if lidar.roof_m]
    assert 0.2 < len(roofs) / len(lidars) < 0.6
    for lidar in roofs:
        assert 1.3 <= lidar.roof_m <= 2.2
        assert 0.11 <= lidar.height_m - lidar.roof_m <= 0.61
    for rig in rigs[:50]:
        mount(rig)


def as_entries(rig):
    entries = {name: asdict(getattr(rig, name)) for name in ("camera", "lidar")}
    height, width = rig.camera.image_size
    entries["camera"]["image_size"] = {"width": width, "height": height}
    return {"source": rig.source, **entries}


@pytest.mark.parametrize(
    "rig",
    [
        *(named_rig(name) for name in RIG_NAMES),
        *(random_rig(np.random.default_rng(seed)) for seed in range(12)),
    ],
)
def test_a_rig_survives_the_way_through_a_json_file(tmp_path, rig):
    path = tmp_path / f"{rig.name}.json"
    path.write_text(json.dumps(as_entries(rig)))
    assert choose_rig(str(path)) == rig


def test_a_file_gives_a_rig_with_its_rings(file):
    rig = choose_rig(str(file(MINE)))
    assert isinstance(rig, Rig)
    assert rig.name == "mine"
    assert rig.camera.image_size == (360, 640)
    assert rig.lidar.elevations_deg == (10.0, 5.0, 0.0, -5.0, -10.0, -12.0, -16.0, -20.0)


def test_json_and_a_rosette_are_read_too(file):
    rosette = {"width_deg": 80, "height_deg": 25, "points": 2000}
    camera = {"image_size": {"width": 640, "height": 360}, "focal_px": 500}
    rig = choose_rig(str(file(json.dumps({"camera": camera, "lidar": {"rosette": rosette}}))))
    assert isinstance(rig, Rig)
    assert rig.lidar.rosette is not None
    assert rig.lidar.rosette.points == 2000


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("focal_px: 500", "focal_px: wide", "focal_px is 'wide', expected a number"),
        ("focal_px: 500", "", "camera lacks focal_px"),
        ("focal_px: 500", "focal: 500", "camera has the unknown entry 'focal'"),
        ("focal_px: 500", "focal_px: 3", "focal_px must be finite and from 50 to 20000, got 3"),
        ("{width: 640, height: 360}", "[640, 360]", "image_size is '[640, 360]', expected {width"),
        ("width: 640", "width: 6.5", "an entry of image_size is '6.5', expected a whole number"),
        ("width: 640", "width: 9", "must have 32 to 8192 pixels"),
        ("pitch_deg: 2.5", "pitch_deg: true", "pitch_deg is 'True', expected a number"),
        ("pitch_deg: 2.5", "pitch_deg: .nan", "pitch_deg is 'nan', expected a number"),
        ("pitch_deg: 2.5", "bonnet_m: 1.5", "bonnet_m must be 0.1 m or more below the camera"),
        ("pitch_deg: 2.5", "principal_px: [1, 2, 3]", "principal_px is '(1, 2, 3)'"),
        ("pitch_deg: 2.5", "principal_px: [700, 2]", "principal_px must lie in the image"),
        ("[-12, -20, 3]", "[-12, -20]", "an entry of fans is '[-12, -20]', expected a list of"),
        (
            "fans: [[10, -10, 5], [-12, -20, 3]]",
            "elevations_deg: [0.1, 0, -0.1, -0.4]",
            "span 0.5 degrees, expected at least 2",
        ),
        ("[-12, -20, 3]", "[12, 20, 3]", "elevations_deg must fall, from the top ring"),
        ("[-12, -20, 3]", "[-12, -20, 900]", "each of fans must have 1 to 256 rings, got 900"),
        ("height_m: 1.9", "roof_m: 1.7", "roof_m must be 0.1 m or more below the LiDAR at 1.73 m"),
        ("height_m: 1.9", "height_m: -1", "height_m must be finite and from 0.3 to 5, got -1"),
        ("height_m: 1.9", "order: rows", "order is 'rows', expected one of rings, firings, none"),
        ("pitch_deg: 2.5", "dirt: 2", "dirt must be finite and from 0 to 1, got 2"),
        ("pitch_deg: 2.5", "readout_ms: -1", "readout_ms must be finite and from 0 to 100"),
        ("height_m: 1.9", "model: hdl-65e", "model is 'hdl-65e', expected one of hdl-64e"),
        ("height_m: 1.9", "model: hdl-64e", "needs one of elevations_deg (or fans), model and"),
        ("height_m: 1.9", "elevations_deg: [1]", "both fans and elevations_deg, expected one"),
        ("height_m: 1.9", "blind_sectors: [[9, 3, 0]]", "blind_sectors must be start, end and"),
        ("fans:", "fan:", "lidar has the unknown entry 'fan', expected"),
        ("lidar:", "radar:", "the rig has the unknown entry 'radar', expected name, camera, lidar"),
        (MINE, "- 1", "holds no mapping of names to values, expected camera and lidar"),
        (MINE, "camera: 3\nlidar: {}", "camera is no mapping of entries to values"),
    ],
)
def test_faults_of_a_file_are_told_in_one_line(file, old, new, message):
    path = file(MINE.replace(old, new))
    with pytest.raises(FileError) as caught:
        choose_rig(str(path))
    text = str(caught.value)
    assert message.replace("(1, 2, 3)", "[1, 2, 3]") in text
    assert str(path) in text
    assert "\n" not in text


def test_names_that_there_are_not_are_refused_with_the_list():
    with pytest.raises(
        ValueError, match=r"rig must be random, named, a YAML file, or one of kitti"
    ):
        choose_rig("kity")
    with pytest.raises(FileError, match=r"none\.yaml"):
        choose_rig("none.yaml")


def test_a_rig_without_rings_is_refused():
    with pytest.raises(ValueError, match="a LiDAR needs one of elevations_deg"):
        replace(named_rig("os1-64").lidar, elevations_deg=())
