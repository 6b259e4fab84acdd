"""Going on with a run by the command: from its checkpoint, or refused."""

import os
import signal
from functools import partial
from pathlib import Path

import pytest
import torch
import yaml
from lightning.pytorch.callbacks import Callback

from sightline.data.open import open_dataset
from sightline.files.weights import read_weights
from sightline.training.command import run_training
from sightline.training.interruption import Interruption
from sightline.training.trained_frames import validation_change, validation_state
from tests.training import toy


class PressCtrlC(Callback):
    """Callback that presses Ctrl-C in the second step."""

    def on_train_batch_start(self, trainer, *_):
        if trainer.global_step == 1:
            os.kill(os.getpid(), signal.SIGINT)


class PressCtrlCAtOnce(Callback):
    """Callback that presses Ctrl-C before the first step."""

    def on_fit_start(self, *_):
        os.kill(os.getpid(), signal.SIGINT)


def test_the_best_weights_stay_in_a_run_folder_that_was_moved(recipes):
    rising = ["--model.optimizer.learning_rate", "3", "--trainer.max_epochs", "4"]
    run_training("fit", ["--config", "toy", "--run_folder", "run", *rising], recipes)
    best = Path("run/weights.safetensors").read_bytes()
    assert (
        read_weights("run/last.ckpt").provenance["steps"]
        != read_weights("run/weights.safetensors").provenance["steps"]
    ), "the last weights are not the best"
    weights = Path("run").rename("moved") / "weights.safetensors"
    resume = ["--config", "moved/config.yaml", "--run_folder", "moved", "--ckpt_path", "last"]
    run_training("fit", resume, recipes)
    assert weights.read_bytes() == best
    for remove in (weights.unlink, partial(weights.write_bytes, b"")):  # as after a power cut
        remove()
        run_training("fit", resume, recipes)
        assert weights.read_bytes() == best


@pytest.mark.parametrize("averaged", [[], ["--trainer.callbacks+=EMAWeightAveraging"]])
def test_ctrl_c_tells_how_to_go_on_and_going_on_is_exact(recipes, averaged):
    press = "--trainer.callbacks+=tests.training.test_resume_command.PressCtrlC"
    previous = signal.getsignal(signal.SIGINT)
    with pytest.raises(Interruption, match="--ckpt_path last"):
        run_training("fit", ["--config", "toy", *averaged, press], recipes)
    assert signal.getsignal(signal.SIGINT) is previous
    run_training("fit", ["--config", "toy", *averaged, "--ckpt_path", "last"], recipes)
    run_training("fit", ["--config", "toy", *averaged, "--run_folder", "whole"], recipes)
    parts, whole = (read_weights(f"{folder}/last.ckpt") for folder in ("runs/toy", "whole"))
    assert all(torch.equal(parts.tensors[name], whole.tensors[name]) for name in whole.tensors)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ([], None),
        (["--data.workers=1", "--trainer.max_epochs=2"], None),
        (["--seed_everything=5"], "the run began with other settings: seed_everything 0, now 5"),
        (
            ["--model.optimizer.learning_rate=0.7"],
            "now 0.7; the optimiser and its learning rate stay as in the checkpoint",
        ),
    ],
)
def test_resuming_with_other_settings_is_told(recipes, capfd, changes, expected):
    press = "--trainer.callbacks+=tests.training.test_resume_command.PressCtrlC"
    with pytest.raises(Interruption):
        run_training("fit", ["--config", "toy", press], recipes)
    capfd.readouterr()
    run_training("fit", ["--config", "toy", "--ckpt_path=last", *changes], recipes)
    printed = capfd.readouterr().err
    assert expected in printed if expected else "other settings" not in printed


