"""`sightline validate` and `sightline test`: scored weights and report."""

import json
import shutil
from itertools import count
from pathlib import Path

import pytest
import torch

from sightline.files.weights import read_checkpoint_weights, read_weights
from sightline.training.command import run_training
from tests.training import toy


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


@pytest.mark.parametrize("subcommand", ["validate", "test"])
def test_what_predictors_do_otherwise_is_told_after_the_scores(
    recipes, subcommand, capsys, monkeypatch
):
    run_training("fit", ["--config", "toy"], recipes)
    advice = "for figures of use: sightline predict, then sightline evaluate"
    run_training(subcommand, ["--config", "toy"], recipes)
    assert advice not in capsys.readouterr().out
    monkeypatch.setattr(toy.ToyModule, "difference_in_use", lambda _: "only a half is scored")
    run_training(subcommand, ["--config", "toy"], recipes)
    assert f"only a half is scored; {advice}\n" in capsys.readouterr().out


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


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("training=[]", "there are no sources of training samples"),
        ("batch_size=10", "an epoch of 9 samples does not fill a batch of 10; set a smaller"),
        ("samples_per_epoch=10", "only 9 training samples"),
    ],
)
def test_faulty_training_sources_are_told_before_the_first_weights_are_scored(
    recipes, capsys, change, told
):
    run_training("fit", ["--config", "toy", "--run_folder", "first"], recipes)
    capsys.readouterr()
    config = ["--config", "toy", "--model.initial_weights", "first/weights.safetensors"]
    progress = ["--trainer.enable_progress_bar", "true"]
    with pytest.raises(ValueError, match=told):
        run_training("fit", [*config, f"--data.init_args.{change}", *progress], recipes)
    printed = capsys.readouterr()
    assert "validation" not in printed.out + printed.err


def test_a_device_that_is_not_there_is_named_by_its_option(recipes):
    if torch.cuda.is_available():
        pytest.skip("this machine has one")
    with pytest.raises(ValueError, match=r"^--trainer\.accelerator names a device .* give cpu$"):
        run_training("fit", ["--config", "toy", "--trainer.accelerator", "gpu"], recipes)


@pytest.mark.parametrize("remaining", ["best", "last"])
def test_a_run_that_started_from_weights_is_scored_itself_even_when_they_are_gone(
    recipes, capsys, remaining
):
    run_training("fit", ["--config", "toy", "--run_folder", "first"], recipes)
    config = ["--config", "toy", "--model.initial_weights", "first/weights.safetensors"]
    run_training("fit", config, recipes)
    if remaining == "last":
        Path("runs/toy/best.ckpt").unlink()
    Path("first/weights.safetensors").unlink()
    capsys.readouterr()
    run_training("test", config, recipes)
    run_training(
        "test",
        ["--config=toy", "--run_folder=other", f"--ckpt_path=runs/toy/{remaining}.ckpt"],
        recipes,
    )
    reports = [json.loads(Path(run, "test.json").read_text()) for run in ("runs/toy", "other")]
    assert reports[0].pop("initial_weights") == "first/weights.safetensors"
    assert reports[1].pop("initial_weights") is None
    assert reports[0] == reports[1]
    assert reports[0]["checkpoint"] == f"runs/toy/{remaining}.ckpt"
    output = capsys.readouterr().out
    assert (
        f"scored runs/toy/{remaining}.ckpt, which started from first/weights.safetensors" in output
    )


def test_scores_that_are_no_numbers_are_null_in_the_report(recipes, monkeypatch):
    run_training("fit", ["--config", "toy"], recipes)
    monkeypatch.setattr(toy.ToyScores, "compute", lambda _: {"mse": torch.tensor(float("nan"))})
    run_training("test", ["--config", "toy"], recipes)
    assert json.loads(Path("runs/toy/test.json").read_text())["metrics"] == {"test/mse": None}


def test_testing_without_any_weights_is_refused(recipes):
    with pytest.raises(ValueError, match=r"there is no checkpoint runs/toy/last\.ckpt"):
        run_training("test", ["--config", "toy"], recipes)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("runs/toy", r"runs/toy is the folder of a run; give runs/toy/last\.ckpt"),
        ("runs/toy/weights.safetensors", "weights.safetensors holds weights without the state of"),
    ],
)
def test_a_run_given_as_its_checkpoint_is_told_its_file(recipes, given, told):
    run_training("fit", ["--config", "toy"], recipes)
    with pytest.raises(ValueError, match=told):
        run_training("validate", ["--config", "toy", "--ckpt_path", given], recipes)


