import errno
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
import torch
import yaml
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from sightline.cli.main import main
from sightline.files.weights import read_weights
from sightline.training.command import run_training
from sightline.training.run_log import read_run_log
from tests.training import toy


def test_a_recipe_is_trained_by_its_name_and_leaves_all_in_its_folder(recipes, tmp_path):
    assert run_training("fit", ["--config", "toy"], recipes) == 0
    folder = tmp_path / "work" / "runs" / "toy"
    names = {path.name for path in folder.iterdir()}
    (events,) = (name for name in names if name.startswith("events.out.tfevents"))
    assert names - {events} == {
        ".claim",
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


@pytest.mark.parametrize("setting", ["max_steps", "limit_train_batches"])
def test_a_training_without_a_step_is_an_error_that_names_the_settings(recipes, setting):
    run = ["--config", "toy", f"--trainer.{setting}", "0", "--data.validation=[]"]
    with pytest.raises(ValueError, match=r"runs/toy: the training ended without a step"):
        run_training("fit", run, recipes)
    assert not Path("runs/toy/weights.safetensors").exists()


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("precision=bf16-true", r"precision bf16-true does not .* 32-true, bf16-mixed or 16-mixed"),
        ("precision=64", "precision 64 does not suit"),
        ("gradient_clip_val=-1", "gradient_clip_val must not be negative, got -1"),
        ("barebones=true", "a run would have no result; leave it out"),
    ],
)
def test_settings_of_the_trainer_that_cannot_work_are_refused(recipes, setting, message):
    with pytest.raises(ValueError, match=message):
        run_training("fit", ["--config", "toy", f"--trainer.{setting}"], recipes)
    assert not Path("runs/toy/config.yaml").exists()


def test_a_trial_run_leaves_no_weights_and_says_so(recipes, capsys):
    run = ["--config", "toy", "--trainer.fast_dev_run", "true"]
    assert run_training("fit", run, recipes) == 0
    assert "no weights were written" in capsys.readouterr().out


def test_the_last_weights_are_kept_and_scored_where_asked_for(recipes, capsys):
    run = ["--config", "toy", "--keep_last_weights", "true"]
    assert run_training("fit", run, recipes) == 0
    weights, last = (
        read_weights(f"runs/toy/{name}") for name in ("weights.safetensors", "last.ckpt")
    )
    assert weights.provenance == last.provenance  # no score of a best validation
    assert all(torch.equal(weights.tensors[name], last.tensors[name]) for name in last.tensors)
    assert Path("runs/toy/best.ckpt").is_file()
    assert run_training("test", run, recipes) == 0
    assert "scored runs/toy/last.ckpt" in capsys.readouterr().out


def test_the_logger_gets_learning_rate_gradient_norm_and_time_of_steps(recipes):
    run = ["--config", "toy", "--trainer.log_every_n_steps", "2", "--data.validation=[]"]
    assert run_training("fit", run, recipes) == 0
    events = EventAccumulator("runs/toy").Reload()
    rates, norms, seconds = (
        events.Scalars(f"training/{name}")
        for name in ("learning_rate", "gradient_norm", "seconds_per_step")
    )
    assert len(rates) == len(norms) == len(seconds) == 4  # of 8 steps
    assert rates[0].value == pytest.approx(1e-3, rel=1)
    assert all(each.value > 0 for each in (*norms, *seconds))


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


def test_a_run_is_not_begun_over_another(recipes):
    run_training("fit", ["--config", "toy"], recipes)
    with pytest.raises(
        ValueError, match=r"holds a run already; resume .* --ckpt_path last, or .*folder"
    ):
        run_training("fit", ["--config", "toy"], recipes)


def test_a_training_that_diverges_says_so(recipes):
    rate = "--model.optimizer.learning_rate=1e30"
    with pytest.raises(ValueError, match=r"diverged, its loss is \w+ in step \d+; .* --run_folder"):
        run_training("fit", ["--config", "toy", rate], recipes)


class InvalidPredictions(toy.ToyModule):
    """Module that refuses its own predictions, as a detector with NaN boxes does."""

    def losses(self, batch):
        raise ValueError(f"boxes of {batch.sample_ids[0]} are nan")

    score = losses


def test_what_comes_of_weights_that_are_not_finite_is_told_as_such(frames):
    module = InvalidPredictions()
    batch = next(iter(toy.data(frames).train_dataloader()))
    for step in (module.training_step, module.validation_step, module.test_step):
        with pytest.raises(ValueError, match=r"^boxes of \d+ are nan"):
            step(batch, 0)
    torch.nn.init.constant_(next(module.parameters()), float("nan"))
    for step in (module.training_step, module.validation_step, module.test_step):
        with pytest.raises(ValueError, match="has diverged, its weights are not finite; restart"):
            step(batch, 0)