@pytest.mark.parametrize(
    ("names", "told"),
    [("0 1 2 3 4", None), ("0 1 2 3", "now has 4"), ("0 1 2 3 5", "now has 5 others")],
)
def test_resuming_with_other_training_frames_is_told(recipes, capfd, names, told):
    training = "--data.training=[{path: ., sample_list: frames.txt}]"
    press = "--trainer.callbacks+=tests.training.test_resume_command.PressCtrlC"
    Path("frames.txt").write_text("".join(f"00000{name}\n" for name in range(5)))
    with pytest.raises(Interruption):
        run_training("fit", ["--config", "toy", training, press], recipes)
    Path("frames.txt").write_text("".join(f"00000{name}\n" for name in names.split()))
    capfd.readouterr()
    run_training("fit", ["--config", "toy", training, "--ckpt_path=last"], recipes)
    printed = capfd.readouterr().err
    assert printed.count("warning: the run had 5 training frames when") == bool(told)
    assert (told or "") in printed


@pytest.mark.parametrize(
    ("names", "told"), [("2 1 0", None), ("0 1", "now has 2:"), ("0 1 5", "now has 3 others:")]
)
def test_resuming_with_other_validation_frames_is_told(recipes, capfd, names, told):
    validation = "--data.validation=[{path: ., sample_list: frames.txt}]"
    toy_run = ["--config", "toy", validation, "--model.optimizer.schedule=constant"]
    Path("frames.txt").write_text("000000\n000001\n000002\n")
    run_training("fit", toy_run, recipes)
    Path("frames.txt").write_text("".join(f"00000{name}\n" for name in names.split()))
    capfd.readouterr()
    run_training("fit", [*toy_run, "--ckpt_path=last", "--trainer.max_epochs=3"], recipes)
    printed = capfd.readouterr().err
    assert printed.count("warning: the run had 3 validation frames when") == bool(told)
    assert (told or "") in printed
    run_training("fit", [*toy_run, "--ckpt_path=last", "--trainer.max_epochs=4"], recipes)
    assert "validation frames when" not in capfd.readouterr().err
    run_training("validate", toy_run, recipes)
    assert "validation frames when" not in capfd.readouterr().err


def test_other_labels_of_the_validation_frames_are_told(tmp_path):
    tree = toy.write_frames(tmp_path, count=2)
    before = validation_state([open_dataset(tree)])
    assert validation_change(before, validation_state([open_dataset(tree)])) is None
    label = tree / "training" / "label_2" / "000001.txt"
    label.write_text(label.read_text().replace("Car ", "Van "))
    now = validation_state([open_dataset(tree)])
    told = validation_change(before, now)
    assert told is not None
    assert "the labels of the run's validation frames changed" in told
    on_a_server = {"validation_labels": ""}
    assert validation_change(before | on_a_server, now) is None
    assert validation_change({}, now) is None  # a checkpoint of before


def test_a_run_that_started_from_weights_goes_on_when_they_are_gone(recipes):
    run_training("fit", ["--config", "toy", "--run_folder", "first"], recipes)
    config = ["--config", "toy", "--model.initial_weights", "first/weights.safetensors"]
    run_training("fit", [*config, "--run_folder", "whole"], recipes)
    press = "--trainer.callbacks+=tests.training.test_resume_command.PressCtrlC"
    with pytest.raises(Interruption):
        run_training("fit", [*config, press], recipes)
    Path("first/weights.safetensors").unlink()
    run_training("fit", [*config, "--ckpt_path", "last"], recipes)
    parts, whole = (read_weights(f"{folder}/last.ckpt") for folder in ("runs/toy", "whole"))
    assert all(torch.equal(parts.tensors[name], whole.tensors[name]) for name in whole.tensors)
    kept = yaml.safe_load(Path("runs/toy/config.yaml").read_text())
    assert kept["model"]["init_args"]["initial_weights"] == "first/weights.safetensors"


