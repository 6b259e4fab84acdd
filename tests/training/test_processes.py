"""Trainings as processes: two in one folder, signals of a batch system, workers that live on."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from lightning.pytorch.callbacks import Callback

from sightline.files.weights import read_weights
from sightline.training.command import run_training

ROOT = Path(__file__).parents[2]
PATIENCE_S = 120


class Wait(Callback):
    """Callback that writes a file in the third step and waits."""

    def on_train_batch_start(self, trainer, *_):
        if trainer.global_step == 2:
            Path("waiting").touch()
            while not Path("go").exists():
                time.sleep(0.01)


@pytest.fixture
def waiting(recipes):
    """Training in its own session, with workers, that waits in its third step."""
    command = [sys.executable, "-m", "sightline", "fit", "--config", str(recipes / "toy.yaml"),
               "--data.workers=2",
               "--trainer.callbacks+=tests.training.test_processes.Wait"]  # fmt: skip
    environment = os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'src'}", "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        command, env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    ends_s = time.monotonic() + PATIENCE_S
    while not Path("waiting").exists():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < ends_s
        time.sleep(0.05)
    yield process
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    process.stderr.close()


def test_a_second_training_in_a_folder_is_refused_until_the_first_is_dead(recipes, waiting):
    with pytest.raises(
        ValueError, match=rf"\(process {waiting.pid}\) is running in runs/toy; wait"
    ):
        run_training("fit", ["--config", "toy"], recipes)
    run_training("fit", ["--config", "toy", "--run_folder", "other"], recipes)
    waiting.kill()  # its workers live on for a moment
    waiting.wait()
    assert run_training("fit", ["--config", "toy"], recipes) == 0


def test_sigterm_during_the_imports_of_a_training_ends_it_in_one_line(recipes):
    program = """
import os, signal, sys
from sightline import __main__

class Finder:
    def find_spec(self, name, *_):
        if name == "lightning":
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGTERM)

sys.meta_path.insert(0, Finder())
sys.exit(__main__.run())
"""
    command = [sys.executable, "-c", program, "fit", "--config", str(recipes / "toy.yaml")]
    environment = os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'src'}", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 128 + signal.SIGTERM
    first_line, last_line = done.stderr.splitlines()
    assert first_line == "sightline fit: toy"
    assert last_line.startswith("sightline: interrupted; ")
    assert "run the same command again" in last_line
    assert not Path("runs/toy/last.ckpt").exists()


@pytest.mark.parametrize("to_all", [False, True], ids=["", "its-workers-too"])
def test_sigterm_ends_a_training_with_a_checkpoint_and_it_can_go_on(recipes, waiting, to_all):
    (os.killpg if to_all else os.kill)(waiting.pid, signal.SIGTERM)
    Path("go").touch()
    _, output = waiting.communicate(timeout=PATIENCE_S)
    assert waiting.returncode == 128 + signal.SIGTERM
    first, overlap, last = output.splitlines()
    assert first == "sightline fit: toy"
    assert "are also training frames" in overlap
    assert last == "sightline: interrupted; add --ckpt_path last to the same command to resume"
    assert read_weights("runs/toy/last.ckpt").provenance["steps"] == "3"
    run_training("fit", ["--config", "toy", "--ckpt_path", "last"], recipes)
    run_training("fit", ["--config", "toy", "--run_folder", "whole"], recipes)
    parts, whole = (read_weights(f"{folder}/last.ckpt").tensors for folder in ("runs/toy", "whole"))
    assert all(torch.equal(parts[name], whole[name]) for name in whole)
