import json
import os
import signal
import sys
from pathlib import Path

import pytest
import torch
import yaml
from lightning.pytorch.callbacks import Callback

from sightline.training.checkpoint import read_weights
from sightline.training.command import run_training

RECIPE = {
    "model": {
        "class_path": "tests.training.toy.ToyModule",
        "init_args": {"optimizer": {"schedule": "cosine"}},
    },
    "data": {
        "class_path": "sightline.training.data.CameraLidarData",
        "init_args": {
            "preparation": {"class_path": "tests.training.toy.ToyPreparation"},
            "training": [{"path": "."}],
            "validation": [{"path": "."}],
            "test": [{"path": "."}],
            "batch_size": 2,
            "workers": 0,
        },
    },
    "trainer": {
        "max_epochs": 2,
        "accelerator": "cpu",
        "enable_progress_bar": False,
        "enable_model_summary": False,
    },
}


class PressCtrlC(Callback):
    """Does so in the second step."""

    def on_train_batch_start(self, trainer, *_):
        if trainer.global_step == 1:
            os.kill(os.getpid(), signal.SIGINT)


@pytest.fixture
def recipes(tmp_path, frames, monkeypatch):
    """A folder with a recipe named toy; the current folder is an empty one."""
    recipe = json.loads(json.dumps(RECIPE))
    recipe["data"]["init_args"]["root"] = str(frames)
    folder = tmp_path / "recipes"
    folder.mkdir()
    (folder / "toy.yaml").write_text(yaml.safe_dump(recipe))
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return folder


def test_a_recipe_is_trained_by_its_name_and_leaves_all_in_its_folder(recipes, tmp_path):
    assert run_training("fit", ["--config", "toy"], recipes) == 0
    folder = tmp_path / "work" / "runs" / "toy"
    names = {path.name for path in folder.iterdir()}
    (events,) = (name for name in names if name.startswith("events.out.tfevents"))
    assert names - {events} == {
        "config.yaml",
        "hparams.yaml",  # TensorBoard's own
        "last.ckpt",
        "best.ckpt",
        "weights.safetensors",
    }
    weights = read_weights(folder / "weights.safetensors")
    assert weights.task == "toy"
    assert weights.provenance.keys() == {"sightline", "seed", "steps", "epochs", "validation/mse"}
    best = read_weights(folder / "best.ckpt")
    assert all(torch.equal(weights.tensors[name], best.tensors[name]) for name in best.tensors)


def test_without_validation_the_last_weights_are_written(recipes):
    assert run_training("fit", ["--config=toy", "--data.validation=[]"], recipes) == 0
    weights = read_weights("runs/toy/weights.safetensors")
    last = read_weights("runs/toy/last.ckpt")
    assert weights.provenance["steps"] == "8"
    assert all(torch.equal(weights.tensors[name], last.tensors[name]) for name in last.tensors)


def test_a_run_can_be_repeated_from_what_it_left_behind(recipes):
    run_training("fit", ["--config", "toy", "--model.network.channels", "3",
                         "--seed_everything", "5"], recipes)  # fmt: skip
    run_training("fit", ["--config", "runs/toy/config.yaml", "--run_folder", "again"], recipes)
    first, again = (read_weights(f"{folder}/last.ckpt") for folder in ("runs/toy", "again"))
    assert first.config["channels"] == 3
    assert first.provenance["seed"] == "5"
    assert all(torch.equal(first.tensors[name], again.tensors[name]) for name in first.tensors)


def test_another_seed_gives_other_weights(recipes):
    for seed in ("1", "2"):
        run_training(
            "fit", ["--config", "toy", "--seed_everything", seed, "--run_folder", seed], recipes
        )
    name = "layers.0.weight"
    assert not torch.equal(*(read_weights(f"{seed}/last.ckpt").tensors[name] for seed in "12"))


@pytest.mark.parametrize("averaged", [[], ["--trainer.callbacks+=EMAWeightAveraging"]])
def test_ctrl_c_tells_how_to_go_on_and_going_on_is_exact(recipes, averaged):
    press = "--trainer.callbacks+=tests.training.test_command.PressCtrlC"
    previous = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt, match="--ckpt_path last"):
        run_training("fit", ["--config", "toy", *averaged, press], recipes)
    signal.signal(signal.SIGINT, previous)
    run_training("fit", ["--config", "toy", *averaged, "--ckpt_path", "last"], recipes)
    run_training("fit", ["--config", "toy", *averaged, "--run_folder", "whole"], recipes)
    parts, whole = (read_weights(f"{folder}/last.ckpt") for folder in ("runs/toy", "whole"))
    assert all(torch.equal(parts.tensors[name], whole.tensors[name]) for name in whole.tensors)


