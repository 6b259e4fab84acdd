import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from lightning.pytorch.callbacks import EMAWeightAveraging

from sightline.training.optimizer import OptimizerConfig, make_optimizer, make_schedule
from sightline.training.sources import SourceConfig
from tests.training import toy


def rates(config, total_steps):
    """Learning rate of each step."""
    optimizer = torch.optim.SGD([torch.nn.Parameter(torch.zeros(1))], lr=config.learning_rate,
                                momentum=0.9)  # fmt: skip
    schedule = make_schedule(optimizer, config, total_steps)
    found = []
    for _ in range(total_steps):
        found.append(optimizer.param_groups[0]["lr"])
        optimizer.step()
        schedule.step()
    return found


@pytest.mark.parametrize("schedule", ["one_cycle", "cosine", "constant"])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
@pytest.mark.parametrize("total_steps", [1, 2, 4, 10, 100])
def test_every_schedule_stays_within_the_highest_rate(schedule, share, total_steps):
    config = OptimizerConfig(learning_rate=0.2, schedule=schedule, warm_up_share=share)
    found = rates(config, total_steps)
    assert all(0 < rate <= 0.2 * (1 + 1e-9) for rate in found)


@pytest.mark.parametrize("schedule", ["one_cycle", "cosine"])
def test_a_schedule_rises_in_the_warm_up_and_falls_to_nothing(schedule):
    config = OptimizerConfig(learning_rate=0.2, schedule=schedule, warm_up_share=0.3)
    found = rates(config, 100)
    top = found.index(max(found))
    assert top in (29, 30)
    assert max(found) == pytest.approx(0.2)
    assert found[: top + 1] == sorted(found[: top + 1])
    assert found[top:] == sorted(found[top:], reverse=True)
    assert found[-1] < 0.2 / 1000


def test_a_cosine_is_at_half_its_height_half_way():
    assert rates(OptimizerConfig(learning_rate=0.2, schedule="cosine"), 100)[50] == (
        pytest.approx(0.1)
    )


def test_a_constant_rate_after_the_warm_up_stays():
    found = rates(OptimizerConfig(learning_rate=0.2, warm_up_share=0.04), 100)
    assert found[:4] == pytest.approx([0.04, 0.08, 0.12, 0.16])
    assert set(found[4:]) == {0.2}


def test_a_rate_in_steps_falls_to_a_tenth_at_each():
    config = OptimizerConfig(
        learning_rate=0.2, schedule="steps", warm_up_share=0.02, drop_shares=(0.5, 0.75)
    )
    found = rates(config, 100)
    assert found[0] == pytest.approx(0.2 / 3)
    assert found[2:50] == pytest.approx([0.2] * 48)
    assert found[50:75] == pytest.approx([0.02] * 25)
    assert found[75:] == pytest.approx([0.002] * 25)
    halved = replace(config, drop_factor=0.5)
    assert rates(halved, 100)[50:] == pytest.approx([0.1] * 25 + [0.05] * 25)


@pytest.mark.parametrize(
    "settings",
    [
        {"schedule": "steps"},
        {"drop_shares": (0.5,)},
        {"schedule": "steps", "drop_shares": (0.7, 0.6)},
        {"schedule": "steps", "drop_shares": (1.2,)},
        {"schedule": "steps", "drop_shares": (0.1,), "warm_up_share": 0.2},
        {"schedule": "steps", "drop_shares": (0.5,), "drop_factor": 0.0},
    ],
)
def test_drops_that_make_no_sense_are_refused(settings):
    with pytest.raises(ValueError, match="drop_"):
        OptimizerConfig(**settings)


@pytest.mark.parametrize("name", ["adam", "adamw", "sgd"])
@pytest.mark.parametrize("schedule", ["constant", "one_cycle", "cosine"])
def test_parts_with_a_factor_learn_at_that_share_of_the_rate_all_along(name, schedule):
    config = OptimizerConfig(
        name=name,
        learning_rate=0.2,
        schedule=schedule,
        warm_up_share=0.2,
        rate_factors={"gate.*": 0.05, "*.bias": 0.5},
    )
    layers = torch.nn.ModuleDict({"gate": torch.nn.Linear(1, 1), "mix": torch.nn.Linear(1, 1)})
    optimizer = make_optimizer(layers.named_parameters(), config)
    members = [group["params"] for group in optimizer.param_groups]
    assert members == [[layers["mix"].weight], [*layers["gate"].parameters()], [layers["mix"].bias]]
    plan = make_schedule(optimizer, config, 20)
    for _ in range(20):
        full, gate, bias = (group["lr"] for group in optimizer.param_groups)
        assert gate == pytest.approx(0.05 * full)
        assert bias == pytest.approx(0.5 * full)
        optimizer.step()
        plan.step()


