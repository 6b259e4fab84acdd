import pytest
import torch
import torch.nn.functional as F
from hypothesis import given
from hypothesis import strategies as st

from sightline.depth_completion.config import ShiftConvConfig
from sightline.depth_completion.shift_conv import ShiftConv, ShiftConvBranch, translate
from tests.reference import shift_conv as reference


def whole_numbers(seed, *shape):
    """Random small whole numbers: sums of their products are exact in any order."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(-8, 9, shape, generator=generator).float()


def layer_with_weights(weights, shift_px=1):
    layer = ShiftConv(weights.shape[1], weights.shape[0], shift_px, norm=False)
    with torch.no_grad():
        layer.mix.weight.copy_(weights[:, :, None, None])
        layer.mix.bias.zero_()
    return layer


@given(
    seed=st.integers(0, 2**32 - 1),
    channels=st.sampled_from([9, 18, 36]),
    height=st.integers(1, 6),
    width=st.integers(1, 6),
    shift_px=st.sampled_from([1, 2, 4]),
)
def test_a_layer_shifts_each_channel_by_its_group_and_mixes_them(
    seed, channels, height, width, shift_px
):
    maps = whole_numbers(seed, 1, channels, height, width)
    weights = whole_numbers(seed + 1, 2, channels)
    expected = reference.mix(reference.shift(maps[0].tolist(), shift_px), weights.tolist())
    mixed = layer_with_weights(weights, shift_px)(maps)[0]
    assert mixed.tolist() == expected
    assert translate(maps, shift_px)[0].tolist() == reference.shift(maps[0].tolist(), shift_px)


@given(seed=st.integers(0, 2**32 - 1), shift_px=st.sampled_from([1, 2, 4]))
def test_on_nine_copies_of_a_map_a_layer_is_a_3x3_convolution(seed, shift_px):
    image = whole_numbers(seed, 2, 1, 7, 9)
    kernels = whole_numbers(seed + 1, 5, 1, 3, 3)
    layer = layer_with_weights(kernels.flatten(start_dim=1), shift_px)
    convolved = F.conv2d(image, kernels, padding=shift_px, dilation=shift_px)
    assert torch.equal(layer(image.repeat(1, 9, 1, 1)), convolved)


def test_convention_group_0_sees_its_upper_left_and_group_4_itself():
    image = torch.arange(1.0, 10.0).reshape(1, 1, 3, 3)
    nine_copies = image.repeat(1, 9, 1, 1)
    centre = layer_with_weights(torch.eye(9))(nine_copies)[0, :, 1, 1]
    assert centre.tolist() == [1, 2, 3, 4, 5, 6, 7, 8, 9]


def test_outside_the_map_there_is_zero():
    corner = layer_with_weights(torch.eye(9))(torch.ones(1, 9, 3, 3))[0, :, 0, 0]
    assert corner.tolist() == [0, 0, 0, 0, 1, 1, 0, 1, 1]


@pytest.mark.parametrize("channels", [0, 8, 10, 35])
def test_channels_that_are_no_multiple_of_nine_are_refused(channels):
    with pytest.raises(ValueError, match=f"multiple of 9, one group per direction, got {channels}"):
        ShiftConv(channels, 36)


def test_a_shift_of_nothing_is_refused():
    with pytest.raises(ValueError, match="shift_px must be at least 1, got 0"):
        ShiftConv(9, 9, 0)


def test_norm_ends_a_layer_with_a_relu():
    layer = ShiftConv(9, 9).eval()
    assert layer(whole_numbers(0, 1, 9, 5, 5)).min() == 0
    assert layer_with_weights(torch.eye(9))(whole_numbers(0, 1, 9, 5, 5)).min() < 0


def test_the_fixed_kernels_are_no_part_of_the_weights():
    layer = ShiftConv(9, 9)
    assert not any("shift" in name for name in layer.state_dict())
    assert not layer.shift_kernels.requires_grad


@pytest.mark.parametrize(
    ("config", "reach_px"),
    [
        (ShiftConvConfig(layers=3), 3),
        (ShiftConvConfig(layers=4, shifts_px=(1, 2, 4)), 8),
        (ShiftConvConfig(layers=2, shifts_px=(4,)), 8),
    ],
)
def test_depth_travels_as_far_as_the_shifts_add_up_to(config, reach_px):
    torch.manual_seed(0)
    branch = ShiftConvBranch(1, config).double().eval()
    depth = torch.zeros(1, 1, 25, 25, dtype=torch.float64)
    spot = depth.clone()
    spot[..., 12, 12] = 1
    changed = (branch(spot) - branch(depth))[0, 0].abs() > 0
    rows = changed.any(dim=1).nonzero()
    assert rows.min() == 12 - reach_px
    assert rows.max() == 12 + reach_px


def test_a_folded_branch_gives_a_map_of_the_same_size():
    branch = ShiftConvBranch(2, ShiftConvConfig(channels=9, layers=2, stride=4)).eval()
    assert branch(torch.rand(2, 2, 8, 12)).shape == (2, 1, 8, 12)
    assert branch.layers[0].mix.in_channels == 9


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"channels": 35}, "multiple of 9, got 35"),
        ({"layers": 0}, "layers must be at least 1, got 0"),
        ({"shifts_px": ()}, "one shift or more"),
        ({"shifts_px": (1, 0)}, "one shift or more"),
    ],
)
def test_wrong_settings_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        ShiftConvConfig(**settings)