def test_a_run_does_not_go_on_from_the_checkpoint_of_another_network(recipes):
    for folder, channels in (("first", 2), ("second", 5)):
        network = f"--model.network.channels={channels}"
        run_training("fit", ["--config", "toy", "--run_folder", folder, network], recipes)
    weights = "--model.initial_weights=first/weights.safetensors"
    for subcommand in ("fit", "validate"):
        with pytest.raises(ValueError, match=r"of other settings \(channels 5 instead of 2\)"):
            run_training(
                subcommand, ["--config=toy", weights, "--ckpt_path=second/last.ckpt"], recipes
            )


def test_a_damaged_checkpoint_is_refused(recipes):
    Path("broken.ckpt").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(ValueError, match="cannot be read as a checkpoint"):
        run_training("fit", ["--config", "toy", "--ckpt_path", "broken.ckpt"], recipes)


def test_ctrl_c_before_the_first_checkpoint_advises_nothing_that_cannot_be(recipes):
    press = "--trainer.callbacks+=tests.training.test_resume_command.PressCtrlCAtOnce"
    with pytest.raises(Interruption, match="there is no checkpoint yet: run the same command agai"):
        run_training("fit", ["--config", "toy", press], recipes)
    assert run_training("fit", ["--config", "toy"], recipes) == 0


@pytest.mark.parametrize("schedule", ["one_cycle", "cosine"])
@pytest.mark.parametrize("longer", [["max_epochs=3"], ["max_epochs=-1", "max_steps=12"]])
def test_a_longer_run_under_a_schedule_is_refused_before_it_goes_on(recipes, schedule, longer):
    toy_run = ["--config", "toy", f"--model.optimizer.schedule={schedule}"]
    run_training("fit", toy_run, recipes)
    before = Path("runs/toy/last.ckpt").read_bytes()
    with pytest.raises(ValueError, match=r"schedule has 8 steps, .* has 12; resume with"):
        run_training(
            "fit",
            [*toy_run, "--ckpt_path=last", *(f"--trainer.{length}" for length in longer)],
            recipes,
        )
    assert Path("runs/toy/last.ckpt").read_bytes() == before


def test_without_a_schedule_a_run_can_go_on_for_longer(recipes):
    constant = ["--config", "toy", "--model.optimizer.schedule=constant"]
    run_training("fit", constant, recipes)
    run_training("fit", [*constant, "--ckpt_path=last", "--trainer.max_epochs=3"], recipes)
    assert read_weights("runs/toy/last.ckpt").provenance["steps"] == "12"


def test_a_resumed_run_names_the_steps_of_its_scores(recipes, capsys):
    run = ["--config", "toy", "--trainer.enable_progress_bar=true"]
    press = "--trainer.callbacks+=tests.training.test_resume_command.PressCtrlC"
    with pytest.raises(Interruption):
        run_training("fit", [*run, press], recipes)
    capsys.readouterr()
    run_training("fit", [*run, "--ckpt_path", "last"], recipes)
    scores = [line for line in capsys.readouterr().err.splitlines() if "mse" in line]
    assert [line.partition(": ")[0] for line in scores] == ["step 4", "step 8"]


def test_a_finished_run_that_is_resumed_in_another_folder_is_an_error_with_two_remedies(
    recipes, capsys
):
    run_training("fit", ["--config", "toy"], recipes)
    config = ["--config", "runs/toy/config.yaml", "--run_folder"]
    resume = ["--ckpt_path", "runs/toy/last.ckpt"]
    with pytest.raises(
        ValueError, match=r"^other: no weights were written: .* after the 8 of runs/toy/last\.ckpt"
    ):
        run_training("fit", [*config, "other", *resume], recipes)
    Path("runs/toy/weights.safetensors").unlink()
    for remedy in (
        ["runs/toy", *resume],
        ["further", "--model.init_args.initial_weights", "runs/toy/last.ckpt"],
    ):
        capsys.readouterr()
        assert run_training("fit", [*config, *remedy], recipes) == 0
        assert f"{remedy[0]}: the weights are in" in capsys.readouterr().out
