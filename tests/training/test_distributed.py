"""Training on two processes equals training on one."""

import os
import subprocess
import sys

import pytest
import torch

from tests.training import two_ranks


def reports(folder, ranks):
    return [torch.load(folder / f"rank{rank}.pt", weights_only=True) for rank in range(ranks)]


@pytest.fixture(scope="module")
def runs(frames, tmp_path_factory):
    """Folder with a training on two ranks, one resumed from shards, one on one rank, scores."""
    folder = tmp_path_factory.mktemp("runs")
    command = [sys.executable, "-m", "tests.training.two_ranks", str(frames), str(folder)]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    two_ranks.train(frames, folder / "single", batch_size=4)
    two_ranks.score(frames, folder / "scores", batch_size=1)
    return folder


def test_the_ranks_see_different_samples_that_together_are_the_epoch(runs):
    first, second = (report["seen"] for report in reports(runs / "whole", 2))
    (single,) = (report["seen"] for report in reports(runs / "single", 1))
    assert len(first) == len(second) == len(single) == 4
    for here, there, both in zip(first, second, single, strict=True):
        assert not set(here) & set(there)
        assert sorted((*here, *there)) == sorted(both)


def test_the_ranks_end_with_the_weights_of_one_device(runs):
    first, second = (report["state"] for report in reports(runs / "whole", 2))
    (single,) = (report["state"] for report in reports(runs / "single", 1))
    for name, tensor in single.items():
        assert torch.equal(first[name], second[name]), name
        torch.testing.assert_close(first[name], tensor, rtol=1e-4, atol=1e-5)


def test_resuming_on_two_ranks_from_shards_is_exact(runs):
    for resumed, whole in zip(
        reports(runs / "resumed", 2), reports(runs / "whole", 2), strict=True
    ):
        assert resumed["seen"] == whole["seen"][two_ranks.STOPPED_AFTER :]
        for name, tensor in whole["state"].items():
            assert torch.equal(resumed["state"][name], tensor), name


@pytest.mark.parametrize("batch_size", [1, 2])
def test_two_ranks_score_an_odd_number_of_frames_as_one_does(runs, batch_size):
    (single,) = reports(runs / "scores", 1)
    assert len(single) == 1 + 3 * 3 * 3 * 3  # over 40, 11 and all recall positions
    assert sum(score > 0 for score in single.values()) > 10
    for rank in reports(runs / f"scores{batch_size}", 2):
        assert rank.keys() == single.keys()
        # The network's output differs in its last digits between batch sizes.
        assert rank.pop("mse").item() == pytest.approx(single["mse"].item(), rel=1e-6)
        for name, ap in rank.items():
            assert ap.item() == pytest.approx(single[name].item(), abs=1e-9, rel=0), name


def test_the_checkpoint_keeps_the_random_states_of_both(runs):
    checkpoint = torch.load(runs / "whole" / "last.ckpt", weights_only=True)
    assert len(checkpoint["sightline_random_states"]) == 2
