import json

import pytest
import torch
from safetensors.torch import save_file

from sightline.training.callbacks import LastCheckpoint
from sightline.training.checkpoint import read_checkpoint_weights, read_weights, write_weights
from tests.training import toy

TENSORS = {"a": torch.arange(6.0).view(2, 3).T, "b": torch.tensor(3, dtype=torch.int64)}
DESCRIPTION = {
    "task": "toy",
    "config": {"channels": 2, "nested": {"scales": [1, 2.5]}, "name": None},
    "provenance": {"seed": "3"},
}


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


def test_tensors_that_share_memory_are_written_too(tmp_path):
    tied = torch.rand(3)
    write_weights(tmp_path / "w", {"a": tied, "b": tied[1:]}, **DESCRIPTION)
    assert torch.equal(read_weights(tmp_path / "w").tensors["b"], tied[1:])


def test_the_same_weights_give_the_same_bytes(tmp_path):
    for name in ("one", "two"):
        write_weights(tmp_path / name, TENSORS, **DESCRIPTION)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "cannot be read as safetensors"),
        (b"PNG" * 100, "cannot be read as safetensors"),
        (None, "there are no weights"),
    ],
    ids=["empty", "other", "absent"],
)
def test_what_is_no_weights_file_is_refused_in_one_line(tmp_path, content, said):
    path = tmp_path / "weights.safetensors"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=said) as refused:
        read_weights(path)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_file_that_was_cut_short_is_refused_wherever_it_ends(tmp_path):
    path = tmp_path / "weights.safetensors"
    write_weights(path, TENSORS, **DESCRIPTION)
    whole = path.read_bytes()
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match="cannot be read as safetensors"):
            read_weights(path)


@pytest.mark.parametrize(
    "metadata",
    [None, {"format": "pt"}, {"sightline": "{}"}, {"sightline": json.dumps({"task": 3})}],
    ids=["none", "other", "empty", "wrong"],
)
def test_weights_that_do_not_tell_what_they_are_for_are_refused(tmp_path, metadata):
    save_file({"a": torch.zeros(1)}, tmp_path / "w", metadata)
    with pytest.raises(ValueError, match=r"does not tell what network|in an unknown way"):
        read_weights(tmp_path / "w")


@pytest.fixture(scope="module")
def trained(frames, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    last = LastCheckpoint(folder, every_n_steps=3)
    module = toy.module()
    toy.trainer(folder, callbacks=[last], max_epochs=1).fit(module, datamodule=toy.data(frames))
    return module, last.path


def test_a_training_checkpoint_gives_the_networks_weights_and_nothing_else(trained):
    module, path = trained
    weights = read_weights(path)
    assert weights.task == "toy"
    assert weights.config == {"channels": 2, "dropout": 0.5}
    assert weights.provenance["steps"] == "4"
    state = module.network.state_dict()
    assert weights.tensors.keys() == state.keys()
    assert all(torch.equal(weights.tensors[name], state[name]) for name in state)


def test_a_checkpoint_holds_no_code(trained):
    assert torch.load(trained[1], weights_only=True)["global_step"] == 4


def test_a_checkpoint_of_others_is_refused(tmp_path):
    torch.save({"state_dict": {}}, tmp_path / "other.ckpt")
    with pytest.raises(ValueError, match="no checkpoint of sightline"):
        read_weights(tmp_path / "other.ckpt")


def test_a_damaged_checkpoint_is_refused_in_one_line(trained, tmp_path):
    path = tmp_path / "cut.ckpt"
    path.write_bytes(trained[1].read_bytes()[:-200])
    with pytest.raises(ValueError, match="cannot be read as a checkpoint") as refused:
        read_checkpoint_weights(path)
    assert "\n" not in str(refused.value)


def test_training_can_start_from_weights_of_the_same_network(trained, tmp_path):
    module, path = trained
    weights = read_weights(path)
    write_weights(
        tmp_path / "w",
        weights.tensors,
        task=weights.task,
        config=weights.config,
        provenance=weights.provenance,
    )
    for source in (path, tmp_path / "w"):
        started = toy.ToyModule(initial_weights=source)
        for name, tensor in module.network.state_dict().items():
            assert torch.equal(started.network.state_dict()[name], tensor)


def test_weights_that_are_older_than_a_setting_have_its_default(trained, tmp_path):
    weights = read_weights(trained[1])
    older = {name: value for name, value in weights.config.items() if name != "dropout"}
    write_weights(tmp_path / "w", weights.tensors, task="toy", config=older, provenance={})
    toy.ToyModule(initial_weights=tmp_path / "w")
    with pytest.raises(ValueError, match=r"\(dropout 0.5 instead of 0.25\)"):
        toy.ToyModule(toy.ToyConfig(dropout=0.25), initial_weights=tmp_path / "w")


def test_weights_of_another_network_are_refused_with_the_difference(trained):
    with pytest.raises(ValueError, match=r"\(channels 2 instead of 3\)"):
        toy.ToyModule(toy.ToyConfig(channels=3), initial_weights=trained[1])


def test_resuming_another_network_is_refused_with_the_difference(frames, trained, tmp_path):
    module = toy.ToyModule(toy.ToyConfig(channels=3))
    with pytest.raises(ValueError, match=r"\(channels 2 instead of 3\)"):
        toy.trainer(tmp_path).fit(module, datamodule=toy.data(frames), ckpt_path=trained[1])


def test_weights_of_another_task_are_refused(tmp_path):
    write_weights(tmp_path / "w", TENSORS, **(DESCRIPTION | {"task": "other"}))
    with pytest.raises(ValueError, match="is of task other, expected toy"):
        toy.ToyModule(initial_weights=tmp_path / "w")
