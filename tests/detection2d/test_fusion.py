"""Sensors' own heads, mixed with the joint head by the gates."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection2d.fusion import GateOutput, HeadOutput, mix_heads
from sightline.detection2d.model import Detector
from sightline.detection2d.task import load_stream_weights
from sightline.files.settings import config_to_dict
from sightline.files.weights import write_weights
from tests.detection2d.frames import TINY_COMPACT
from tests.reference.mixed_heads import mixed

SIZES = ((4, 6), (2, 3))
PLACES = sum(rows * columns for rows, columns in SIZES)
SMALL = replace(TINY_COMPACT, compact=replace(TINY_COMPACT.compact, own_heads=True))


def output(generator):
    return HeadOutput(
        class_logits=torch.randn(1, PLACES, 3, generator=generator),
        box_logits=torch.randn(1, PLACES, 8, generator=generator),
        places=torch.rand(PLACES, 4),
    )


def gates(generator, groups, scale=3.0):
    return tuple(
        GateOutput(*(scale * torch.randn(2, 1, groups, *size, generator=generator)))
        for size in SIZES
    )


def images(seed=0):
    return torch.rand(2, 2, 3, 96, 128, generator=torch.Generator().manual_seed(seed))


def write(path, network):
    config = config_to_dict(network.config)
    write_weights(path, network.state_dict(), task="detection2d", config=config, provenance={})
    return path


@given(st.integers(0, 10**6), st.sampled_from([1, 4]))
def test_each_place_takes_the_mean_that_its_gates_say(seed, groups):
    generator = torch.Generator().manual_seed(seed)
    joint, camera, lidar = (output(generator) for _ in range(3))
    weights = gates(generator, groups)
    found = mix_heads(joint, camera, lidar, weights)
    for name in ("class_logits", "box_logits"):
        rows = [getattr(each, name)[0].tolist() for each in (joint, camera, lidar)]
        levels = [[logits[0].tolist() for logits in each] for each in zip(*weights, strict=True)]
        expected = torch.tensor(mixed(*rows, *levels))
        torch.testing.assert_close(getattr(found, name)[0], expected, rtol=1e-4, atol=1e-4)
    assert torch.equal(found.places, joint.places)


def test_a_closed_gate_leaves_the_other_sensors_answer():
    generator = torch.Generator().manual_seed(0)
    joint, camera, lidar = (output(generator) for _ in range(3))
    shut = tuple(
        GateOutput(torch.full((1, 1, *size), -30.0), torch.full((1, 1, *size), 30.0))
        for size in SIZES
    )
    found = mix_heads(joint, camera, lidar, shut)
    expected = joint.class_logits + lidar.class_logits
    torch.testing.assert_close(found.class_logits, expected, rtol=0, atol=0.01)


@pytest.mark.parametrize("fusion", ["gated", "ones"])
def test_before_its_training_it_says_what_two_networks_of_one_sensor_say(tmp_path, fusion):
    """With open gates, their mean; with other gates, weighted by them."""
    torch.manual_seed(0)
    alone = {name: Detector(replace(SMALL, fusion=name)).eval() for name in ("camera", "lidar")}
    files = {name: write(tmp_path / name, each) for name, each in alone.items()}
    network = Detector(replace(SMALL, fusion=fusion)).eval()
    load_stream_weights(network, files, task_name="detection2d")
    image, lidar = images()
    with torch.inference_mode():
        found = network.run_heads(image, lidar)
        own = [each.run_heads(image, lidar).heads[0] for each in alone.values()]
    class_logits = torch.stack([each.class_logits for each in own])
    lowest, highest = class_logits.amin(dim=0) - 1e-5, class_logits.amax(dim=0) + 1e-5
    logits = found.heads[0].class_logits
    assert ((logits >= lowest) & (logits <= highest)).all()
    if fusion == "ones":
        torch.testing.assert_close(logits, class_logits.mean(dim=0))


def test_all_heads_learn():
    torch.manual_seed(0)
    network = Detector(SMALL)
    image, lidar = images()
    output = network.run_heads(image, lidar).heads[0]
    (output.class_logits.square().mean() + output.box_logits.square().mean()).backward()
    heads = [network.heads["joint"], *network.auxiliary.values()]
    assert all(head.classify.weight.grad.any() for head in heads)


def test_streams_whose_heads_do_not_fit_are_refused(tmp_path):
    compact = replace(SMALL.compact, head_convs=2)
    file = write(tmp_path / "camera", Detector(replace(SMALL, fusion="camera", compact=compact)))
    with pytest.raises(ValueError, match=r"has no head camera that fits .* with the same head"):
        load_stream_weights(Detector(SMALL), {"camera": file}, task_name="detection2d")
