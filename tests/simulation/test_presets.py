from sightline.simulation.presets import PRESETS
from sightline.simulation.settings import SimulationConfig


def test_presets_split_into_training_and_validation():
    sizes = {
        name: (p.frames - p.validation_frames, p.validation_frames) for name, p in PRESETS.items()
    }
    assert sizes == {
        "street-2k": (2000, 200),
        "street-8k": (8000, 500),
        "street-hard-500": (0, 500),
    }
    assert PRESETS["street-2k"].config.image_size == (352, 1216)
    assert PRESETS["street-8k"].config == SimulationConfig(seed=8000)
    assert PRESETS["street-hard-500"].config.hard


def test_no_two_presets_share_a_street():
    seeds = [preset.config.seed for preset in PRESETS.values()]
    assert len(set(seeds)) == len(seeds)
