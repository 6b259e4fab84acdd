from dataclasses import dataclass
from functools import partial

import pytest
import torch

from sightline.files.settings import config_to_dict, differing_settings, parse_settings
from sightline.files.weights import write_weights
from sightline.training.initial_weights import choose_settings
from sightline.training.optimizer import OptimizerConfig
from tests.training import toy


@dataclass(frozen=True, kw_only=True)
class TwoStagesConfig:
    """Settings of a network of two networks."""

    first: toy.ToyConfig = toy.ToyConfig()  # noqa: RUF009 - frozen
    second: toy.ToyConfig = toy.ToyConfig()  # noqa: RUF009
    width: int = 1
    """Setting without a module."""


class TwoStages(toy.ToyModule):
    """Network whose first stage can have weights of its own."""

    task_name = "two-stages"

    def __init__(self, network=TwoStagesConfig(), **initial):
        self.config = network
        stages = {"first": toy.ToyNet(network.first), "second": toy.ToyNet(network.second)}
        super(toy.ToyModule, self).__init__(
            torch.nn.ModuleDict(stages), toy.ToyScores(), optimizer=OptimizerConfig(), **initial
        )


def tensors_of(network, value):
    return {name: torch.full_like(tensor, value) for name, tensor in network.state_dict().items()}


def write(path, module, value):
    write_weights(
        path,
        tensors_of(module.network, value),
        task=module.task_name,
        config=config_to_dict(module.network_config()),
        provenance={},
    )
    return path


@pytest.mark.parametrize("kind", [toy.ToyModule, TwoStages])
def test_initial_weights_fill_a_part_from_its_own_file_or_from_a_whole_network(tmp_path, kind):
    file = write(tmp_path / "w.safetensors", kind(), 3)
    torch.manual_seed(0)
    before = TwoStages().network["second"].state_dict()
    torch.manual_seed(0)
    started = TwoStages(initial_weights=file, initial_part="first")
    assert all((tensor == 3).all() for tensor in started.network["first"].state_dict().values())
    for name, tensor in started.network["second"].state_dict().items():
        assert torch.equal(tensor, before[name])


@pytest.mark.parametrize(
    ("initial", "expected"),
    [
        ({"initial_part": "third"}, "initial_part third is no part .* first, second"),
        ({"initial_part": "width"}, "initial_part width is no part"),
        ({}, "is of task toy, expected two-stages"),
        ({"initial_part": "first", "network": TwoStagesConfig(first=toy.ToyConfig(channels=3))},
         r"of other settings \(channels 2 instead of 3\)"),
    ],
)  # fmt: skip
def test_weights_that_do_not_fit_the_part_are_refused(tmp_path, initial, expected):
    file = write(tmp_path / "w.safetensors", toy.ToyModule(), 3)
    with pytest.raises(ValueError, match=expected):
        TwoStages(initial_weights=file, **initial)


@dataclass(frozen=True, kw_only=True)
class SizedConfig:
    """Settings with a required value."""

    size: int
    depth: int = 1


@dataclass(frozen=True, kw_only=True)
class PartsConfig:
    """Settings with parts of every kind."""

    optional: toy.ToyConfig | None = None
    wide: toy.ToyConfig = toy.ToyConfig(channels=8)  # noqa: RUF009 - frozen
    several: tuple[toy.ToyConfig, ...] = ()
    sized: SizedConfig = SizedConfig(size=3)


def test_what_a_file_is_too_old_to_name_of_a_part_is_what_it_is_read_with():
    channels = toy.ToyConfig(channels=4)
    ours = PartsConfig(optional=toy.ToyConfig(channels=3), several=(channels, channels))
    older = config_to_dict(ours)
    for part in (older["optional"], older["wide"], *older["several"]):
        del part["dropout"]
    del older["wide"]["channels"], older["sized"]["depth"]
    assert parse_settings(PartsConfig, older) == ours
    assert differing_settings(older, ours) == ""
    assert differing_settings(older | {"optional": None}, ours).startswith("optional None instead")
    assert "colour red instead of None" in differing_settings(older | {"colour": "red"}, ours)


def test_a_part_without_weights_is_refused():
    with pytest.raises(ValueError, match="initial_part first needs initial_weights"):
        TwoStages(initial_part="first")


def test_settings_come_from_the_recipe_else_from_the_weights_else_are_the_defaults(tmp_path):
    stored = toy.ToyConfig(channels=5)
    file = write(tmp_path / "w.safetensors", toy.ToyModule(stored), 0)
    given = toy.ToyConfig(channels=7)
    choose = partial(choose_settings, task_name=toy.ToyModule.task_name)
    assert choose(given, toy.ToyConfig, file) == given
    assert choose(None, toy.ToyConfig, file) == stored
    assert choose(None, toy.ToyConfig, None) == toy.ToyConfig()
    with pytest.raises(ValueError, match=r"w\.safetensors describes a network that cannot be buil"):
        choose(None, OptimizerConfig, file)
    with pytest.raises(ValueError, match=r"w\.safetensors is of task toy, expected two-stages"):
        choose_settings(None, TwoStagesConfig, file, task_name="two-stages")
