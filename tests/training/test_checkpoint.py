import pytest
import torch

from sightline.files.weights import read_checkpoint_weights, read_weights, write_weights
from sightline.training.callbacks import LastCheckpoint
from tests.training import toy


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


@pytest.mark.parametrize("change", ["missing", "superfluous", "larger"])
def test_resuming_the_network_of_another_version_is_refused(frames, trained, tmp_path, change):
    checkpoint = torch.load(trained[1], weights_only=True)
    state = checkpoint["state_dict"]
    name = min(state)
    if change == "superfluous":
        state["network.old"] = torch.zeros(2)
    elif change == "larger":
        state[name] = torch.cat([state[name], state[name]])
    else:
        del state[name]
    torch.save(checkpoint, tmp_path / "other.ckpt")
    named = "network.old" if change == "superfluous" else name
    with pytest.raises(ValueError, match=f"does not fit this version's network.* {named} is"):
        toy.trainer(tmp_path).fit(
            toy.module(), datamodule=toy.data(frames), ckpt_path=tmp_path / "other.ckpt"
        )


def test_weights_of_another_task_are_refused(tmp_path):
    write_weights(tmp_path / "w", {}, task="other", config={}, provenance={})
    with pytest.raises(ValueError, match="is of task other, expected toy"):
        toy.ToyModule(initial_weights=tmp_path / "w")
