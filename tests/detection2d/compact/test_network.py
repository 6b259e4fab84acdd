"""The compact detector: its parts, what it costs, and what it can learn."""

import subprocess
import sys

import numpy as np
import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from sightline.augmentation.sample_changes import crop
from sightline.data.open import open_dataset
from sightline.detection2d.compact.network import CompactInput
from sightline.detection2d.config import (
    CompactConfig,
    Detection2DConfig,
    DgfnConfig,
    InputConfig,
    StreamConfig,
)
from sightline.detection2d.examples import DetectionExamples, ExampleConfig
from sightline.detection2d.fusion import GatedFusion, GateOutput
from sightline.detection2d.loss import DetectionLossConfig, detection_loss, gate_loss
from sightline.detection2d.model import Detector
from sightline.detection2d.predictor import DetectionPredictor
from sightline.detection2d.task import Detection2D
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.batch import concatenate
from tests.detection2d.frames import painted_frame, write_network

ANY_SIZE = InputConfig(size=None)
SMALL = CompactConfig(
    camera=StreamConfig(channels=(8, 12, 16, 24, 32), blocks=(0, 1, 1, 0)),
    lidar=StreamConfig(channels=(4, 8, 12, 16, 24), blocks=(0, 0, 1, 0)),
    head_channels=16,
    head_convs=1,
    gate_groups=4,
)


def config(compact=SMALL, **settings):
    return Detection2DConfig(compact=compact, **settings)


