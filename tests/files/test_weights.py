import io
import json
import os
import pickle
import struct
import zipfile

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.torch import save, save_file
from torch import nn

from sightline.files.weights import (
    CHECKPOINT_KEY,
    NETWORK_PREFIX,
    fill_network,
    read_weights,
    write_weights,
)
from sightline.files.weights_header import find_weights, read_description

TENSORS = {"a": torch.arange(6.0).view(2, 3).T, "b": torch.tensor(3, dtype=torch.int64)}
DESCRIPTION = {
    "task": "toy",
    "config": {"channels": 2, "nested": {"scales": [1, 2.5]}, "name": None},
    "provenance": {"seed": "3"},
}
LONGEST = 500  # characters of a message, the folder of the tests left out


class RunsCode:
    """What a pickle of it runs when it is read."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return os.mkdir, (str(self.mark),)


def checkpoint(**changes):
    """A checkpoint's content, with other parts or, where they are None, without them."""
    state = {f"{NETWORK_PREFIX}{name}": tensor for name, tensor in TENSORS.items()}
    parts = {CHECKPOINT_KEY: DESCRIPTION, "state_dict": state, "global_step": 3} | changes
    return {name: part for name, part in parts.items() if part is not None}


def bytes_of(content, **settings):
    file = io.BytesIO()
    torch.save(content, file, **settings)
    return file.getvalue()


def refused(path):
    """Error of a refused file: one line with its name."""
    with pytest.raises(ValueError, match=path.name) as caught:
        read_weights(path)
    message = str(caught.value).replace(str(path.parent), "")
    assert message.isprintable()
    assert len(message) < LONGEST
    return message


def test_weights_come_back_as_they_were_written(tmp_path):
    path = tmp_path / "weights.safetensors"
    write_weights(path, TENSORS, **DESCRIPTION)
    weights = read_weights(path)
    assert {
        "task": weights.task,
        "config": weights.config,
        "provenance": weights.provenance,
    } == DESCRIPTION
    assert weights.tensors.keys() == TENSORS.keys()
    for name, tensor in TENSORS.items():
        assert torch.equal(weights.tensors[name], tensor)
        assert weights.tensors[name].dtype == tensor.dtype


def test_the_description_alone_is_that_of_the_whole(tmp_path):
    path = tmp_path / "weights.safetensors"
    write_weights(path, TENSORS, **DESCRIPTION)
    described = read_description(path)
    assert (described.task, described.config) == ("toy", DESCRIPTION["config"])
    assert described.provenance == DESCRIPTION["provenance"]


def test_tensors_that_share_memory_are_written_too(tmp_path):
    tied = torch.rand(3)
    write_weights(tmp_path / "w", {"a": tied, "b": tied[1:]}, **DESCRIPTION)
    assert torch.equal(read_weights(tmp_path / "w").tensors["b"], tied[1:])


def test_the_same_weights_give_the_same_bytes(tmp_path):
    for name in ("one", "two"):
        write_weights(tmp_path / name, TENSORS, **DESCRIPTION)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


@pytest.mark.parametrize(
    "content",
    [b"", b"PNG" * 100, struct.pack("<Q", 2**62) + b"{}", struct.pack("<Q", 2) + b"{}"],
    ids=["empty", "other", "endless header", "nothing in it"],
)
def test_what_is_no_weights_file_is_refused_in_one_line(tmp_path, content):
    path = tmp_path / "weights.safetensors"
    path.write_bytes(content)
    assert "cannot be read as safetensors" in refused(
        path
    ) or "does not say which network" in refused(path)


@pytest.mark.parametrize("name", ["a.onnx", "a.xml"])
def test_an_exported_network_is_told_from_a_damaged_file(tmp_path, name):
    (tmp_path / name).write_bytes(b"whatever")
    with pytest.raises(ValueError, match="exported for other programs; give the weights"):
        read_weights(tmp_path / name)


def test_a_file_without_permission_is_not_called_damaged(tmp_path, monkeypatch):
    path = tmp_path / "weights.safetensors"
    path.touch()

    def refuse(path, *_):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("pathlib.Path.open", refuse)
    with pytest.raises(
        ValueError, match="safetensors: cannot be read: permission denied; give this user access"
    ):
        read_weights(path)