class RefusedTruth(toy.ToyModule):
    """Module whose scores refuse a truth, without a word on its frame."""

    def losses(self, batch):
        raise ValueError(f"a truth of {len(batch)} holds no depth at all")

    score = losses


def test_a_batch_that_is_refused_is_named(frames):
    module = RefusedTruth()
    batch = next(iter(toy.data(frames).train_dataloader()))
    expected = f"^samples {', '.join(batch.sample_ids)}: a truth of 2 holds no depth at all$"
    for step in (module.training_step, module.validation_step, module.test_step):
        with pytest.raises(ValueError, match=expected):
            step(batch, 0)


def test_a_refused_command_leaves_the_settings_of_the_run_as_they_are(recipes):
    run_training("fit", ["--config", "toy", "--model.network.channels", "3"], recipes)
    path = Path("runs/toy/config.yaml")
    before = path.read_bytes()
    other = ["--config", "toy", "--model.network.channels", "2", "--ckpt_path", "last"]
    with pytest.raises(ValueError, match="of other settings"):
        run_training("fit", other, recipes)
    assert path.read_bytes() == before


def test_a_checkpoint_that_is_scored_is_said_to_be_of_no_step(recipes, capsys):
    run_training("fit", ["--config", "toy"], recipes)
    capsys.readouterr()
    run_training("validate", ["--config", "toy", "--trainer.enable_progress_bar=true"], recipes)
    output = capsys.readouterr().err
    assert "validation/mse " in output
    assert "step" not in output


def test_the_scores_of_a_checkpoint_are_logged_at_its_step(recipes):
    run_training("fit", ["--config", "toy", "--run_folder", "first"], recipes)
    given = ["--config", "toy", "--ckpt_path", "first/last.ckpt", "--run_folder", "other"]
    run_training("validate", given, recipes)
    fitted = read_run_log(Path("first")).series["validation/mse"]
    scored = read_run_log(Path("other")).series["validation/mse"]
    assert scored.steps.tolist() == [8]
    assert fitted.steps.tolist() == [3, 7]  # Lightning counts these from 0
    assert scored.values[0] == pytest.approx(fitted.values[-1])
    assert "step" not in json.loads(Path("other/validate.json").read_text())["metrics"]


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("form", ["flag", "file"])
def test_sources_that_are_given_take_nothing_from_those_of_the_recipe(recipes, capsys, count, form):
    recipe = yaml.safe_load((recipes / "toy.yaml").read_text())
    recipe["data"]["init_args"]["training"] = [{"path": "a", "repeat": 3}, {"path": "b"}]
    (recipes / "toy.yaml").write_text(yaml.safe_dump(recipe))
    given = [{"path": "mine"}] * count
    Path("mine.yaml").write_text(yaml.safe_dump({"data": {"init_args": {"training": given}}}))
    arguments = {
        "flag": ["--data.init_args.training", json.dumps(given)],
        "file": ["--config", "mine.yaml"],
    }
    with pytest.raises(SystemExit):
        run_training("fit", ["--config", "toy", *arguments[form], "--print_config"], recipes)
    printed = yaml.safe_load(capsys.readouterr().out)["data"]["init_args"]["training"]
    assert [(source["path"], source["repeat"]) for source in printed] == [("mine", 1)] * count


