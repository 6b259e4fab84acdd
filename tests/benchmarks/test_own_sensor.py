from dataclasses import replace

import numpy as np
import pytest

from benchmarks.own_sensor import score_objects
from benchmarks.own_sensor_rigs import RIGS, record_street
from sightline.data.check import check_tree
from sightline.data.open import open_dataset
from sightline.simulation.lidar_config import LIDARS

CAR = "Car 0.00 0 1.57 100.00 100.00 160.00 130.00 1.50 1.60 4.00 1.00 1.70 20.00 1.57"


def test_a_street_becomes_a_recording_without_fault_that_tells_its_own_height(tmp_path):
    own = RIGS["own"]
    matrix = own.calibration.image_from_camera / [[10], [10], [1]]
    small = replace(
        own,
        calibration=replace(own.calibration, image_from_camera=matrix),
        image_size=(120, 192),
        lidar=replace(LIDARS["hdl-32e"], height_m=own.lidar.height_m, azimuth_step_deg=1.0),
    )
    record_street(small, tmp_path, seed=1500, index=0)
    assert list(check_tree(tmp_path)) == []
    sample = open_dataset(tmp_path, parts=("image", "points", "objects", "depth"))[0]
    assert sample.image_size == sample.depth.shape == (120, 192)
    assert 0 < sample.points[:, 3].max() <= 1
    assert sample.lidar_height_m == pytest.approx(own.lidar.height_m, abs=0.15)
    assert np.load(tmp_path / "points" / "000000.npy")[:, 3].max() > 1


def test_a_car_that_only_a_longer_focal_length_makes_high_enough_does_not_count_when_resized(
    tmp_path,
):
    for folder, line in (
        ("labels", CAR),
        ("answers/detection2d", f"{CAR} 0.9"),
        ("answers/detection3d", f"{CAR} 0.9"),
    ):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "000000.txt").write_text(f"{line}\n")
    as_is, resized = (
        [
            each.num_objects
            for each in score_objects(tmp_path, tmp_path / "answers", scale=scale)
            if each.class_name == "Car"
        ]
        for scale in (1.0, 0.65)
    )
    assert as_is == [1, 1]
    assert resized == [0, 0]