def test_a_factor_that_fits_nothing_is_told(frames, tmp_path, capsys):
    module = toy.module(rate_factors={"*_gate.*": 0.05, "network.*": 0.5})
    toy.trainer(tmp_path, max_epochs=1).fit(module, datamodule=toy.data(frames))
    assert "rate_factors has *_gate.*, which matches no parameter" in capsys.readouterr().err


def test_parts_with_the_factor_0_are_frozen(frames, tmp_path):
    before = dict(toy.module().named_parameters())
    frozen = next(iter(before))
    module = toy.module(rate_factors={frozen: 0.0}, weight_decay=0.1)
    toy.trainer(tmp_path, max_epochs=1).fit(module, datamodule=toy.data(frames))
    after = dict(module.named_parameters())
    unchanged = [name for name in before if torch.equal(after[name], before[name])]
    assert unchanged == [frozen]


@pytest.mark.filterwarnings("ignore:Found 1 module")
@pytest.mark.parametrize("averaged", [False, True])
def test_a_frozen_network_stays_as_it_is_with_its_batch_normalisation(frames, tmp_path, averaged):
    trained = "network.layers.3.bias"
    module = toy.module(rate_factors={trained: 1.0, "*": 0.0})
    before = {name: each.clone() for name, each in module.state_dict().items()}
    callbacks = [EMAWeightAveraging(decay=0.8)] if averaged else []
    data = toy.data(frames, validation=(SourceConfig(path=Path()),))
    toy.trainer(tmp_path, max_epochs=2, callbacks=callbacks).fit(module, datamodule=data)
    after = module.state_dict()
    assert not torch.equal(after.pop(trained), before.pop(trained))
    tolerance = 1e-6 if averaged else 0.0  # means of equal numbers are rounded
    torch.testing.assert_close(after, before, rtol=tolerance, atol=0.0)
    module.train()  # as a caller may
    assert not module.network.layers[1].training
    assert module.network.layers[2].training  # dropout


def test_batch_normalisation_goes_on_where_one_of_its_parameters_is_trained(frames, tmp_path):
    module = toy.module(rate_factors={"*.layers.1.bias": 0.0})
    mean = module.network.layers[1].running_mean.clone()
    toy.trainer(tmp_path, max_epochs=1).fit(module, datamodule=toy.data(frames))
    assert not torch.equal(module.network.layers[1].running_mean, mean)


@pytest.mark.parametrize("factor", [-1.0, math.inf, math.nan])
def test_factors_that_make_no_sense_are_refused(factor):
    with pytest.raises(ValueError, match="rate_factors must be finite and not negative, got"):
        OptimizerConfig(rate_factors={"*": factor})


def test_the_schedule_ends_with_the_training(frames, tmp_path):
    module = toy.module(schedule="cosine", warm_up_share=0.0)
    toy.trainer(tmp_path, max_epochs=2).fit(module, datamodule=toy.data(frames))
    assert module.lr_schedulers().get_last_lr() == pytest.approx([0.0], abs=1e-12)


def test_a_schedule_over_an_endless_training_is_refused(frames, tmp_path):
    trainer = toy.trainer(tmp_path, max_epochs=-1)
    with pytest.raises(ValueError, match=r"set --trainer\.max_epochs or --trainer\.max_steps"):
        trainer.fit(toy.module(), datamodule=toy.data(frames))


@pytest.mark.parametrize(
    ("name", "kind"),
    [("adam", torch.optim.Adam), ("adamw", torch.optim.AdamW), ("sgd", torch.optim.SGD)],
)
def test_the_named_optimiser_is_made(name, kind):
    module = toy.module(name=name, schedule="constant", warm_up_share=0.0, weight_decay=0.25)
    optimizer = module.configure_optimizers()
    assert type(optimizer) is kind
    assert optimizer.param_groups[0]["weight_decay"] == 0.25


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("learning_rate", 0.0),
        ("weight_decay", -1.0),
        ("warm_up_share", 1.0),
        ("warm_up_share", -0.1),
        ("momentum", 1.0),
    ],
)
def test_settings_out_of_range_are_refused(setting, value):
    with pytest.raises(ValueError, match=f"{setting} must .* got {value}"):
        OptimizerConfig(**{setting: value})


def test_momentum_moves_in_a_one_cycle_only():
    for schedule, moves in (("one_cycle", True), ("cosine", False)):
        optimizer = torch.optim.Adam([torch.nn.Parameter(torch.zeros(1))], lr=0.1)
        config = OptimizerConfig(schedule=schedule, warm_up_share=0.5)
        make_schedule(optimizer, config, 10)
        assert (not math.isclose(optimizer.param_groups[0]["betas"][0], 0.9)) == moves
