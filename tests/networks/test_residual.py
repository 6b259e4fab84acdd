import pytest
import torch
import torch.nn.functional as F

from sightline.networks.residual import ConvNorm, ResidualBlock, ResidualStream

CHANNELS, BLOCKS = (4, 4, 6, 6, 8), (0, 1, 0, 2)


@pytest.mark.parametrize("pooling", [1, 2, 4])
@pytest.mark.parametrize("num_maps", [1, 3, 4])
def test_the_last_maps_have_the_same_strides_with_and_without_pooling(pooling, num_maps):
    stream = ResidualStream(3, CHANNELS, BLOCKS, pooling, num_maps).eval()
    maps = stream(torch.rand(2, 3, 64, 96))
    strides = [4, 8, 16, 32][-num_maps:]
    assert [tuple(each.shape) for each in maps] == [
        (2, channels, 64 // stride, 96 // stride)
        for channels, stride in zip(CHANNELS[-num_maps:], strides, strict=True)
    ]


def test_a_pooled_stream_sees_the_largest_value_of_each_block():
    stream = ResidualStream(1, CHANNELS, BLOCKS, pooling=2).eval()
    image = torch.rand(1, 1, 64, 64)
    largest = F.max_pool2d(image, 2).repeat_interleave(2, 2).repeat_interleave(2, 3)
    for given, same in zip(stream(largest), stream(image), strict=True):
        torch.testing.assert_close(given, same)


@pytest.mark.parametrize("relu", [True, False])
def test_the_convolution_is_normalised_and_ends_at_zero_if_asked(relu):
    layer = ConvNorm(3, 5, stride=2, relu=relu).train()
    maps = layer(torch.randn(8, 3, 16, 16))
    assert maps.shape == (8, 5, 8, 8)
    assert (maps.min() >= 0) == relu
    if not relu:
        torch.testing.assert_close(maps.mean(dim=(0, 2, 3)), torch.zeros(5), atol=1e-5, rtol=0)
        torch.testing.assert_close(maps.var(dim=(0, 2, 3)), torch.ones(5), atol=1e-2, rtol=0)


def test_a_block_whose_second_layer_gives_nothing_keeps_its_maps():
    block = ResidualBlock(4).eval()
    torch.nn.init.zeros_(block.second[1].weight)
    maps = torch.rand(1, 4, 8, 8)
    assert torch.equal(block(maps), maps)