@pytest.mark.parametrize(
    "named", [["--config", "toy"], ["--config=toy"], ["-c", "toy"], ["-c=toy"]]
)
@pytest.mark.parametrize("is_recipe_last", [False, True])
def test_the_resolved_settings_are_shown(recipes, capsys, named, is_recipe_last):
    settings = ["--data.batch_size", "3"]
    given = [*settings, *named] if is_recipe_last else [*named, *settings]
    with pytest.raises(SystemExit) as end:
        run_training("fit", [*given, "--print_config"], recipes)
    assert end.value.code in (None, 0)
    printed = yaml.safe_load(capsys.readouterr().out)
    assert printed["data"]["init_args"]["batch_size"] == 3
    assert printed["model"]["init_args"]["optimizer"]["schedule"] == "cosine"
    assert printed["trainer"]["use_distributed_sampler"] is False


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--config", "tony"], "there is no recipe tony; .*: toy"),
        (["--config", "toy", "--model.network.chanels", "3"], "chanels"),
        (["--config", "toy", "--model.network.channels", "many"], "many"),
        (["--config", "toy", "--model.optimizer.learning_rate", "-1"], "finite and positive"),
        (["--config", "toy", "--trainer.max_epoch", "3"], "max_epoch"),
        (["--config", "toy", "--data.batch_size", "0"], "at least 1, got 0: set --data.init_args"),
        (["--config", "toy", "--data.training", "[{path: ., repeat: 0}]"], "^repeat must be"),
        (["--config", "toy", "--trainer.max_epochs", "x"], "max_epochs.*number.*x; see sightline"),
        (["--config", "toy", "--data.batch_size", "x"],
         "^--data.batch_size: expected a whole number. Got value: x; see sightline fit"),
        (["--config", "toy", "--model.initial_weights", "nofile"], "^there are no weights 'no"),
        (["--config", "toy", "--data.root", "/gone"], "/gone: does not exist"),
        (["--config", "toy", "--checkpoint_every_n_steps", "0"], "must be at least 1, got 0"),
        (["--config", "toy", "--ckpt_path", "last"], "there is no checkpoint runs/toy/last.ckpt"),
        (["--config", "toy", "--ckpt_path", "toy.safetensors"],
         "^toy.safetensors cannot be read as safetensors"),
        (["--config", "toy", "--ckpt_path", "toy.ckpt"], "^toy.ckpt: is a pointer of Git LFS"),
        (["--config", "toy", "--trainer.max_epochs"], "--trainer.max_epochs: expected one arg"),
        (["--config", "toy", "--ckpt_path", "depth-best"],
         "^depth-best holds weights without the state of a training; .*initial_weights depth-best"),
        (["--config", "toy", "--model", "tests.training.toy.Nothing"], "Nothing"),
        (["--config", "toy", "--model.optimizer.learning_rate", "null"],
         "^model.init_args.optimizer.learning_rate must not be null; give it a value, or leave"),
        (["--config", "toy", "--model.init_args.optimizer=null"], "args.optimizer must not be nul"),
        (["--config", "toy", "--data.batch_size", "null"], "args.batch_size must not be null"),
        (["--config", "toy", "--data.validation", "null"], "args.validation must not be null"),
        (["--config", "toy", "--data.training", "[{path: ., repeat: null}]"],
         "args.training.repeat must not be null"),
        ([], "no recipe is given; name one with --config: .*: toy"),
        (["--config"], "^--config has no value; name .*: toy"),
    ],
)  # fmt: skip
def test_what_cannot_be_trained_is_refused_in_one_sentence(recipes, arguments, expected):
    Path("toy.safetensors").touch()
    Path("toy.ckpt").write_text("version https://git-lfs.github.com/spec/v1\n")
    with pytest.raises(ValueError, match=expected) as refused:
        run_training("fit", arguments, recipes)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 300, refused.value


@pytest.mark.parametrize("given", [["--run_folder", "runs/mine"], ["--run_folder=runs/mine"]])
def test_the_settings_of_a_run_are_pointed_at_where_no_recipe_is_named(recipes, given):
    Path("runs/mine").mkdir(parents=True)
    Path("runs/mine/config.yaml").write_text("")
    with pytest.raises(ValueError, match=r"add --config=runs/mine/config\.yaml"):
        run_training("validate", given, recipes)


@pytest.mark.parametrize(
    ("writer", "named"),
    [
        ("pathlib.Path.write_bytes", "runs/toy/last.ckpt"),
        ("tensorboard.summary.writer.record_writer.RecordWriter.write", "runs/toy"),
    ],
)
def test_a_full_disk_ends_a_run_in_one_sentence_that_names_the_place(
    recipes, capfd, monkeypatch, writer, named
):
    usual = Path.write_bytes

    def write(target, content):
        if isinstance(target, Path) and not target.name.endswith(".ckpt"):
            return usual(target, content)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(writer, write)
    with pytest.raises(ValueError, match=f"{named} cannot be written: no space left on dev"):
        run_training("fit", ["--config", "toy"], recipes)
    first, *others = capfd.readouterr().err.splitlines()
    assert first == "sightline fit: toy"
    assert all("are also training frames" in line for line in others)
    assert not list(Path("runs/toy").glob("*.ckpt"))


def test_scoring_a_folder_without_a_checkpoint_names_the_folders_option(recipes):
    said = r"no checkpoint runs/toy/last.ckpt; name the folder of a training with --run_folder, or"
    with pytest.raises(ValueError, match=said):
        run_training("test", ["--config", "toy"], recipes)