def scored_after_training(recipes, capsys, trained, scored, *changes):
    """Lines on stderr of a test, after a training."""
    Path("six.txt").write_text("".join(f"{number:06}\n" for number in range(6)))
    Path("rest.txt").write_text("".join(f"{number:06}\n" for number in range(5, 9)))
    config = ["--config", "toy", f"--data.training={trained}", "--data.validation=[]"]
    run_training("fit", config, recipes)
    capsys.readouterr()
    config = ["--config", "runs/toy/config.yaml", "--run_folder", "runs/toy", *changes]
    assert run_training("test", [*config, f"--data.test={scored}"], recipes) == 0
    return [line for line in capsys.readouterr().err.splitlines() if "training" in line]


SIX = "{path: ., sample_list: six.txt}"
REST = "[{path: ., sample_list: rest.txt}]"


@pytest.mark.parametrize(
    ("scored", "expected"), [(REST, "1 of 4 test"), ("[{path: training}]", "6 of 9 test")]
)
def test_scored_frames_that_the_checkpoint_was_trained_on_are_counted(
    recipes, capsys, scored, expected
):
    (line,) = scored_after_training(recipes, capsys, f"[{SIX}]", scored)
    assert line.startswith(f"{expected} frames of")
    assert "are also training frames (00000" in line


def test_scoring_does_not_need_the_training_sources(recipes, capsys, frames):
    there = Path(shutil.copytree(frames, "there"))
    trained = f"[{SIX}, {{path: {there.resolve()}}}]"
    shown = scored_after_training(recipes, capsys, trained, REST)
    shutil.rmtree(there)
    config = ["--config", "runs/toy/config.yaml", "--run_folder", "runs/toy"]
    assert run_training("test", [*config, f"--data.test={REST}"], recipes) == 0
    again = [line for line in capsys.readouterr().err.splitlines() if "training" in line]
    assert len(shown) == 1
    assert again == shown


def reordered_sources(frames):
    """Training sources of two folders with different frames, in two orders."""
    there = Path(shutil.copytree(frames, "there")).resolve()
    Path("three.txt").write_text("000006\n000007\n000008\n")
    sources = [SIX, f"{{path: {there}, sample_list: three.txt}}"]
    return (f"[{', '.join(each)}]" for each in (sources, sources[::-1]))


@pytest.mark.parametrize("is_older", [False, True])
def test_training_sources_in_another_order_are_those_of_the_checkpoint(
    recipes, capsys, frames, is_older
):
    in_order, reversed_order = reordered_sources(frames)
    shown = scored_after_training(recipes, capsys, in_order, REST)
    if is_older:  # its checkpoints know one order alone
        for path in Path("runs/toy").glob("*.ckpt"):
            checkpoint = torch.load(path, weights_only=True)
            del checkpoint["CameraLidarData"]["training_frames_in_any_order"]
            torch.save(checkpoint, path)
    config = ["--config", "runs/toy/config.yaml", "--run_folder", "runs/toy"]
    lines = []
    for training in (in_order, reversed_order):
        changes = [f"--data.training={training}", f"--data.test={REST}"]
        run_training("test", [*config, *changes], recipes)
        run_training("fit", [*config, *changes, "--ckpt_path=last"], recipes)
        printed = capsys.readouterr().err.splitlines()
        lines.append([line for line in printed if "training frames" in line])
    assert shown[0].startswith("1 of 4 test frames of")
    assert lines[0] == shown
    if is_older:
        assert "are not the 9" in lines[1][0]
        assert "now has 9 others" in lines[1][1]
    else:
        assert lines[1] == shown


def test_other_data_at_the_place_of_the_training_data_are_not_taken_for_them(
    recipes, capsys, tmp_path
):
    elsewhere = toy.write_frames(tmp_path / "elsewhere", count=4)
    changes = ["--data.root", str(elsewhere)]
    (line,) = scored_after_training(recipes, capsys, "[{path: .}]", "[{path: .}]", *changes)
    assert line.startswith("the checkpoint's 9 training frames are not the 4 of these settings, so")


@pytest.mark.parametrize("others", [REST, f"[{REST[1:-1]}, {{path: absent}}, {SIX}]"])
def test_training_frames_of_other_settings_are_not_taken_for_the_checkpoints(
    recipes, capsys, others
):
    changes = [f"--data.training={others}"]
    (line,) = scored_after_training(recipes, capsys, f"[{SIX}]", REST, *changes)
    assert "the checkpoint's 6 training frames are not the" in line


