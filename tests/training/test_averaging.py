import pytest
import torch

from sightline.cli.main import main
from sightline.files.weights import read_weights, write_weights
from sightline.training.averaging import average_weights


def write(path, tensors, *, task="depth-completion", **provenance):
    config = {"flip_test": path.stem == "first"}  # of postprocessing, so that it may differ
    write_weights(path, tensors, task=task, config=config, provenance=provenance)
    return path


@pytest.fixture
def pair(tmp_path):
    first = {"a": torch.tensor([1.0, -2.0]).half(), "steps": torch.tensor(3)}
    second = {"a": torch.tensor([3.0, 2.0]), "steps": torch.tensor(7), "head": torch.ones(1)}
    return (
        write(tmp_path / "first.safetensors", first, seed="1"),
        write(tmp_path / "second.safetensors", second, seed="2"),
    )


@pytest.mark.parametrize(
    ("share", "expected"), [(0.0, [1, -2]), (0.25, [1.5, -1]), (0.5, [2, 0]), (1.0, [3, 2])]
)
def test_the_average_lies_between_both_by_its_share(tmp_path, pair, share, expected):
    left_out = average_weights(*pair, tmp_path / "mean.safetensors", share=share)
    assert left_out == ("head",)
    found = read_weights(tmp_path / "mean.safetensors")
    assert sorted(found.tensors) == ["a", "steps"]  # without the head of the training
    assert found.tensors["a"].dtype == torch.float32
    assert found.tensors["a"].tolist() == expected
    assert found.tensors["steps"].tolist() == 7
    assert (found.task, found.config) == ("depth-completion", {"flip_test": True})
    assert found.provenance["seed"] == "2"
    assert f"{share:g} of second (" in found.provenance["average"]


def test_the_command_stores_half_precision_and_never_over_its_inputs(tmp_path, pair, capsys):
    out = tmp_path / "mean.safetensors"
    assert main(["average", *map(str, pair), str(out), "--half"]) == 0
    assert read_weights(out).tensors["a"].dtype == torch.float16
    assert "left out" in capsys.readouterr().err
    before = pair[0].read_bytes()
    assert main(["average", *map(str, pair), str(pair[0])]) == 2
    assert pair[0].read_bytes() == before
    assert str(pair[0]) in capsys.readouterr().err


@pytest.mark.parametrize(
    ("tensors", "task", "named"),
    [
        ({"a": torch.zeros(3), "steps": torch.tensor(0)}, "depth-completion", r"a is \[2\] in"),
        ({"a": torch.zeros(2)}, "depth-completion", r"steps is \[\] of .* and missing in"),
        ({"a": torch.zeros(2), "steps": torch.tensor(0)}, "detection2d", "of task depth-compl"),
    ],
)
def test_networks_of_other_designs_are_refused(tmp_path, pair, tensors, task, named):
    other = write(tmp_path / "other.safetensors", tensors, task=task)
    with pytest.raises(ValueError, match=named):
        average_weights(pair[0], other, tmp_path / "mean.safetensors")
    assert not (tmp_path / "mean.safetensors").exists()


@pytest.mark.parametrize("order", [1, -1])
def test_networks_of_other_settings_are_refused_though_their_shapes_are_equal(
    tmp_path, pair, capsys, order
):
    other = tmp_path / "other.safetensors"
    tensors = read_weights(pair[0]).tensors
    config = {"depth_scale_m": 50.0}
    write_weights(other, tensors, task="depth-completion", config=config, provenance={})
    out = tmp_path / "mean.safetensors"
    assert main(["average", *map(str, (pair[0], other)[::order]), str(out)]) == 2
    told = capsys.readouterr().err
    assert "other.safetensors" in told
    assert "of other settings than" in told
    assert "depth_scale_m" in told
    assert not out.exists()


@pytest.mark.parametrize("share", [-0.1, 1.5, float("nan")])
def test_shares_beyond_0_and_1_are_refused(tmp_path, pair, share):
    with pytest.raises(ValueError, match="share must be between 0 and 1"):
        average_weights(*pair, tmp_path / "mean.safetensors", share=share)


def test_a_file_that_no_command_would_take_for_weights_is_not_written(tmp_path, pair):
    with pytest.raises(ValueError, match=r"mean\.onnx: weights are written to a file \."):
        average_weights(*pair, tmp_path / "mean.onnx")
    assert not (tmp_path / "mean.onnx").exists()


def test_whole_numbers_and_weights_have_no_mean(tmp_path, pair):
    other = write(
        tmp_path / "whole.safetensors", {"a": torch.tensor([1, 2]), "steps": torch.ones(())}
    )
    with pytest.raises(ValueError, match=r"a is \[2\] in .* and \[2\] of whole numbers in"):
        average_weights(pair[0], other, tmp_path / "mean.safetensors")


def test_weights_beyond_single_precision_are_called_so(tmp_path, pair):
    large = {"a": torch.tensor([1e300, 0.0], dtype=torch.float64), "steps": torch.tensor(0)}
    other = write(tmp_path / "large.safetensors", large)
    with pytest.raises(ValueError, match="a is too large for single precision; name others"):
        average_weights(pair[0], other, tmp_path / "mean.safetensors")


def test_weights_beyond_half_precision_are_refused(tmp_path, pair):
    large = {"a": torch.tensor([1e6, 0.0]), "steps": torch.tensor(0)}
    other = write(tmp_path / "large.safetensors", large)
    with pytest.raises(ValueError, match="a is too large for half precision"):
        average_weights(pair[0], other, tmp_path / "mean.safetensors", half=True)
    assert not (tmp_path / "mean.safetensors").exists()