def test_a_run_is_not_begun_over_another(recipes):
    run_training("fit", ["--config", "toy"], recipes)
    with pytest.raises(ValueError, match=r"holds a run already; .* --ckpt_path last, or .*folder"):
        run_training("fit", ["--config", "toy"], recipes)


@pytest.mark.parametrize("subcommand", ["validate", "test"])
def test_scores_of_the_best_weights_are_written(recipes, subcommand, capsys):
    run_training("fit", ["--config", "toy"], recipes)
    configured = (recipes.parent / "work/runs/toy/config.yaml").read_text()
    assert run_training(subcommand, ["--config", "toy"], recipes) == 0
    key = {"validate": "validation/mse", "test": "test/mse"}[subcommand]
    report = json.loads(Path(f"runs/toy/{subcommand}.json").read_text())
    assert report["checkpoint"] == "runs/toy/best.ckpt"
    assert report["metrics"].keys() == {key}
    assert key in capsys.readouterr().out
    assert (recipes.parent / "work/runs/toy/config.yaml").read_text() == configured


def test_weights_files_can_be_tested_without_a_run(recipes):
    run_training("fit", ["--config", "toy"], recipes)
    weights = "runs/toy/weights.safetensors"
    run_training(
        "test",
        ["--config", "toy", "--run_folder", "other", "--model.initial_weights", weights],
        recipes,
    )
    run_training("test", ["--config", "toy"], recipes)
    reports = [
        json.loads(Path(folder, "test.json").read_text())["metrics"]
        for folder in ("other", "runs/toy")
    ]
    assert reports[0] == reports[1]


def test_the_resolved_settings_are_shown(recipes, capsys):
    with pytest.raises(SystemExit) as end:
        run_training(
            "fit", ["--config", "toy", "--data.batch_size", "3", "--print_config"], recipes
        )
    assert end.value.code in (None, 0)
    shown = yaml.safe_load(capsys.readouterr().out)
    assert shown["data"]["init_args"]["batch_size"] == 3
    assert shown["model"]["init_args"]["optimizer"]["schedule"] == "cosine"
    assert shown["trainer"]["use_distributed_sampler"] is False


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--config", "tony"], "there is no recipe tony; .*: toy"),
        (["--config", "toy", "--model.network.chanels", "3"], "chanels"),
        (["--config", "toy", "--model.network.channels", "many"], "many"),
        (["--config", "toy", "--model.optimizer.learning_rate", "-1"], "must be positive"),
        (["--config", "toy", "--trainer.max_epoch", "3"], "max_epoch"),
        (["--config", "toy", "--data.batch_size", "0"], "batch_size must be at least 1"),
        (["--config", "toy", "--data.training", "[{path: ., repeat: 0}]"], "^repeat must be"),
        (["--config", "toy", "--trainer.max_epochs", "x"], "max_epochs.*int.*x; see sightline fit"),
        (["--config", "toy", "--model.initial_weights", "nofile"], "^there are no weights 'no"),
        (["--config", "toy", "--data.root", "/gone"], "/gone does not exist"),
        (["--config", "toy", "--checkpoint_every_n_steps", "0"], "must be at least 1, got 0"),
        (["--config", "toy", "--ckpt_path", "last"], "there is no checkpoint runs/toy/last.ckpt"),
        (["--config", "toy", "--model", "tests.training.toy.Nothing"], "Nothing"),
        ([], "model"),
    ],
)  # fmt: skip
def test_what_cannot_be_trained_is_refused_in_one_sentence(recipes, arguments, said):
    with pytest.raises(ValueError, match=said) as refused:
        run_training("fit", arguments, recipes)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 300, refused.value


def test_a_damaged_checkpoint_is_refused(recipes):
    Path("broken.ckpt").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(ValueError, match="cannot be read as a checkpoint"):
        run_training("fit", ["--config", "toy", "--ckpt_path", "broken.ckpt"], recipes)


def test_testing_without_any_weights_is_refused(recipes):
    with pytest.raises(ValueError, match=r"there is no checkpoint runs/toy/last\.ckpt"):
        run_training("test", ["--config", "toy"], recipes)


def test_nothing_is_said_that_the_user_cannot_act_on(recipes, capfd, recwarn):
    run_training("fit", ["--config", "toy"], recipes)
    sys.stdout.flush()
    printed = capfd.readouterr()
    assert printed.err == ""
    assert printed.out.splitlines() == ["runs/toy: the weights are in weights.safetensors"]
    assert not [str(warning.message) for warning in recwarn]
