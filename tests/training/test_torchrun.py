"""Training by torchrun, with the guide's script: ranks and machines that die change nothing."""

import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import torch
import yaml

from sightline.training.command import run_training
from sightline.training.run_log import read_run_log
from tests.training.conftest import RECIPE
from tests.training.deaths import ROLE

ROOT = Path(__file__).parents[2]
FIT = ROOT / "docs" / "guides" / "cluster" / "fit.sh"
LIMIT_S = 1500


@pytest.fixture
def recipe(tmp_path):
    """Recipe of nine frames: four steps of two ranks in each of two epochs."""
    settings = {**RECIPE, "trainer": {**RECIPE["trainer"], "callbacks": [deaths(tmp_path)]}}
    path = tmp_path / "toy.yaml"
    path.write_text(yaml.safe_dump(settings))
    return path


def deaths(folder):
    return {"class_path": "tests.training.deaths.Deaths", "init_args": {"folder": str(folder)}}


def start_agent(recipe, frames, run, options, *, nodes, role=""):
    """Start an agent of torchrun, whose ranks together are two."""
    settings = {
        "RECIPE": str(recipe),
        "DATA": str(frames),
        "RUN": str(run),
        "ACCELERATOR": "cpu",
        "NUM_NODES": str(nodes),
        "RANKS_PER_NODE": str(2 // nodes),
        "TORCH_DISABLE_SHARE_RDZV_TCP_STORE": "1",
        "OMP_NUM_THREADS": "1",
        "GLOO_SOCKET_IFNAME": "lo",
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "PYTHONPATH": f"{ROOT / 'src'}:{ROOT}",
        ROLE: role,
    }
    torchrun = [sys.executable, "-m", "torch.distributed.run", *options]
    torchrun += ["--nnodes", str(nodes), "--nproc-per-node", str(2 // nodes), "--no-python"]
    command = [*torchrun, "bash", FIT, "--data.init_args.batch_size", "1"]
    with (recipe.parent / "agents.log").open("a") as log:
        return subprocess.Popen(
            command, cwd=ROOT, env=os.environ | settings, stdout=log, stderr=subprocess.STDOUT
        )


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.mark.slow  # a minute of one core: eight ranks and four agents import PyTorch
def test_a_rank_and_then_a_machine_die_in_the_second_epoch_and_nothing_changes(
    recipe, frames, tmp_path
):
    whole, part, log = tmp_path / "whole", tmp_path / "part", tmp_path / "agents.log"
    alone = start_agent(recipe, frames, whole, ["--standalone"], nodes=1)
    assert alone.wait(LIMIT_S) == 0, log.read_text()

    endpoint = f"127.0.0.1:{free_port()}"
    meeting = ["--rdzv-backend", "c10d", "--rdzv-endpoint", endpoint, "--rdzv-id", "test"]
    meeting += ["--local-addr", "127.0.0.1", "--max-restarts", "3"]
    host, guest = ([*meeting, "--rdzv-conf", f"is_host={number}"] for number in (1, 0))
    agents = [start_agent(recipe, frames, part, host, nodes=2, role="rank-dies")]
    try:
        agents.append(start_agent(recipe, frames, part, guest, nodes=2, role="agent-dies"))
        assert agents[1].wait(LIMIT_S) == -signal.SIGKILL, log.read_text()
        assert (tmp_path / "rank-died").exists()
        agents.append(start_agent(recipe, frames, part, guest, nodes=2))
        assert agents[0].wait(LIMIT_S) == 0, log.read_text()
        assert agents[2].wait(LIMIT_S) == 0, log.read_text()
    finally:
        for agent in agents:
            agent.terminate()
            agent.wait(60)

    assert_same(part, whole)


def as_by_torchrun(monkeypatch, ranks, of_machine):
    numbers = {"WORLD_SIZE": ranks, "LOCAL_WORLD_SIZE": of_machine, "RANK": 0, "LOCAL_RANK": 0}
    for name, number in numbers.items():
        monkeypatch.setenv(name, str(number))
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "none")


@pytest.mark.parametrize(
    ("ranks", "of_machine", "remedy"),
    [
        (2, 2, "--trainer.devices 2 --trainer.strategy ddp"),
        (8, 4, "--trainer.devices 4 --trainer.strategy ddp --trainer.num_nodes 2"),
    ],
)
@pytest.mark.parametrize("subcommand", ["fit", "validate"])
def test_ranks_that_would_not_work_together_are_refused(
    recipes, monkeypatch, subcommand, ranks, of_machine, remedy
):
    if subcommand == "validate":
        run_training("fit", ["--config", "toy"], recipes)
    as_by_torchrun(monkeypatch, ranks, of_machine)
    told = f"torchrun started {ranks} ranks, but the trainer has 1: add {remedy}, or start one"
    with pytest.raises(ValueError, match=re.escape(told)):
        run_training(subcommand, ["--config", "toy"], recipes)


def test_one_rank_or_a_number_left_by_another_program_trains_as_ever(recipes, monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "2")
    assert run_training("fit", ["--config", "toy", "--run_folder", "left"], recipes) == 0
    as_by_torchrun(monkeypatch, 1, 1)
    assert run_training("fit", ["--config", "toy", "--run_folder", "one"], recipes) == 0


def assert_same(part, whole):
    """Check that metrics of all epochs and the weights at the end are equal."""
    logs = [curves(run) for run in (part, whole)]
    assert {"validation/mse", "training/total"} <= logs[1].keys()
    assert logs[0] == logs[1]
    weights = [
        torch.load(run / "last.ckpt", weights_only=True)["state_dict"] for run in (part, whole)
    ]
    assert weights[0].keys() == weights[1].keys()
    for name, tensor in weights[1].items():
        assert torch.equal(weights[0][name], tensor), name
    assert (part / "weights.safetensors").is_file()


def curves(run):
    """Steps and values of all that was logged, but the time of steps."""
    series = read_run_log(run).series.items()
    return {
        name: (each.steps.tolist(), each.values.tolist())
        for name, each in series
        if name != "training/seconds_per_step"
    }
