from dataclasses import dataclass

import pytest
import torch

from sightline.data.settings import plain_settings
from sightline.data.weights import write_weights
from sightline.training.initial_weights import choose_settings
from sightline.training.optimizer import OptimizerConfig
from tests.training import toy


@dataclass(frozen=True, kw_only=True)
class TwoStagesConfig:
    """A network of two networks."""

    first: toy.ToyConfig = toy.ToyConfig()  # noqa: RUF009 - frozen
    second: toy.ToyConfig = toy.ToyConfig()  # noqa: RUF009
    third: toy.ToyConfig | None = None
    width: int = 1
    """Of no module."""


class TwoStages(toy.ToyModule):
    """Its first stage can come from elsewhere."""

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
        config=plain_settings(module.network_config()),
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
    ("initial", "said"),
    [
        ({"initial_part": "third"}, "initial_part third is no part .* first, second"),
        ({"initial_part": "width"}, "initial_part width is no part"),
        ({}, "is of task toy, expected two-stages"),
        ({"initial_part": "first", "network": TwoStagesConfig(first=toy.ToyConfig(channels=3))},
         r"of other settings \(channels 2 instead of 3\)"),
    ],
)  # fmt: skip
def test_weights_that_do_not_fit_the_part_are_refused(tmp_path, initial, said):
    file = write(tmp_path / "w.safetensors", toy.ToyModule(), 3)
    with pytest.raises(ValueError, match=said):
        TwoStages(initial_weights=file, **initial)


def test_weights_that_are_older_than_a_setting_of_an_optional_part_have_its_default(tmp_path):
    config = TwoStagesConfig(third=toy.ToyConfig(channels=3))
    module = TwoStages(config)
    older = plain_settings(config)
    for part in older.values():
        if isinstance(part, dict):
            del part["dropout"]
    tensors = tensors_of(module.network, 3)
    write_weights(tmp_path / "w", tensors, task="two-stages", config=older, provenance={})
    TwoStages(config, initial_weights=tmp_path / "w")
    with pytest.raises(ValueError, match=r"\(third \{'channels': 3\} instead of None\)"):
        TwoStages(initial_weights=tmp_path / "w")


def test_a_part_without_weights_is_refused():
    with pytest.raises(ValueError, match="set those too"):
        TwoStages(initial_part="first")


def test_settings_come_from_the_recipe_else_from_the_weights_else_are_the_defaults(tmp_path):
    of_weights = toy.ToyConfig(channels=5)
    file = write(tmp_path / "w.safetensors", toy.ToyModule(of_weights), 0)
    given = toy.ToyConfig(channels=7)
    assert choose_settings(given, toy.ToyConfig, file) == given
    assert choose_settings(None, toy.ToyConfig, file) == of_weights
    assert choose_settings(None, toy.ToyConfig, None) == toy.ToyConfig()
    with pytest.raises(ValueError, match=r"w\.safetensors describes a network that cannot be buil"):
        choose_settings(None, OptimizerConfig, file)
