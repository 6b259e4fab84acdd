"""Beams of sweeps that KITTI's LiDAR did not take."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.augmentation.faults import fault_rng
from sightline.corruptions.arrays import corrupt_arrays
from sightline.corruptions.kinds import KINDS
from sightline.corruptions.sensor import HDL_64E
from sightline.corruptions.sweep_beams import beams_of, view_of
from tests.data.scenes import sample_of

SHARES = (0.75, 0.5, 0.25, 0.125, 0.0625)
RIGS = {
    "16 rings": np.linspace(15, -15, 16),
    "32 rings": np.linspace(15, -15, 32),
    "64 rings": np.linspace(22.5, -22.5, 64),
    "128 rings": np.linspace(22.5, -22.5, 128),
    "upside down": np.linspace(24.3, -2, 64),
}


def sweep(elevations_deg, *, pitch_deg=0.0, order="firings"):
    """A turn between walls on a road 1.8 m below, in the LiDAR's own frame; also its true rings."""
    azimuths = np.radians(np.arange(0, 360, 0.5))
    rings, turns = (
        each.T.ravel() if order == "firings" else each.ravel()
        for each in np.meshgrid(np.arange(len(elevations_deg)), azimuths, indexing="ij")
    )
    tilt = np.radians(np.asarray(elevations_deg))[rings]
    rays = np.stack(
        (np.cos(tilt) * np.cos(turns), np.cos(tilt) * np.sin(turns), np.sin(tilt)), axis=1
    )
    pitch = np.radians(pitch_deg)
    rise = rays @ (-np.sin(pitch), 0, np.cos(pitch))  # of a LiDAR whose front is lowered
    ranges = np.where(rise < 0, np.minimum(-1.8 / np.minimum(rise, -1e-9), 40), 30 + 5 * rays[:, 1])
    points = np.concatenate((rays * ranges[:, None], np.full((len(rays), 1), 0.3)), axis=1)
    return torch.from_numpy(points.astype(np.float32)), rings


def kept_rings(sample, rings, severity, seed=0):
    """Rings that stay, of which all points stay."""
    found = (
        KINDS["lidar_beams"].at(severity).corrupt(sample, fault_rng(sample, seed, "lidar_beams"))
    )
    stay = np.unique(rings[found.point_sources.numpy()])
    assert len(found.sample.points) == np.isin(rings, stay).sum()
    return stay


@pytest.mark.parametrize("order", ["firings", "rings"])
@pytest.mark.parametrize("pitch_deg", [0.0, 10.0])
@pytest.mark.parametrize("rig", RIGS)
def test_the_documented_share_of_a_sensors_own_rings_stays(rig, pitch_deg, order):
    points, rings = sweep(RIGS[rig], pitch_deg=pitch_deg, order=order)
    sample = sample_of(points=points)
    before = np.arange(len(RIGS[rig]))
    for severity, share in enumerate(SHARES, 1):
        stay = kept_rings(sample, rings, severity)
        assert len(stay) == round(share * len(RIGS[rig]))
        assert set(stay) <= set(before)  # a worse severity loses the same and more
        assert np.diff(stay).max(initial=0) <= 4 / share
        before = stay


def test_of_a_sensor_like_kittis_the_beams_are_the_assumed_ones():
    points, rings = sweep(HDL_64E.beam_elevations_deg)
    sample = sample_of(points=points)
    assert beams_of(sample, HDL_64E).num_beams == 64
    assert (beams_of(sample, HDL_64E).numbers == rings).all()
    half = replace(sample, points=points[torch.from_numpy(rings < 32)])  # as in a narrow view
    assert (beams_of(half, HDL_64E).numbers == rings[rings < 32]).all()
    assert beams_of(half, HDL_64E).num_beams == 64
    sparse = replace(sample, points=points[torch.from_numpy(rings % 2 == 0)])
    assert beams_of(sparse, HDL_64E).num_beams == 32


def test_points_in_a_vehicles_frame_lose_the_rings_of_their_lidar():
    points, rings = sweep(RIGS["32 rings"])
    on_road = points + torch.tensor([0, 0, 1.73, 0])
    sample = sample_of(points=on_road, lidar_height_m=0.0)
    assert len(kept_rings(sample, rings, 3)) == 8


def solid_state(count=4000):
    rng = np.random.default_rng(0)
    azimuth, elevation = np.radians(rng.uniform((-40, -12), (40, 12), (count, 2))).T
    ranges = rng.uniform(5, 60, count)
    flat = ranges * np.cos(elevation)
    columns = (flat * np.cos(azimuth), flat * np.sin(azimuth), ranges * np.sin(elevation))
    return np.stack((*columns, rng.random(count)), axis=1).astype(np.float32)


def test_a_sweep_without_rings_is_told_and_never_emptied():
    sample = sample_of(points=torch.from_numpy(solid_state()))
    for seed in range(4):
        with pytest.warns(UserWarning, match="shows no rings.* as of a solid-state") as caught:
            stay = KINDS["lidar_beams"].at(5)(sample, fault_rng(sample, seed, "lidar_beams"))
        assert len(caught) == 1
        assert 0 < len(stay.points) < len(sample.points)


def test_one_of_few_beams_with_points_stays():
    low = solid_state(200)
    low[:, 2] = low[:, 0] * -0.02  # in few of the assumed beams, and too few for a warning
    for seed in range(20):
        assert len(corrupt_arrays("lidar_beams", 5, points=low, seed=seed).points) > 0


def test_ghosts_lie_in_the_view_of_the_sensor():
    points, _ = sweep(RIGS["16 rings"])
    assert view_of(sample_of(points=points), HDL_64E) == pytest.approx((-15, 15), abs=0.01)
    kitti, _ = sweep(HDL_64E.beam_elevations_deg)
    assert view_of(sample_of(points=kitti), HDL_64E) == (-24.333, 2.0)
    assert view_of(sample_of(points=kitti[:0]), HDL_64E) == (-24.333, 2.0)