def images(batch=1, size=(96, 128), seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(2, batch, 3, *size, generator=generator)


def detector(fusion="gated", compact=SMALL):
    torch.manual_seed(0)
    return Detector(config(compact, fusion=fusion)).eval()


@pytest.fixture(scope="module")
def frames():
    """Of the packaged frames, two parts each."""
    samples = open_dataset(PACKAGED_FRAMES, parts={"image", "points", "objects"})
    first, second = samples[0], samples[1]
    corners = ((first, 640), (first, 330), (second, 480), (second, 230))
    return [crop(sample, 110, left, 192, 320) for sample, left in corners]


def batch_of(frames):
    examples = DetectionExamples(ExampleConfig(input=ANY_SIZE, pad_to=32, crop_size=(192, 320)))
    rng = np.random.default_rng(0)
    return concatenate([examples.prepare(each, rng, training=False) for each in frames])


@pytest.mark.parametrize(
    ("settings", "gflop", "m_weights"), [({}, 6.9, 2.0), ({"own_heads": True}, 9.7, 2.3)]
)
def test_it_costs_what_is_said_of_it(settings, gflop, m_weights):
    with torch.device("meta"):
        network = Detector(config(CompactConfig(**settings, auxiliary=False))).eval()
        image = torch.zeros(1, 3, 384, 1248)
        with FlopCounterMode(display=False) as counter:
            network(image, image)
    parameters = sum(parameter.numel() for parameter in network.parameters())
    assert counter.get_total_flops() / 1e9 == pytest.approx(gflop, abs=0.1)
    assert parameters / 1e6 == pytest.approx(m_weights, abs=0.05)


@pytest.mark.parametrize("fusion", ["gated", "ones", "early", "late", "camera", "lidar"])
@pytest.mark.parametrize("pooling", [1, 4])
def test_every_way_of_fusion_detects_by_what_it_looks_at_only(fusion, pooling):
    compact = CompactConfig(
        camera=SMALL.camera, lidar=SMALL.lidar, head_channels=8, head_convs=0, lidar_pooling=pooling
    )
    network = detector(fusion, compact)
    image, lidar = images()
    output = network(image, lidar)
    places = 12 * 16 + 6 * 8 + 3 * 4
    assert output.scores.shape == (1, places * (2 if fusion == "late" else 1), 3)
    assert (output.boxes[..., :2] <= output.boxes[..., 2:]).all()
    assert (output.camera_gate is not None) == (fusion == "gated")
    blank = torch.zeros_like(image)
    for sensor, changed in (("camera", network(blank, lidar)), ("lidar", network(image, blank))):
        is_seen = fusion not in {"camera", "lidar"} or fusion == sensor
        assert torch.equal(changed.scores, output.scores) != is_seen


def test_a_dead_sensor_is_zero_and_points_are_told_from_gaps():
    prepare = CompactInput()
    image, lidar = images(batch=2)
    image[0] = 0
    planes = prepare.camera(image)
    assert not planes[0].any()
    torch.testing.assert_close(planes[1], 4 * (image[1] - 0.5))
    lidar[:, :, 10:20] = 0
    planes = prepare.lidar(lidar)
    assert not planes[:, :, 10:20].any()
    assert (planes[:, 3, :10] == 1).all()


def test_groups_of_channels_have_gates_of_their_own():
    torch.manual_seed(0)
    unit = GatedFusion((4, 6), torch.nn.Identity(), gated=True, groups=2)
    camera, lidar = torch.rand(1, 4, 3, 3), torch.rand(1, 6, 3, 3)
    fused, gates = unit(camera, lidar)
    shares = gates.camera_logits.sigmoid(), gates.lidar_logits.sigmoid()
    expected = [lidar[:, :3] * shares[1][:, :1], lidar[:, 3:] * shares[1][:, 1:],
                camera[:, :2] * shares[0][:, :1], camera[:, 2:] * shares[0][:, 1:]]  # fmt: skip
    torch.testing.assert_close(fused, torch.cat(expected, dim=1))
    with pytest.raises(
        ValueError, match=r"gate_groups must divide the channels .* got 3 for 4 and 6"
    ):
        GatedFusion((4, 6), torch.nn.Identity(), gated=True, groups=3)


def test_gates_are_told_the_share_that_is_left_where_it_is_known():
    logits = torch.tensor([[[[0.5, -2.0]], [[3.0, 1.0]]]])
    gates = (GateOutput(logits, -logits),)
    camera = torch.tensor([[[[1.0, 0.5, torch.nan, torch.nan]]]])
    lidar = torch.full((1, 1, 1, 4), torch.nan)
    target = 0.75
    chances = [torch.tensor(value).sigmoid() for value in (0.5, 3.0)]
    costs = [-(target * p.log() + (1 - target) * (1 - p).log()) for p in chances]
    assert float(gate_loss(gates, camera, lidar)) == pytest.approx(float(sum(costs)) / 4, rel=1e-5)


def test_a_stream_without_its_sensor_is_told_nothing():
    network = detector()
    network.train()
    image, lidar = images(batch=2)
    image[:] = 0
    targets = batch_of(
        [painted_frame(n, (96, 128), rows=[("Car", 20, 20, 70, 60)]) for n in (0, 1)]
    )
    batch = type(targets)(
        sample_ids=targets.sample_ids, image=image, lidar=lidar, targets=targets.targets
    )
    outputs = network.run_heads(image, lidar, auxiliary=True)
    losses = detection_loss(outputs, batch, DetectionLossConfig(), compact=True)
    losses.auxiliary.backward()
    assert not any(p.grad.any() for p in network.auxiliary["camera"].parameters())
    assert any(p.grad.any() for p in network.auxiliary["lidar"].parameters())
    assert float(losses.total.detach()) == pytest.approx(
        float(sum(each.detach() for each in losses[1:])), rel=1e-5
    )


def test_gates_cannot_be_told_what_examples_do_not_hold(frames):
    network, batch = detector(), batch_of(frames[:1])
    outputs = network.run_heads(batch.image, batch.lidar)
    with pytest.raises(ValueError, match="set health to true in the examples' settings"):
        detection_loss(outputs, batch, DetectionLossConfig(gate_weight=1.0), compact=True)


def test_it_learns_the_packaged_frames_by_heart(frames):
    torch.manual_seed(0)
    batch = batch_of(frames)
    task = Detection2D(config())
    optimizer = torch.optim.AdamW(task.network.parameters(), lr=4e-3)
    for _ in range(70):
        optimizer.zero_grad()
        task.losses(batch).total.backward()
        torch.nn.utils.clip_grad_norm_(task.network.parameters(), 10.0)
        optimizer.step()
    task.network.eval()
    with torch.inference_mode():
        for _ in range(8):  # AP over 40 recall positions needs more than 40 objects
            task.score(batch)
    assert float(task.scores()["Car/bbox/moderate"]) > 90


def test_it_learns_in_bfloat16(frames):
    torch.manual_seed(0)
    batch = batch_of(frames)
    task = Detection2D(config())
    optimizer = torch.optim.AdamW(task.network.parameters(), lr=2e-3)
    costs = []
    for _ in range(6):
        optimizer.zero_grad()
        with torch.autocast("cpu", torch.bfloat16):
            losses = task.losses(batch)
        assert losses.total.dtype == torch.float32
        losses.total.backward()
        optimizer.step()
        costs.append(float(losses.total.detach()))
    assert costs[-1] < costs[0]


def test_frames_are_padded_to_the_stride_and_boxes_stay_where_they_were(tmp_path):
    network = write_network(tmp_path / "w.safetensors", config())
    predictor = DetectionPredictor.load(tmp_path / "w.safetensors")
    sample = painted_frame(0, (90, 131), rows=[("Car", 20, 20, 70, 60)])
    result = predictor(sample)
    assert result.camera_gate.shape == (11, 16)
    padded = torch.zeros(1, 3, 96, 160)
    padded[0, :, :90, :131] = sample.image / 255
    with pytest.raises(ValueError, match="must be multiples of 32, got 90 x 131"):
        network(padded[..., :90, :131], padded[..., :90, :131])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"compact": None}, "set one of them, and the other to null"),
        ({"dgfn": DgfnConfig()}, "set one of them, and the other to null"),
        ({"width": 0.0}, r"width must be in \(0, 8.0\], got 0.0"),
    ],
)
def test_settings_that_make_no_network_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        Detection2DConfig(**settings)


@pytest.mark.parametrize(
    ("made", "message"),
    [
        ("Detection2DConfig(fusion='gate')", "fusion must be one of gated, ones, early"),
        ("CompactConfig(lidar_pooling=3)", "compact.lidar_pooling must be one of 1, 2, 4, got 3"),
    ],
)
def test_choices_that_there_are_not_are_refused_without_the_tests_type_checks(made, message):
    code = f"from sightline.detection2d.config import *; {made}"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert f"ValueError: {message}" in ran.stderr
