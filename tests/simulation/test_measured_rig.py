"""Rigs measured from simulated sweeps, against the rigs that took them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.data.formats.rings import rings_of_any_order
from sightline.data.open import open_dataset
from sightline.simulation.generate import simulate
from sightline.simulation.measured_rig import _joined_parts, measure_rig, rig_text
from sightline.simulation.rigs import named_rig, read_rig
from sightline.simulation.settings import SimulationConfig


class Samples:
    """A data set in memory."""

    def __init__(self, *samples):
        self.samples = samples
        self.sample_ids = tuple(sample.sample_id for sample in samples)

    def __len__(self):
        return len(self.samples)

    def __getitem__(self, index):
        return self.samples[index]


@pytest.fixture(scope="module")
def sample_of(tmp_path_factory):
    taken = {}

    def take(name):
        if name not in taken:
            folder = tmp_path_factory.mktemp("rig") / "data"
            config = SimulationConfig(seed=5, rig=named_rig(name), camera=False)
            simulate(folder, frames=1, config=config, workers=1)
            taken[name] = open_dataset(folder, parts=("points",))[0]
        return taken[name]

    return take


@pytest.mark.parametrize("name", ["nuscenes", "robot-vlp16", "livox-horizon"])
def test_a_rig_is_measured_from_a_sweep_that_it_took(sample_of, name):
    true, measured = named_rig(name), measure_rig(Samples(sample_of(name)), "own").rig
    for field in ("height_m", "ahead_m", "left_m", "pitch_deg", "roll_deg"):
        assert getattr(measured.camera, field) == pytest.approx(
            getattr(true.camera, field), abs=0.02
        )
    assert measured.camera.focal_px == pytest.approx(true.camera.focal_px, abs=0.01)
    assert measured.camera.principal == pytest.approx(true.camera.principal, abs=0.01)
    assert measured.camera.image_size == true.camera.image_size
    for field in ("height_m", "pitch_deg", "roll_deg"):
        assert getattr(measured.lidar, field) == pytest.approx(getattr(true.lidar, field), abs=0.05)
    assert measured.lidar.range_m == pytest.approx(true.lidar.range_m, rel=0.15)


def test_rings_and_their_step_are_measured(sample_of):
    lidar = measure_rig(Samples(sample_of("robot-vlp16")), "own").rig.lidar
    assert lidar.elevations_deg == pytest.approx(np.arange(15, -16, -2), abs=0.05)
    assert lidar.azimuth_step_deg == pytest.approx(0.2, abs=0.005)


def test_the_step_of_rounded_azimuths_is_their_mean_and_second_returns_are_no_steps(sample_of):
    sample = sample_of("kitti")  # in steps of 0.09 degrees: 0.18 and, one in seven, 0.09
    doubled = replace(sample, points=sample.points.repeat_interleave(2, dim=0))
    for each in (sample, doubled):
        lidar = measure_rig(Samples(each), "own").rig.lidar
        assert lidar.azimuth_step_deg == pytest.approx(
            named_rig("kitti").lidar.azimuth_step_deg, abs=0.002
        )


def test_a_sweep_without_rings_becomes_a_pattern_of_its_view_with_a_note(sample_of):
    measured = measure_rig(Samples(sample_of("livox-horizon")), "own")
    assert measured.rig.lidar.rosette.width_deg == pytest.approx(81.7, abs=3)
    assert measured.rig.lidar.rosette.height_deg == pytest.approx(25.1, abs=3)
    assert len(measured.notes) == 1


def test_a_turned_lidar_gives_the_same_rig(sample_of):
    sample = sample_of("nuscenes")
    turn = torch.eye(4, dtype=torch.float64)
    turn[:2, :2] = torch.tensor([[0.0, -1.0], [1.0, 0.0]])  # x of the level frame points to -y
    points = sample.points.clone()
    points[:, :3] = points[:, :3] @ turn[:3, :3].float()  # from the level frame into its own
    calibration = replace(
        sample.calibration, camera_from_lidar=sample.calibration.camera_from_lidar @ turn
    )
    turned = replace(sample, points=points, calibration=calibration, level_from_lidar=turn)
    plain, own = (measure_rig(Samples(each), "own").rig for each in (sample, turned))
    assert own.camera == plain.camera
    assert own.lidar == plain.lidar


def test_a_rig_is_written_as_the_simulator_reads_it(sample_of, tmp_path):
    for name in ("nuscenes", "livox-horizon"):
        rig = measure_rig(Samples(sample_of(name)), "own").rig
        (tmp_path / "own.yaml").write_text(rig_text(rig))
        assert read_rig(tmp_path / "own.yaml") == rig


def test_without_points_or_height_it_says_what_is_missing(sample_of):
    sample = sample_of("nuscenes")
    with pytest.raises(ValueError, match="none of 1 frames has a point cloud, by which the LiDAR"):
        measure_rig(Samples(replace(sample, points=None)), "own")
    few = replace(sample, points=sample.points[:9])
    with pytest.raises(ValueError, match="none of 2 frames has 1000 points, by which the LiDAR"):
        measure_rig(Samples(replace(sample, points=None), few), "own")
    notes = measure_rig(Samples(replace(sample, lidar_height_m=None)), "own").notes
    assert any("1.73 m is assumed" in note for note in notes)


def test_frames_of_several_cameras_are_told_and_kept_in_the_file(sample_of, tmp_path):
    sample = sample_of("nuscenes")
    focal = torch.diag(torch.tensor([0.6, 0.6, 1.0], dtype=torch.float64))
    matrix = focal @ sample.calibration.image_from_camera
    wide = replace(sample, calibration=replace(sample.calibration, image_from_camera=matrix))
    measured = measure_rig(Samples(sample, sample, wide), "own")
    assert ["several cameras (focal length 760 to 1266 px" in each for each in measured.notes] == [
        True
    ]
    (tmp_path / "own.yaml").write_text(rig_text(measured.rig))
    assert measured.notes[0] in read_rig(tmp_path / "own.yaml").source
    assert not measure_rig(Samples(sample, sample), "own").notes


def test_frames_of_several_lidars_are_told(sample_of):
    sample = sample_of("nuscenes")
    rings, _ = rings_of_any_order(sample.points.double().numpy())
    few = replace(sample, points=sample.points[torch.from_numpy(rings % 4 == 0)])
    measured = measure_rig(Samples(sample, sample, few), "own")
    assert len(measured.rig.lidar.elevations_deg) == int(rings.max()) + 1
    (note,) = measured.notes
    assert "the 3 frames measured have several LiDARs (8 to" in note
    assert not measure_rig(Samples(sample, sample), "own").notes


def test_rings_of_any_sweep_go_before_a_larger_one_without_rings(sample_of):
    sample, solid = sample_of("robot-vlp16"), sample_of("livox-horizon")
    more = replace(solid, points=solid.points.repeat(3, 1))
    measured = measure_rig(Samples(more, sample, sample), "own")
    assert len(measured.rig.lidar.elevations_deg) == 16
    assert "no rings are found in 1 of the sweeps measured, the largest" in measured.notes


def test_parts_of_one_ring_are_joined_and_sound_rings_are_not():
    parts = [0.72, 0.64, 0.53, -1.98, -2.01, -4.51, -4.68, -4.66, -7.28, -7.32, -7.37]
    assert sorted(_joined_parts(parts)) == [-7.32, -4.66, -1.99, 0.64]
    close = np.arange(2, -6.1, -1 / 6).round(2).tolist()
    pandar64 = [15.0, 11.0, 8.0, 5.0, 3.0, *close, -8.0, -10.0, -12.0, -14.0, -19.0, -25.0]
    for name in ("kitti", "nuscenes", "robot-vlp16"):
        sound = list(named_rig(name).lidar.elevations_deg)
        assert _joined_parts(sound) == sound
    assert _joined_parts(pandar64) == pandar64
    assert _joined_parts([3.0]) == [3.0]


def test_rings_of_too_few_points_are_refused_with_the_remedy(sample_of, monkeypatch):
    monkeypatch.setattr("sightline.simulation.measured_rig._MIN_RING_POINTS", 10**6)
    with pytest.raises(ValueError, match=r"no ring of its LiDAR has 1000000 points; .*--rig"):
        measure_rig(Samples(sample_of("nuscenes")), "own")
