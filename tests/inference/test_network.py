from dataclasses import asdict
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.depth_completion.export_graph import example_inputs
from sightline.depth_completion.registration import TASK
from sightline.files import weights_header
from sightline.files.weights import (
    CHECKPOINT_KEY,
    NETWORK_PREFIX,
    read_weights,
    write_weights,
)
from sightline.files.weights_header import shipped_names
from sightline.inference.network import load_network
from tests.depth_completion.networks import tiny_config, write_tiny_weights


def test_a_file_gives_back_the_network_that_was_written(tmp_path):
    settings = {"shift_conv": None, "uncertainty": True, "filled_input": True, "residual": True}
    path = write_tiny_weights(tmp_path / "mine.safetensors", **settings)
    loaded = load_network(TASK, path)
    assert (loaded.name, loaded.path) == ("mine", path)
    assert loaded.network.config == tiny_config(**settings)
    written = read_weights(path).tensors
    read = loaded.network.state_dict()
    assert read.keys() == written.keys()
    assert all(torch.equal(read[name], written[name]) for name in written)


def test_a_loaded_network_is_for_inference(tmp_path):
    network = load_network(TASK, write_tiny_weights(tmp_path / "mine.safetensors")).network
    assert not network.training
    assert not any(parameter.requires_grad for parameter in network.parameters())


def test_a_checkpoint_of_a_training_gives_the_same_network(tmp_path):
    weights = read_weights(write_tiny_weights(tmp_path / "mine.safetensors"))
    description = {"task": weights.task, "config": weights.config, "provenance": {}}
    state = {f"{NETWORK_PREFIX}{name}": tensor for name, tensor in weights.tensors.items()}
    path = tmp_path / "last.ckpt"
    torch.save({CHECKPOINT_KEY: description, "state_dict": state}, path)
    loaded = load_network(TASK, path)
    assert loaded.name == "last"
    name, tensor = next(iter(weights.tensors.items()))
    assert torch.equal(loaded.network.state_dict()[name], tensor)


def test_weights_that_come_with_the_package_go_by_their_name(tmp_path, monkeypatch):
    monkeypatch.setattr(weights_header, "WEIGHTS_FOLDER", tmp_path)
    write_tiny_weights(tmp_path / "depth-tiny.safetensors")
    assert shipped_names() == ("depth-tiny",)
    assert load_network(TASK, "depth-tiny").path == tmp_path / "depth-tiny.safetensors"
    assert read_weights(Path("depth-tiny")).task == "depth-completion"  # a training may start there
    with pytest.raises(ValueError, match=r"no weights 'depth-huge'; .* \(depth-tiny\)"):
        load_network(TASK, "depth-huge")


def test_the_hash_distinguishes_files(tmp_path):
    one, same, other = (
        load_network(TASK, write_tiny_weights(tmp_path / f"{name}.safetensors", seed=seed)).sha256
        for name, seed in (("one", 0), ("same", 0), ("other", 1))
    )
    assert one == same != other


def test_an_exported_file_names_its_weights(tmp_path):
    loaded = load_network(TASK, write_tiny_weights(tmp_path / "mine.safetensors"))
    (graph,) = TASK.graphs(loaded)
    assert graph.metadata.task == "depth-completion"
    assert graph.metadata.stride == loaded.network.stride == 2
    assert graph.metadata.provenance == {
        "sightline": "0.0.1",
        "weights": "mine",
        "sha256": loaded.sha256,
    }


@pytest.mark.parametrize("filled_input", [False, True])
def test_example_inputs_fit_the_network(tmp_path, filled_input):
    path = write_tiny_weights(tmp_path / "mine.safetensors", filled_input=filled_input)
    loaded = load_network(TASK, path)
    inputs = example_inputs(loaded.network)
    assert ("filled_depth_m" in inputs) == filled_input
    assert loaded.network(**inputs).depth_m.shape == inputs["sparse_depth_m"].shape


