import re
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from lightning import Trainer

from sightline.depth_completion.config import DepthCompletionConfig, UNetConfig
from sightline.depth_completion.task import DepthCompletion
from sightline.depth_completion.unet import UNet, start_from_detector
from sightline.detection2d.config import CompactConfig, Detection2DConfig, InputConfig, StreamConfig
from sightline.detection2d.model import Detector
from sightline.files.settings import config_to_dict
from sightline.files.weights import write_weights

SMALL = UNetConfig(channels=(4, 4, 6, 6, 8), blocks=(0, 1, 0, 1), up_channels=(3, 4, 5, 6))


def unet(inputs=5, outputs=2, config=SMALL, seed=0):
    torch.manual_seed(seed)
    return UNet(inputs, outputs, config).eval()


def normalised(part, maps):
    """Convolution and normalisation, one after the other."""
    convolution, norm = part[0], part[1]
    maps = F.conv2d(
        maps, convolution.weight, stride=convolution.stride, padding=convolution.padding
    )
    scale = norm.weight / (norm.running_var + norm.eps).sqrt()
    shift = norm.bias - norm.running_mean * scale
    return maps * scale[:, None, None] + shift[:, None, None]


def convolved(part, maps):
    return normalised(part, maps).clamp(min=0)


def twice_as_large(maps):
    return maps.repeat_interleave(2, 2).repeat_interleave(2, 3)


def test_the_output_has_the_size_of_the_input():
    assert SMALL.stride == 32
    assert unet()(torch.rand(2, 5, 64, 96)).shape == (2, 2, 64, 96)


def test_the_network_is_what_its_layers_give_one_by_one():
    network = unet()
    planes = torch.rand(2, 5, 64, 96)
    maps, seen = [], convolved(network.down.stem, planes)
    for stage in network.down.stages:
        seen = convolved(stage[0], seen)
        for block in list(stage)[1:]:
            changed = normalised(block.second, convolved(block.first, seen))
            seen = (seen + changed).clamp(min=0)
        maps.append(seen)
    assert [each.shape[-1] for each in maps] == [24, 12, 6, 3]
    mean = maps[3].sum(dim=(2, 3), keepdim=True) / (2 * 3)
    rising = convolved(network.bottom, maps[3] + mean)
    for up, beside in zip(network.up, maps[2::-1], strict=True):
        rising = convolved(up, torch.cat((twice_as_large(rising), beside), 1))
    blocks = F.conv2d(rising, network.head.weight, network.head.bias, padding=1)
    expected = torch.zeros(2, 2, 64, 96)
    for channel in range(2):
        for row in range(4):
            for column in range(4):
                cell = blocks[:, 16 * channel + 4 * row + column]
                expected[:, channel, row::4, column::4] = cell
    torch.testing.assert_close(network(planes), expected)


def test_a_pixel_changes_the_output_everywhere():
    network = unet(config=UNetConfig()).double()
    planes = torch.rand(1, 5, 64, 96, dtype=torch.float64)
    other = planes.clone()
    other[..., 0, 0] += 5
    assert ((network(planes) - network(other)).abs().amax(dim=1) > 0).float().mean() > 0.9


def write_detector(path, *, fusion="gated"):
    compact = CompactConfig(camera=StreamConfig(channels=SMALL.channels, blocks=SMALL.blocks))
    config = Detection2DConfig(fusion=fusion, compact=compact, input=InputConfig(size=None))
    torch.manual_seed(3)
    detector = Detector(config).eval()
    for name, buffer in detector.named_buffers():
        if name.endswith(("running_mean", "running_var")):
            buffer.uniform_(0.5, 1.5)
    write_weights(
        path,
        detector.state_dict(),
        task="detection2d",
        config=config_to_dict(config),
        provenance={},
    )
    return detector


def test_the_way_down_starts_as_the_camera_stream_of_a_detector(tmp_path):
    detector = write_detector(tmp_path / "detector.safetensors")
    network = unet(inputs=6)
    start_from_detector(network, tmp_path / "detector.safetensors")
    image = torch.rand(2, 3, 64, 96)
    maps = network.down(torch.cat((image - 0.5, torch.rand(2, 3, 64, 96)), dim=1))
    expected = detector.streams["camera"](4 * (image - 0.5))
    for given, same in zip(maps[1:], expected, strict=True):
        torch.testing.assert_close(given, same)


def first_layer(task, stage="fit"):
    task.trainer = Trainer(accelerator="cpu", logger=False, enable_checkpointing=False)
    task.setup(stage)
    return task.network.trunk.down.stem[0].weight


def test_a_training_starts_from_the_named_detector_unless_it_has_initial_weights():
    config = DepthCompletionConfig(shift_conv=None, unet=UNetConfig(), presence_channel=True)
    task = DepthCompletion(config, detector_weights=Path("detection2d-best"))
    before = first_layer(task, "test").clone()
    first = first_layer(task)
    assert not torch.equal(before, first)
    assert first.shape[1] == 5
    assert first[:, :3].abs().min() > 0
    assert first[:, 3:].abs().max() == 0
    shipped = {"initial_weights": Path("depth-image")}
    both = DepthCompletion(**shipped, detector_weights=Path("detection2d-best"))
    assert torch.equal(first_layer(both), first_layer(DepthCompletion(**shipped)))


def test_files_without_such_a_stream_are_refused(tmp_path):
    with pytest.raises(ValueError, match="depth-best holds no camera stream"):
        start_from_detector(unet(), Path("depth-best"))
    write_detector(tmp_path / "early.safetensors", fusion="early")
    with pytest.raises(ValueError, match="holds no camera stream"):
        start_from_detector(unet(), tmp_path / "early.safetensors")
    other = "set network.unet.channels and network.unet.blocks to the detector's"
    with pytest.raises(ValueError, match=re.escape(other)):
        start_from_detector(unet(), Path("detection2d-best"))


def test_detector_weights_need_a_unet():
    task = DepthCompletion(DepthCompletionConfig(), detector_weights=Path("detection2d-best"))
    with pytest.raises(ValueError, match=r"set network\.unet"):
        task.setup("fit")