def test_checkpoints_take_no_room_in_the_folder_for_temporary_files(recipes, monkeypatch):
    def refuse(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "gettempdir", refuse)
    run_training("fit", ["--config", "toy"], recipes)
    assert {"best.ckpt", "last.ckpt"} <= {path.name for path in Path("runs/toy").iterdir()}


def test_nothing_is_said_that_the_user_cannot_act_on(recipes, capfd, recwarn):
    Path("most.txt").write_text("".join(f"{number:06}\n" for number in range(8)))
    Path("rest.txt").write_text("000008\n")
    sources = [
        f'--data.{use}=[{{"path": ".", "sample_list": "{name}.txt"}}]'
        for use, name in (("training", "most"), ("validation", "rest"))
    ]
    run_training("fit", ["--config", "toy", *sources], recipes)
    sys.stdout.flush()
    printed = capfd.readouterr()
    assert printed.err == "sightline fit: toy\n"
    (line,) = printed.out.splitlines()
    assert line.startswith("runs/toy: the weights are in weights.safetensors (step 8 of 8, the ")
    assert not [str(warning.message) for warning in recwarn]


def run_program(lines):
    imports = "import sys; from pathlib import Path; from sightline.training import command\n"
    program = [sys.executable, "-c", imports + lines]
    return subprocess.run(program, capture_output=True, text=True, check=False)


def test_help_lists_the_recipes_and_needs_no_pytorch(recipes):
    program = f"status = command.run_training('fit', ['--help'], Path({str(recipes)!r}))\n"
    program += "sys.exit(status or 'torch' in sys.modules)"
    (recipes / "toy.yaml").write_text("# A small one, for tests: of no use.\n")
    done = run_program(program)
    assert done.returncode == 0, done.stderr
    assert "toy  A small one, for tests\n" in done.stdout
    assert "--run_folder PATH" in done.stdout
    assert "--checkpoint_every_n_steps INT" in done.stdout


def test_a_misspelt_recipe_is_refused_without_pytorch(recipes):
    program = f"try: command.run_training('fit', ['--config', 'toi'], Path({str(recipes)!r}))\n"
    program += "except ValueError as error: sys.exit('torch' in sys.modules or print(error))"
    done = run_program(program)
    assert done.returncode == 0, done.stderr
    assert "there is no recipe toi" in done.stdout


def test_a_folder_in_lightning_s_option_is_refused(recipes, tmp_path):
    root = toy.write_frames(tmp_path / "frames")
    settings = [f"--data.root={root}", f"--trainer.default_root_dir={tmp_path / 'elsewhere'}"]
    with pytest.raises(ValueError, match=r"default_root_dir has no effect: .*; give --run_folder"):
        run_training("fit", ["--config", "toy", *settings], recipes)


def test_help_on_a_recipe_explains_its_settings(recipes, capsys):
    with pytest.raises(SystemExit):
        run_training("fit", ["--config", "toy", "--help"], recipes)
    assert "--trainer.max_epochs" in capsys.readouterr().out


@pytest.mark.parametrize("damaged", ["velodyne/000004.bin", "image_2/000004.png"])
@pytest.mark.parametrize("workers", [0, 2])
def test_a_file_that_cannot_be_read_ends_the_run_in_one_sentence(
    recipes, tmp_path, workers, damaged
):
    root = toy.write_frames(tmp_path / "frames")
    file = root / "training" / damaged
    file.write_bytes(file.read_bytes()[:-5])
    with pytest.raises(ValueError, match=f"^{file}: .*; .*again") as refused:
        run_training(
            "fit",
            ["--config", "toy", f"--data.root={root}", f"--data.workers={workers}"],
            recipes,
        )
    assert len(str(refused.value).splitlines()) == 1


def scalars(folder, name):
    """Steps and values of a curve in the event files of a folder."""
    found = {}
    for path in sorted(Path(folder).glob("events.*")):
        events = EventAccumulator(str(path)).Reload()
        if name in events.Tags()["scalars"]:
            found |= {event.step: event.value for event in events.Scalars(name)}
    return found


def test_a_short_run_leaves_a_curve_of_its_loss(recipes):
    run_training("fit", ["--config", "toy"], recipes)
    assert len(scalars("runs/toy", "training/mse")) == 8


