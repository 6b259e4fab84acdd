import pytest
import torch
from torch import nn

from sightline.depth_completion.config import TrunkConfig
from sightline.depth_completion.hrnet import (
    Bottleneck,
    Exchange,
    HighResolutionTrunk,
)

SMALL = TrunkConfig(channels=(4, 6, 8, 10), modules=1, reduction=2)


def zero_paths_except(exchange, target, source):
    """Set all paths of an exchange to zero except one."""
    for row, paths in enumerate(exchange.paths):
        for column, path in zip(exchange.sources[row], paths, strict=True):
            if (row, column) != (target, source):
                for parameter in path.parameters():
                    nn.init.zeros_(parameter)


def maps_of(config, *, size=16):
    return [
        torch.rand(1, channels, size >> scale, size >> scale)
        for scale, channels in enumerate(config.channels)
    ]


@pytest.mark.parametrize("scales", [1, 2, 3, 4])
def test_the_trunk_keeps_the_size_of_its_input(scales):
    config = TrunkConfig(channels=(4, 6, 8, 10)[:scales], modules=2, reduction=2)
    trunk = HighResolutionTrunk(5, 3, config).eval()
    side = 3 * config.stride
    assert config.stride == 2 ** (scales - 1)
    assert trunk(torch.rand(2, 5, side, 2 * side)).shape == (2, 3, side, 2 * side)


def test_the_lowest_scale_has_its_own_number_of_blocks():
    trunk = HighResolutionTrunk(4, 1, TrunkConfig(channels=(4, 6, 8), modules=2))
    for module in trunk.blocks:
        assert [len(blocks) for blocks in module] == [2, 2, 1]


def test_the_papers_trunk_has_the_size_that_the_documents_state():
    trunk = HighResolutionTrunk(32, 1, TrunkConfig()).eval()
    multiply_adds = 0

    def count(convolution, _, maps):
        nonlocal multiply_adds
        multiply_adds += convolution.weight.numel() * maps.shape[2] * maps.shape[3]

    for layer in trunk.modules():
        if isinstance(layer, nn.Conv2d):
            layer.register_forward_hook(count)
    trunk(torch.rand(1, 32, 8, 8))
    operations = 2 * multiply_adds * (256 / 8) * (1216 / 8)
    assert operations / 1e9 == pytest.approx(248.7, abs=0.1)
    assert sum(p.numel() for p in trunk.parameters()) / 1e6 == pytest.approx(7.92, abs=0.01)


def test_each_halving_is_one_convolution_of_stride_2():
    exchange = Exchange(SMALL)
    strided = [
        (convolution.in_channels, convolution.out_channels)
        for convolution in exchange.paths[3][0].modules()
        if isinstance(convolution, nn.Conv2d) and convolution.stride == (2, 2)
    ]
    assert strided == [(4, 6), (6, 8), (8, 10)]


def test_an_exchange_without_paths_keeps_every_scale():
    exchange = Exchange(SMALL).eval()
    zero_paths_except(exchange, -1, -1)
    maps = maps_of(SMALL)
    for kept, given in zip(exchange(maps), maps, strict=True):
        assert torch.equal(kept, given)


def test_smaller_scales_come_up_by_the_nearest_neighbour():
    exchange = Exchange(SMALL).eval()
    zero_paths_except(exchange, 0, 2)
    maps = maps_of(SMALL)
    maps[0].zero_()
    largest = exchange(maps)[0]
    lifted = exchange.paths[0][2](maps[2]).relu()
    assert torch.equal(largest[..., ::4, ::4], lifted)
    assert torch.equal(largest, lifted.repeat_interleave(4, dim=2).repeat_interleave(4, dim=3))


@pytest.mark.parametrize(("kind", "receives"), [("all", True), ("neighbours", False)])
def test_far_scales_are_heard_only_where_all_exchange(kind, receives):
    config = TrunkConfig(channels=(4, 6, 8, 10), reduction=2, exchange=kind)
    exchange = Exchange(config).eval()
    maps = maps_of(config)
    before = exchange(maps)
    maps[3] = maps[3] + 1
    after = exchange(maps)
    assert not torch.equal(after[2], before[2])
    assert torch.equal(after[0], before[0]) is not receives


def test_a_bottleneck_without_a_correction_is_a_relu():
    block = Bottleneck(4, reduction=2).eval()
    nn.init.zeros_(block.body[2][1].weight)
    maps = torch.randn(1, 4, 5, 5)
    assert torch.equal(block(maps), maps.relu())
    assert block.body[1][0].weight.shape == (2, 2, 3, 3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"modules": 0}, "modules must be at least 1, got 0"),
        ({"channels": ()}, "one positive number per scale"),
        ({"channels": (6, 9), "reduction": 2}, "multiples of trunk.reduction 2"),
    ],
)
def test_wrong_settings_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        TrunkConfig(**settings)
