import pytest

from sightline.simulation.settings import PRESETS, SimulationConfig
from tests.settings import set_unchecked


def test_presets_split_into_training_and_validation():
    sizes = {
        name: (p.frames - p.validation_frames, p.validation_frames) for name, p in PRESETS.items()
    }
    assert sizes == {
        "street-2k": (2000, 200),
        "street-8k": (8000, 500),
        "street-hard-500": (0, 500),
        "street-negatives-4k": (4000, 500),
        "street-rigs-8k": (8000, 500),
        "rigs-val-600": (0, 600),
    }
    assert PRESETS["street-2k"].config.image_size == (352, 1216)
    assert PRESETS["street-8k"].config == SimulationConfig(seed=8000)
    assert PRESETS["street-hard-500"].config.hard
    assert PRESETS["street-negatives-4k"].config.hard_negatives


def test_no_two_presets_share_a_street():
    seeds = [preset.config.seed for preset in PRESETS.values()]
    assert len(set(seeds)) == len(seeds)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"lidar": "hdl-16e"}, "lidar must be one of hdl-64e, hdl-32e, vlp-16, got 'hdl-16e'"),
        ({"rig": "kity"}, "rig must be a Rig or one of random, named, got 'kity'"),
        ({"samples_per_pixel": 2}, "samples_per_pixel must be one of 1, 4, got 2"),
    ],
)
def test_settings_that_there_are_not_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        set_unchecked(SimulationConfig(), **wrong)