@pytest.mark.parametrize("use", ["validation", "test"])
@pytest.mark.parametrize("trained", ["validated", "alone"])
def test_frames_that_only_one_of_run_and_scoring_holds_out_are_still_compared(
    recipes, capsys, use, trained
):
    train, val = (f"[{{path: ., sample_list: {name}}}]" for name in ("train", "val"))
    everything = "[{path: .}]"
    validated, scored = (val, everything) if trained == "validated" else ("[]", val)
    sources = [f"--data.training={train}", f"--data.validation={validated}", "--data.test=[]"]
    run_training("fit", ["--config", "toy", *sources], recipes)
    capsys.readouterr()
    config = ["--config", "runs/toy/config.yaml", "--run_folder", "runs/toy"]
    if trained == "validated":
        config.append(f"--data.validation={everything}")
    subcommand = {"validation": "validate", "test": "test"}[use]
    run_training(subcommand, [*config, f"--data.{use}={scored}"], recipes)
    (line,) = [each for each in capsys.readouterr().err.splitlines() if "training" in each]
    counts = "8 of 9" if trained == "validated" else "1 of 1"
    assert line.startswith(f"{counts} {use} frames of")


def test_other_data_with_the_checkpoints_names_are_told_as_compared_by_name(
    recipes, capsys, tmp_path
):
    elsewhere = toy.write_frames(tmp_path / "elsewhere")
    changes = ["--data.root", str(elsewhere)]
    (line,) = scored_after_training(recipes, capsys, "[{path: .}]", "[{path: .}]", *changes)
    assert line.startswith("9 of 9 test frames of")
    assert "compared by name), so scores are too good unless the run was trained on another" in line


def test_frames_that_a_limit_leaves_out_are_told_with_their_sources(recipes, capsys):
    Path("few.txt").write_text("000000\n000001\n000002\n")
    sources = '[{"path": ".", "sample_list": "few.txt"}, {"path": "training"}]'
    given = ["--config", "toy", "--data.validation", sources]
    limit = ["--trainer.limit_val_batches", "3"]
    note = (
        "3 of the 12 validation frames are scored, the first ones, none of training "
        "(--trainer.limit_val_batches, which a recipe may set; --trainer.limit_val_batches 1.0 "
        "scores all)"
    )
    run_training("fit", [*given, *limit], recipes)
    assert capsys.readouterr().err.count(note) == 1
    run_training("validate", [*given, *limit], recipes)
    assert note in capsys.readouterr().err
    assert json.loads(Path("runs/toy/validate.json").read_text())["notes"] == [note]
    run_training("validate", [*given, "--trainer.limit_val_batches", "0.5"], recipes)
    assert "6 of the 12 validation frames are scored, the first ones (" in capsys.readouterr().err
    run_training("fit", [*given, "--trainer.fast_dev_run", "1", "--run_folder", "trial"], recipes)
    assert "are scored" not in capsys.readouterr().err
    run_training("validate", [*given, "--trainer.limit_val_batches", "1.0"], recipes)
    assert "are scored" not in capsys.readouterr().err
    assert json.loads(Path("runs/toy/validate.json").read_text())["notes"] == []


def test_of_equal_scores_the_last_one_keeps_its_weights(recipes, capsys, monkeypatch):
    """A score that stays 0, as no label counts, must not keep the weights of the first epoch."""
    monkeypatch.setattr(toy.ToyScores, "compute", lambda _: {"mse": torch.tensor(0.0)})
    run_training("fit", ["--config", "toy"], recipes)
    last = "weights.safetensors (step 8 of 8, the best by validation/mse: 0)"
    assert last in capsys.readouterr().out
    written = read_weights(Path("runs/toy/weights.safetensors"))
    ended = read_checkpoint_weights(Path("runs/toy/last.ckpt"))
    assert written.provenance["steps"] == "8"
    assert all(torch.equal(each, ended.tensors[name]) for name, each in written.tensors.items())


def test_of_different_scores_the_best_one_keeps_its_weights(recipes, capsys, monkeypatch):
    scores = count(1)
    monkeypatch.setattr(
        toy.ToyScores, "compute", lambda _: {"mse": torch.tensor(float(next(scores)))}
    )
    run_training("fit", ["--config", "toy"], recipes)
    assert "(step 4 of 8, the best by" in capsys.readouterr().out
    assert read_weights(Path("runs/toy/weights.safetensors")).provenance["steps"] == "4"
