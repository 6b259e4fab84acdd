"""The network of Kim et al. 2018 and the systems that it is compared with."""

from dataclasses import replace

import pytest
import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from sightline.detection2d.config import PAPER, DgfnConfig
from sightline.detection2d.fusion import GatedFusion
from sightline.detection2d.model import Detector
from tests.detection2d.frames import SIZE, TINY

PAPER_SIZE = (375, 1242)
FUSIONS = ("gated", "ones", "early", "late", "camera", "lidar")
NUM_PRIORS = 33 * 34 * 4 + 17 * 17 * 6 + 9 * 9 * 6 + 5 * 5 * 6 + 3 * 3 * 4 + 1 * 1 * 4  # of SIZE


def tiny(fusion, seed=0):
    torch.manual_seed(seed)
    return Detector(replace(PAPER, width=TINY.width, fusion=fusion)).eval()


def images(seed=1, size=SIZE):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(2, 2, 3, *size, generator=generator)


@pytest.fixture(scope="module")
def papers():
    """The network at its own size, without memory for its weights."""
    with torch.device("meta"):
        return Detector(PAPER)


def test_the_fused_maps_have_the_papers_sizes(papers):
    maps = papers.streams["camera"](torch.zeros(1, 3, *PAPER_SIZE, device="meta"))
    sizes = [(map_.shape[3], map_.shape[2], map_.shape[1]) for map_ in maps]
    assert sizes == [
        (156, 47, 512), (78, 24, 1024), (39, 12, 512), (20, 6, 256), (18, 4, 256), (16, 2, 256),
    ]  # fmt: skip


def test_all_convolutions_of_the_streams_may_be_normalised(papers):
    config = replace(TINY, dgfn=DgfnConfig(batch_norm=True))
    streams = Detector(config).streams
    for stream in streams.values():
        layers = [each for each in stream.modules() if not list(each.children())]
        following = list(zip(layers, layers[1:], layers[2:], strict=False))
        convs = [trio for trio in following if isinstance(trio[0], nn.Conv2d)]
        assert len(convs) == 13 + 2 + 8
        for conv, norm, activation in convs:
            assert isinstance(norm, nn.BatchNorm2d)
            assert norm.num_features == conv.out_channels
            assert isinstance(activation, nn.ReLU)
    assert not any(isinstance(each, nn.BatchNorm2d) for each in papers.modules())


def test_it_has_the_papers_parameters_operations_and_priors(papers):
    image = torch.zeros(1, 3, *PAPER_SIZE, device="meta")
    with FlopCounterMode(display=False) as counter:
        outputs = papers.run_heads(image, image)
    assert outputs.heads[0].class_logits.shape == (1, 44504, 4)
    assert counter.get_total_flops() / 2e9 == pytest.approx(321, abs=0.5)
    numbers = {
        name: sum(parameter.numel() for parameter in part.parameters())
        for name, part in (("all", papers), ("fusions", papers.fusions))
    }
    assert numbers["all"] / 1e6 == pytest.approx(50.6, abs=0.05)
    gates = sum(
        parameter.numel()
        for fusion in papers.fusions
        for gate in (fusion.camera_gate, fusion.lidar_gate)
        for parameter in gate.parameters()
    )
    assert gates / 1e6 == pytest.approx(0.10, abs=0.005)


def test_gates_that_are_wide_open_give_exactly_the_network_without_gates():
    gated, ones = tiny("gated"), tiny("ones", seed=1)
    ones.load_state_dict(
        {name: value for name, value in gated.state_dict().items() if "_gate." not in name}
    )
    with torch.no_grad():
        for fusion in gated.fusions:
            for gate in (fusion.camera_gate, fusion.lidar_gate):
                gate.weight.zero_()
                gate.bias.fill_(100.0)
    image, lidar = images()
    found, expected = gated(image, lidar), ones(image, lidar)
    assert (found.camera_gate == 1).all()
    assert torch.equal(found.scores, expected.scores)
    assert torch.equal(found.boxes, expected.boxes)