def write_odd(path, *, task="depth-completion", changes=None, drop=()):
    """Write weights of a tiny network with a changed description or without some tensors."""
    good = read_weights(write_tiny_weights(path))
    tensors = {name: tensor for name, tensor in good.tensors.items() if name not in drop}
    config = {**asdict(tiny_config()), **(changes or {})}
    write_weights(path, tensors, task=task, config=config, provenance={"sightline": "9.9"})
    return path


@pytest.mark.parametrize(
    ("odd", "message"),
    [
        ({"task": "detection2d"}, "holds weights for detection2d, expected depth-completion"),
        ({"changes": {"wormholes": 3}}, "made by sightline 9.9.*wormholes"),
        ({"changes": {"stem_channels": 0}}, "stem_channels must be at least 1, got 0"),
        ({"changes": {"stem_channels": 8}}, "does not fit this version's network"),
        (
            {"drop": ["trunk.head.weight"]},
            "does not fit .* the tensor trunk.head.weight is missing",
        ),
        ({"changes": {"stem_channels": 10**12}}, "does not fit this version's network"),
        ({"changes": {"stem_channels": 10**6}}, "a network far larger than its weights"),
        ({"changes": {"trunk": {"channels": [4, 8], "modules": 10**9}}}, "far larger than its we"),
        ({"changes": {"shift_conv": {"channels": 9, "layers": 10**9}}}, "far larger than its w"),
        ({"changes": {"shift_conv": {"shifts_px": [10**9]}}}, "shifts_px must be at most 1024"),
        (
            {"changes": {"trunk": {"channels": [1] * 40}}},
            "trunk.channels must be at most 8, got 40",
        ),
        ({"changes": {"propagation_steps": 10**9}}, "propagation_steps must be at most 64"),
        ({"changes": {"w" * 9999: 1}}, "does not fit this version's network"),
    ],
)
def test_weights_of_an_invalid_network_are_refused_in_one_line(tmp_path, odd, message):
    path = write_odd(tmp_path / "odd.safetensors", **odd)
    with pytest.raises(ValueError, match=message) as raised:
        load_network(TASK, path)
    assert "\n" not in str(raised.value)
    assert "odd.safetensors" in str(raised.value)
    assert len(str(raised.value).replace(str(tmp_path), "")) < 500


def test_a_file_that_is_no_weights_is_refused(tmp_path):
    path = tmp_path / "notes.safetensors"
    path.write_text("not weights")
    with pytest.raises(ValueError, match=r"notes\.safetensors cannot be read"):
        load_network(TASK, path)


@pytest.fixture(scope="module")
def whole_file(tmp_path_factory) -> bytes:
    return write_tiny_weights(tmp_path_factory.mktemp("whole") / "whole.safetensors").read_bytes()


byte = st.integers(0, 255) | st.sampled_from(b'0189-.e"{}[],:')  # characters of the description
damages = st.lists(st.tuples(st.floats(0, 1, exclude_max=True), byte), min_size=1, max_size=8)


@pytest.mark.slow
@pytest.mark.parametrize("part", ["header", "file"])
@given(damages=damages, kept=st.sampled_from([0.5, 0.999, 1, 1, 1, 1]))
@settings(max_examples=5000)
def test_any_damaged_file_gives_a_network_or_one_line_that_names_it(
    tmp_path_factory, whole_file, part, damages, kept
):
    content = bytearray(whole_file)
    length = 8 + int.from_bytes(content[:8], "little") if part == "header" else len(content)
    for place, value in damages:
        content[int(place * length)] = value
    path = tmp_path_factory.getbasetemp() / "odd.safetensors"
    path.write_bytes(content[: int(kept * len(content))])
    try:
        network = load_network(TASK, path).network
    except ValueError as error:
        message = str(error).replace(str(path.parent), "")
        assert path.name in message
        assert message.isprintable()
        assert len(message) < 500
    else:
        assert all(tensor.isfinite().all() for tensor in network.state_dict().values())
