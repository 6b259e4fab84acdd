"""Streams taken from networks of one sensor."""

from dataclasses import replace

import pytest
import torch

from sightline.detection2d.model import Detector
from sightline.detection2d.task import load_stream_weights
from sightline.files.settings import config_to_dict
from sightline.files.weights import write_weights
from tests.detection2d.frames import TINY


def write(path, *, seed, task="detection2d", **settings):
    """A network's file, and the network."""
    torch.manual_seed(seed)
    network = Detector(replace(TINY, **settings))
    tensors = network.state_dict()
    config = config_to_dict(network.config)
    write_weights(path, tensors, task=task, config=config, provenance={})
    return network


def load(network, sources):
    load_stream_weights(network, sources, task_name="detection2d")


def test_streams_come_from_their_networks_and_all_else_stays(tmp_path):
    camera = write(tmp_path / "camera", seed=1, fusion="camera")
    lidar = write(tmp_path / "lidar", seed=2, fusion="lidar")
    network = Detector(TINY)
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    load(network, {"camera": tmp_path / "camera", "lidar": tmp_path / "lidar"})
    given = camera.state_dict() | lidar.state_dict()
    taken = 0
    for name, tensor in network.state_dict().items():
        is_stream = name.startswith("streams.")
        taken += is_stream
        assert torch.equal(tensor, given[name] if is_stream else before[name])
    assert taken > 20


def test_a_stream_may_come_from_a_network_of_both_sensors(tmp_path):
    other = write(tmp_path / "both", seed=1)
    network = Detector(replace(TINY, fusion="lidar"))
    load(network, {"lidar": tmp_path / "both"})
    for name, tensor in network.streams.state_dict().items():
        assert torch.equal(tensor, other.streams.state_dict()[name])


@pytest.mark.parametrize(
    ("sensor", "file", "message"),
    [
        ("radar", {}, "initial_streams names radar, but .* streams are camera, lidar"),
        ("camera", {"task": "depth-completion"}, "is of task depth-completion, expected det"),
        ("camera", {"fusion": "lidar"}, r"has no stream camera that fits .* is missing"),
        ("camera", {"width": 0.05}, r"w has no stream camera that fits .* expected float32"),
    ],
)
def test_other_streams_are_refused(tmp_path, sensor, file, message):
    write(tmp_path / "w", seed=0, **file)
    with pytest.raises(ValueError, match=message):
        load(Detector(TINY), {sensor: tmp_path / "w"})
