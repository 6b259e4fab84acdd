import pytest
import torch
import torch.nn.functional as F

from sightline.depth_completion.config import TrunkConfig
from sightline.depth_completion.unet import UNetTrunk


def trunk_of(*channels, inputs=5, outputs=3, seed=0):
    torch.manual_seed(seed)
    config = TrunkConfig(design="unet", channels=channels)
    return UNetTrunk(inputs, outputs, config).eval(), config


def convolved(part, maps):
    """Convolution, normalisation and ReLU, one after the other."""
    convolution, norm, _ = part
    maps = F.conv2d(maps, convolution.weight, stride=convolution.stride, padding=1)
    scale = norm.weight / (norm.running_var + norm.eps).sqrt()
    shift = norm.bias - norm.running_mean * scale
    return (maps * scale[:, None, None] + shift[:, None, None]).clamp(min=0)


@pytest.mark.parametrize("channels", [(4,), (4, 6), (4, 6, 8, 10)])
def test_the_trunk_keeps_the_size_of_its_input(channels):
    trunk, config = trunk_of(*channels)
    side = 3 * config.stride
    assert config.stride == 2 ** (len(channels) - 1)
    assert trunk(torch.rand(2, 5, side, 2 * side)).shape == (2, 3, side, 2 * side)


def test_three_scales_are_what_their_layers_give_one_by_one():
    trunk, _ = trunk_of(4, 6, 8)
    maps = torch.rand(2, 5, 8, 12)
    first = convolved(trunk.entry, maps)
    second = convolved(trunk.down[0][1], convolved(trunk.down[0][0], first))
    third = convolved(trunk.down[1][1], convolved(trunk.down[1][0], second))
    third = third + third.sum(dim=(2, 3), keepdim=True) / (2 * 3)
    twice = third.repeat_interleave(2, 2).repeat_interleave(2, 3)
    second = convolved(trunk.up[0], torch.cat((twice, second), 1))
    twice = second.repeat_interleave(2, 2).repeat_interleave(2, 3)
    first = convolved(trunk.up[1], torch.cat((twice, first), 1))
    expected = F.conv2d(first, trunk.head.weight, trunk.head.bias, padding=1)
    torch.testing.assert_close(trunk(maps), expected)


def test_a_pixel_changes_the_output_everywhere():
    trunk, _ = trunk_of(4, 6, 8)
    maps = torch.rand(1, 5, 64, 96)
    other = maps.clone()
    other[..., 0, 0] += 5
    assert ((trunk(maps) - trunk(other)).abs().amax(dim=1) > 0).float().mean() > 0.9