def test_a_file_that_was_cut_short_is_refused_wherever_it_ends(tmp_path):
    path = tmp_path / "weights.safetensors"
    write_weights(path, TENSORS, **DESCRIPTION)
    whole = path.read_bytes()
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        assert "cannot be read as safetensors" in refused(path)


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        (None, "does not say which network"),
        ({"format": "pt"}, "does not say which network"),
        ({"sightline": "{}"}, "in an unknown way"),
        ({"sightline": json.dumps({"task": 3})}, "in an unknown way"),
        ({"sightline": json.dumps(DESCRIPTION | {"provenance": {"seed": 3}})}, "an unknown way"),
        ({"sightline": "[" * 20_000}, "in an unknown way"),
        ({"sightline": json.dumps(DESCRIPTION | {"task": "t" * 2**17})}, "in an unknown way"),
    ],
    ids=["none", "other", "empty", "wrong", "no text", "deep", "long"],
)
def test_weights_that_do_not_tell_what_they_are_for_are_refused(tmp_path, metadata, message):
    save_file({"a": torch.zeros(1)}, tmp_path / "w", metadata)
    assert message in refused(tmp_path / "w")


def test_a_checkpoint_is_read_whatever_its_name(tmp_path):
    path = tmp_path / "weights.safetensors"
    path.write_bytes(bytes_of(checkpoint()))
    assert torch.equal(read_weights(path).tensors["a"], TENSORS["a"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"state_dict": None}, "no checkpoint of sightline"),
        ({"state_dict": [1, 2]}, "no checkpoint of sightline"),
        ({CHECKPOINT_KEY: None}, "no checkpoint of sightline"),
        ({CHECKPOINT_KEY: {"task": "toy"}}, "in an unknown way"),
        ({"state_dict": {"network.a": "b"}}, "tensor a is no plain array of numbers"),
        ({"state_dict": {"network.a": torch.zeros(3).to_sparse()}}, "a is no plain array"),
        ({"state_dict": {"network.a": torch.zeros(3, dtype=torch.cfloat)}}, "a is no plain array"),
        ({"state_dict": {"network.a": torch.zeros(1).expand(10**6, 10**6)}}, "claims more numbers"),
        ({"state_dict": {"network.a": torch.tensor([1, torch.nan])}}, "holds NaN or infinite"),
        ({"state_dict": {"network.a": torch.tensor([torch.inf])}}, "holds NaN or infinite"),
    ],
)
def test_a_checkpoint_that_holds_something_else_is_refused(tmp_path, changes, message):
    path = tmp_path / "last.ckpt"
    path.write_bytes(bytes_of(checkpoint(**changes)))
    assert message in refused(path)


def test_weights_that_are_not_finite_are_refused_by_the_tensors_name(tmp_path):
    write_weights(tmp_path / "w", {"fine": torch.ones(2), "bad": -torch.ones(2).log() / 0},
                  **DESCRIPTION)  # fmt: skip
    assert "its tensor bad holds NaN or infinite values" in refused(tmp_path / "w")


def test_a_tensor_of_more_axes_than_pytorch_knows_is_refused(tmp_path):
    save_file({"a": torch.zeros(1)}, tmp_path / "w", {"sightline": json.dumps(DESCRIPTION)})
    content = (tmp_path / "w").read_bytes()
    (length,) = struct.unpack("<Q", content[:8])
    header = content[8 : 8 + length].replace(b"[1]", b"[" + b"1," * 69 + b"1]")
    (tmp_path / "w").write_bytes(struct.pack("<Q", len(header)) + header + content[8 + length :])
    refused(tmp_path / "w")


@pytest.mark.parametrize("is_archive", [True, False])
def test_a_file_with_code_is_refused_without_advice_how_to_run_it(tmp_path, is_archive):
    mark, path = tmp_path / "mark", tmp_path / "last.ckpt"
    content = checkpoint(callbacks=RunsCode(mark))
    path.write_bytes(bytes_of(content) if is_archive else pickle.dumps(content))
    message = refused(path)
    assert not mark.exists()
    assert "weights_only" not in message
    assert "could run code" in message or not is_archive


