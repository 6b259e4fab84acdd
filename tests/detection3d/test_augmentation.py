"""Scenes changed for training: points stay in their boxes."""

import numpy as np
import pytest
import torch

from sightline.augmentation.sweep_changes import GroundShapeConfig
from sightline.data.formats.rings import ring_numbers
from sightline.detection3d.examples import SceneChangeConfig, change_scene, thin_beams
from sightline.detection3d.sweeps import SweepConfig, cut_to_view
from sightline.geometry.boxes3d import Boxes3D
from tests.detection3d.frames import simulated_frames

NOTHING = SceneChangeConfig(mirror=False, turn_deg=0.0, scales=(1.0, 1.0))


@pytest.fixture(scope="module")
def sample():
    return cut_to_view(simulated_frames()[0], SweepConfig())


def num_inside(sample, margin_m):
    objects = sample.objects
    boxes = Boxes3D(objects.boxes3d.tensor[objects.has_box3d]).enlarge(margin_m)
    return boxes.contain(sample.points[:, :3].double()).sum(dim=1)


def test_points_stay_in_their_boxes_whatever_is_drawn(sample):
    config = SceneChangeConfig(
        ground=GroundShapeConfig(), range_noise_m=0.01, stretch=(0.1, 0.05, 0.05)
    )
    before = num_inside(sample, 0.0)
    for seed in range(6):
        after = num_inside(change_scene(sample, config, np.random.default_rng(seed)), 0.05)
        assert (after >= 0.85 * before - 2).all()  # a shear moves a box's ends a little
        assert not torch.equal(after, torch.zeros_like(after))


def test_nothing_changes_where_nothing_is_asked_for(sample):
    same = change_scene(sample, NOTHING, np.random.default_rng(0))
    torch.testing.assert_close(same.points, sample.points)
    torch.testing.assert_close(same.objects.boxes3d.tensor, sample.objects.boxes3d.tensor)


def test_what_is_drawn_lies_within_its_bounds(sample):
    config = SceneChangeConfig(mirror=False)
    far = sample.points[:, :2].norm(dim=1).argmax()
    for seed in range(8):
        points = change_scene(sample, config, np.random.default_rng(seed)).points
        factor = points[far, :3].norm() / sample.points[far, :3].norm()
        azimuths = [torch.atan2(each[far, 1], each[far, 0]) for each in (points, sample.points)]
        assert 0.95 - 1e-6 <= float(factor) <= 1.05 + 1e-6
        assert abs(np.degrees(float(azimuths[0] - azimuths[1]))) <= 10


def test_stretched_objects_differ_from_each_other_and_keep_their_mean_size(sample):
    config = SceneChangeConfig(**{**vars(NOTHING), "stretch": (0.1, 0.0, 0.02)})
    sizes = sample.objects.boxes3d.sizes
    has_box = sample.objects.has_box3d
    logs = torch.stack(
        [
            (
                change_scene(sample, config, np.random.default_rng(seed)).objects.boxes3d.sizes
                / sizes
            ).log()[has_box]
            for seed in range(60)
        ]
    ).reshape(-1, 3)
    assert abs(float(logs[:, 0].mean())) < 0.02
    assert 0.08 < float(logs[:, 0].std()) < 0.12
    assert float(logs[:, 1].abs().max()) == 0
    assert 0.015 < float(logs[:, 2].std()) < 0.025


def test_a_sweep_of_fewer_beams_has_fewer_rings(sample):
    config = SceneChangeConfig(**{**vars(NOTHING), "beams": (16,)})
    thinned, has_all_beams = thin_beams(sample, config, np.random.default_rng(0))
    assert not has_all_beams
    whole, thin = (len(np.unique(ring_numbers(each.points.numpy()))) for each in (sample, thinned))
    assert thin <= whole / 4 + 1
    assert 0.15 < len(thinned.points) / len(sample.points) < 0.35


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"scales": (1.1, 0.9)}, "scales must be positive and in order"),
        ({"turn_deg": -1.0}, "turn_deg must be finite and not negative"),
        ({"stretch": (0.1, -0.1, 0.0)}, "stretch must be finite and not negative"),
        ({"bank_frames": 0}, "bank_frames must be at least 1, got 0"),
        ({"beams": (48,)}, "beams must hold some of"),
    ],
)
def test_settings_out_of_range_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        SceneChangeConfig(**settings)