def test_the_unit_is_equations_5_to_9():
    torch.manual_seed(0)
    unit = GatedFusion((2, 3), nn.Sequential(nn.Conv2d(5, 4, 1), nn.ReLU()), gated=True)
    camera, lidar = torch.randn(1, 2, 5, 6), torch.randn(1, 3, 5, 6)
    fused, _ = unit(camera, lidar)
    both = torch.cat((lidar, camera), dim=1)  # eq. 5
    padded = torch.nn.functional.pad(both, (1, 1, 1, 1))
    row, column = 2, 3
    window = padded[0, :, row : row + 3, column : column + 3]
    weights = [
        torch.sigmoid((gate.weight[0] * window).sum() + gate.bias[0])  # eq. 6 and 7
        for gate in (unit.lidar_gate, unit.camera_gate)
    ]
    weighted = torch.cat(
        (lidar[0, :, row, column] * weights[0], camera[0, :, row, column] * weights[1])  # eq. 8
    )
    expected = torch.relu(unit.mix[0].weight[:, :, 0, 0] @ weighted + unit.mix[0].bias)  # eq. 9
    torch.testing.assert_close(fused[0, :, row, column], expected)


@pytest.mark.parametrize("fusion", FUSIONS)
def test_every_way_of_fusion_detects_by_what_it_looks_at_only(fusion):
    network = tiny(fusion)
    image, lidar = images()
    both = network(image, lidar)
    assert both.scores.shape == (2, NUM_PRIORS * (2 if fusion == "late" else 1), 3)
    assert both.boxes.isfinite().all()
    assert ((both.scores >= 0) & (both.scores <= 1)).all()
    assert (both.camera_gate is not None) == (fusion == "gated")
    changes = {
        "camera": network(torch.zeros_like(image), lidar),
        "lidar": network(image, torch.zeros_like(lidar)),
    }
    for sensor, output in changes.items():
        is_seen = fusion not in {"camera", "lidar"} or fusion == sensor
        assert torch.equal(output.scores, both.scores) != is_seen


def test_late_fusion_is_two_whole_detectors_side_by_side():
    late, camera, lidar = tiny("late"), tiny("camera"), tiny("lidar")
    for name, alone in (("camera", camera), ("lidar", lidar)):
        state = {key: value for key, value in late.state_dict().items() if f".{name}." in f".{key}"}
        alone.load_state_dict(state)
    given = images()
    found = late(*given)
    parts = camera(image=given[0]), lidar(lidar=given[1])
    assert torch.equal(found.boxes, torch.cat([part.boxes for part in parts], dim=1))
    assert torch.equal(found.scores, torch.cat([part.scores for part in parts], dim=1))


def test_a_missing_input_is_refused_by_name():
    with pytest.raises(ValueError, match="needs the inputs image, lidar; lidar is missing"):
        tiny("ones")(image=images()[0])


@pytest.mark.parametrize("fusion", ["gated", "late"])
def test_images_of_different_sizes_are_refused(fusion):
    network = tiny(fusion)
    rows, columns = SIZE
    with pytest.raises(ValueError, match=f"one size, got {rows} x {columns} and {rows} x 280"):
        network._checked_size({"image": images()[0], "lidar": images(size=(rows, 280))[1]})


def test_an_image_must_leave_something_of_the_last_map():
    network = tiny("camera")
    network(image=torch.zeros(1, 3, 257, 257))
    with pytest.raises(ValueError, match="must be at least 257 px, got 257 x 256"):
        network(image=torch.zeros(1, 3, 257, 256))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"prior_sizes_px": (1.0, 2.0)}, "expected 7 prior_sizes_px and 6 prior_ratios, got 2"),
        ({"prior_sizes_px": (1e9,) * 7}, "prior_sizes_px must be from 0.1 to 8192, got 1000000000"),
        ({"prior_ratios": ((-2.0,),) * 6}, "prior_ratios must be from 0.01 to 100, got -2.0"),
    ],
)
def test_priors_that_make_no_sense_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        DgfnConfig(**settings)