def test_an_archive_that_is_packed_is_not_unpacked(tmp_path):
    path = tmp_path / "last.ckpt"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", bytes(10**7))
    assert "it is packed, to hold 10000000 bytes" in refused(path)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
def test_a_checkpoint_with_flipped_bytes_among_its_weights_is_refused(tmp_path, share):
    weights = {f"{NETWORK_PREFIX}a": torch.linspace(1, 2, 2000)}
    content = bytearray(bytes_of(checkpoint(state_dict=weights)))
    start = content.index(weights[f"{NETWORK_PREFIX}a"].numpy().tobytes())
    content[start + 4 * int(2000 * share)] ^= 1
    path = tmp_path / "last.ckpt"
    path.write_bytes(content)
    assert "the checksum of" in refused(path)


def test_an_archive_that_claims_to_span_several_disks_is_refused(tmp_path):
    content = bytearray(bytes_of(checkpoint()))
    num_disks = content.rindex(b"PK\x06\x07") + 16  # in the locator of the 64-bit directory
    content[num_disks] = 2
    path = tmp_path / "last.ckpt"
    path.write_bytes(content)
    assert "cannot be read as a checkpoint" in refused(path)


damages = st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), max_size=8)


@pytest.mark.parametrize("kind", ["weights", "checkpoint"])
@given(damages=damages, kept=st.floats(0.5, 1.5))
def test_a_damaged_file_gives_weights_or_one_line_that_names_it(
    tmp_path_factory, kind, damages, kept
):
    metadata = {"sightline": json.dumps(DESCRIPTION)}
    whole = save({"a": torch.ones(4)}, metadata) if kind == "weights" else bytes_of(checkpoint())
    content = bytearray(whole)
    for place, value in damages:
        content[int(place * len(content))] = value
    path = tmp_path_factory.mktemp("damaged") / "odd"
    path.write_bytes(content[: int(kept * len(content))])
    try:
        weights = read_weights(path)
    except ValueError as error:
        message = str(error).replace(str(path), "PATH")
        assert "PATH" in message
        assert message.isprintable()
        assert len(message) < LONGEST
    else:
        assert all(tensor.isfinite().all() for tensor in weights.tensors.values())


@pytest.mark.parametrize("half", [torch.float16, torch.bfloat16])
def test_weights_of_half_precision_are_widened(half):
    network = nn.Linear(3, 2)
    kept = {name: tensor.to(half) for name, tensor in network.state_dict().items()}
    fill_network(network, kept)
    for name, tensor in network.state_dict().items():
        assert tensor.dtype == torch.float32
        assert torch.equal(tensor, kept[name].float())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"weight": None}, "the tensor weight is missing"),
        ({"extra": torch.zeros(1)}, "no place for the tensor extra"),
        ({"weight": torch.zeros(3, 2)}, r"weight is float32 \[3, 2\], expected float32 \[2, 3\]"),
        ({"weight": torch.zeros(2, 3).double()}, r"weight is float64 \[2, 3\], expected float32"),
    ],
)
def test_a_network_takes_no_weights_of_another(changes, message):
    network = nn.Linear(3, 2)
    tensors = {**network.state_dict(), **changes}
    with pytest.raises(ValueError, match=message):
        fill_network(network, {name: each for name, each in tensors.items() if each is not None})


@pytest.mark.parametrize("name", ["w.safetensors", "w.ckpt"])
def test_a_pointer_of_git_lfs_is_named(tmp_path, name):
    (tmp_path / name).write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\n")
    with pytest.raises(ValueError, match="is a pointer of Git LFS, not the file itself; fetch it"):
        read_weights(tmp_path / name)


def test_the_folder_of_a_run_is_refused_with_the_file_in_it(tmp_path):
    (tmp_path / "weights.safetensors").touch()
    with pytest.raises(ValueError, match=r"is the folder of a run; give .*weights\.safetensors"):
        find_weights(tmp_path)
    (tmp_path / "weights.safetensors").unlink()
    with pytest.raises(ValueError, match=r"is a folder without weights\.safetensors, as a run"):
        find_weights(tmp_path)