def test_given_weights_are_scored_before_they_are_changed(recipes, capsys, monkeypatch):
    run_training("fit", ["--config", "toy", "--run_folder", "first"], recipes)
    weights = "--model.initial_weights=first/weights.safetensors"
    progress_bar = "--trainer.enable_progress_bar=true"
    capsys.readouterr()
    done, score = [], toy.ToyModule.score
    monkeypatch.setattr(toy.ToyModule, "load_start", lambda _: done.append("start"))
    monkeypatch.setattr(toy.ToyModule, "score", lambda *each: done.append("score") or score(*each))
    run_training("fit", ["--config", "toy", weights, progress_bar], recipes)
    assert done[:2] == ["start", "score"]
    best = read_weights("first/weights.safetensors").provenance["validation/mse"]
    assert f"step 0: validation/mse {best}\n" in capsys.readouterr().err
    curve = scalars("runs/toy", "validation/mse")
    assert curve[0] == pytest.approx(float(best), rel=1e-5)
    assert len(curve) == 3
    assert yaml.safe_load(Path("runs/toy/config.yaml").read_text())["trainer"]["max_epochs"] == 2


@pytest.mark.parametrize("folder", ["", "runs/toy", "training/image_2"])
@pytest.mark.parametrize("subcommand", ["fit", "test"])
def test_a_run_folder_in_a_data_set_is_refused_before_anything_is_made(
    recipes, tmp_path, subcommand, folder
):
    data = tmp_path / "set"
    (data / "training").mkdir(parents=True)
    run = ["--config", "toy", "--data.root", str(tmp_path), "--run_folder", str(data / folder)]
    sources = [f'--data.{use}=[{{"path": "set"}}]' for use in ("training", "validation")]
    with pytest.raises(ValueError, match=r"would change the data set .*set, which is an input"):
        run_training(subcommand, [*run, *sources], recipes)
    assert [path.name for path in data.rglob("*")] == ["training"]


def test_test_sources_at_the_root_do_not_forbid_a_training_beside_the_data(recipes, tmp_path):
    run = ["--config", "toy", "--data.root", str(tmp_path), "--run_folder", str(tmp_path / "run")]
    sources = ['--data.training=[{"path": "set"}]', "--data.validation=[]"]
    test = '--data.test=[{"path": "."}]'
    with pytest.raises(ValueError, match="set: does not exist"):  # the folder is allowed
        run_training("fit", [*run, *sources, test], recipes)
    with pytest.raises(ValueError, match="would change the data set"):
        run_training("test", [*run, *sources, test], recipes)


def test_a_run_folder_that_tensorboard_cannot_name_is_refused_and_made_by_a_relative_path(
    recipes, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr("sightline.cli.main.PACKAGE_RECIPES", recipes)
    place = Path(os.fsdecode(bytes(tmp_path / "d") + b"\xe9"))
    given = ["fit", "--config", "toy", "--data.validation=[]", "--run_folder"]
    assert main([*given, str(place / "run")]) == 2
    refusal = capsys.readouterr().err.splitlines()[-1]
    assert "the name is not UTF-8" in refusal
    assert "give a relative --run_folder" in refusal
    assert not place.exists()
    place.mkdir()
    monkeypatch.chdir(place)
    assert main([*given, "run"]) == 0
    assert (place / "run" / "weights.safetensors").is_file()


def test_a_run_folder_may_be_named_as_one_likes(recipes, capsys):
    run_training("fit", ["--config", "toy", "--run_folder", "run[/b]"], recipes)
    assert capsys.readouterr().out.startswith("run[/b]: the weights are in weights.safetensors ")


def test_progress_is_that_of_the_run_and_shows_in_a_file_too(recipes, capsys):
    run_training("fit", ["--config", "toy", "--trainer.enable_progress_bar=true"], recipes)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "sightline fit: toy"
    assert "training: 0 of 8" in lines
    assert [line.partition(" ")[0] for line in lines if "mse" in line] == ["step", "step"]


@pytest.mark.parametrize(
    ("given", "policy", "is_printed"),
    [
        ({}, "passive", True),
        ({"OMP_NUM_THREADS": "1"}, "passive", False),
        ({"OMP_WAIT_POLICY": "active"}, "active", False),
    ],
)
def test_threads_wait_passively_unless_told_otherwise_and_it_is_said(given, policy, is_printed):
    program = """
import os, sys, types
from pathlib import Path
training = types.ModuleType("training")
training.run_lightning = lambda *_: print(os.environ["OMP_WAIT_POLICY"], "torch" in sys.modules)
sys.modules["sightline.training.lightning_cli"] = training
from sightline.tasks import PACKAGE_RECIPES
from sightline.training.command import run_training
run_training("fit", ["--config", "depth-fast-cpu"], PACKAGE_RECIPES)
"""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("OMP_")}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=kept | given,
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert done.stdout.split() == [policy, "False"]
    assert ("OMP_WAIT_POLICY=active" in done.stderr) == is_printed
