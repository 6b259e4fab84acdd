import json
from dataclasses import asdict, replace

import pytest
import torch
from jsonargparse import ArgumentParser
from torch import nn

from sightline.depth_completion.config import (
    DepthCompletionConfig,
    ShiftConvConfig,
    SignedThreshold,
    TrunkConfig,
    UNetConfig,
)
from sightline.depth_completion.model import DepthCompletionNet
from sightline.depth_completion.surroundings import find_surroundings
from tests.settings import set_unchecked

PAPER = DepthCompletionConfig(
    shift_conv=ShiftConvConfig(channels=9, layers=2),
    trunk=TrunkConfig(channels=(4, 6), modules=1),
    stem_channels=4,
)
RESIDUAL = replace(
    PAPER,
    stem_fusion="concatenate",
    trunk_stride=2,
    filled_input=True,
    residual=True,
    validity_channel=True,
    presence_channel=True,
    uncertainty=True,
)
FULL = replace(
    RESIDUAL,
    shift_conv=ShiftConvConfig(channels=9, layers=2, shifts_px=(1, 2), stride=4),
    trunk=TrunkConfig(channels=(4, 6), modules=1, exchange="neighbours", head_kernel_px=1),
    refinement_channels=4,
    propagation_steps=2,
    correction="log",
)
BETWEEN = replace(
    RESIDUAL,
    shift_conv=None,
    stem_fusion="joint",
    surroundings_px=2,
    correction="between",
    refinement_channels=4,
    refinement_hidden_channels=6,
)
STREET = replace(
    RESIDUAL,
    shift_conv=None,
    stem_fusion="joint",
    unet=UNetConfig(channels=(4, 4, 6, 6, 8), blocks=(0, 0, 1, 0), up_channels=(4, 4, 6, 6)),
    filling="street",
    correction="log",
    focal_px=300.0,
)
CONFIGS = {
    "paper": PAPER,
    "without shift-conv": replace(PAPER, shift_conv=None),
    "residual": RESIDUAL,
    "stride 4": replace(RESIDUAL, trunk_stride=4, propagation_steps=1),
    "full": FULL,
    "folded refinement": replace(FULL, trunk_stride=4, refinement_stride=2),
    "dead zone": replace(FULL, dead_zone=0.02),
    "between surfaces": BETWEEN,
    "street": STREET,
}
each_config = pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS.keys())


def network(config):
    torch.manual_seed(0)
    return DepthCompletionNet(config).eval()


def trained(config):
    """Network with a non-zero last layer, as after training."""
    net = network(config)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.add_(0.05 * torch.randn_like(parameter))
    return net


def inputs(height=32, width=64, batch=1):
    generator = torch.Generator().manual_seed(1)
    image = torch.rand(batch, 3, height, width, generator=generator)
    filled_m = 5 + 50 * torch.rand(batch, 1, height, width, generator=generator)
    measured = torch.rand(batch, 1, height, width, generator=generator) < 0.1
    return image, filled_m * measured, filled_m


@each_config
def test_the_output_has_the_maps_that_the_settings_ask_for(config):
    output = network(config)(*inputs(batch=2))
    assert output.depth_m.shape == (2, 1, 32, 64)
    assert (output.uncertainty_m is not None) == config.uncertainty
    assert (output.e_point_m is not None) == (config.shift_conv is not None)
    for plane in output:
        assert plane is None or plane.shape == (2, 1, 32, 64)


@each_config
def test_every_weight_learns(config):
    net = trained(config).train()
    output = net(*inputs(batch=2))
    sum(plane.square().sum() for plane in output if plane is not None).backward()
    without = [name for name, p in net.named_parameters() if p.grad is None or not p.grad.any()]
    assert without == []


@pytest.mark.parametrize("correction", ["metres", "log"])
@pytest.mark.parametrize("refinement", [(0, 1), (4, 1), (4, 2)])
def test_a_residual_network_starts_as_the_classical_completion(correction, refinement):
    channels, stride = refinement
    config = replace(
        RESIDUAL, correction=correction, refinement_channels=channels, refinement_stride=stride
    )
    image, sparse_m, filled_m = inputs()
    assert torch.equal(network(config)(image, sparse_m, filled_m).depth_m, filled_m)


@pytest.mark.parametrize(
    "config",
    [
        PAPER,
        replace(PAPER, shift_conv=None, trunk_stride=4),
        replace(PAPER, trunk_stride=4, uncertainty=True, refinement_channels=4),
        replace(PAPER, trunk_stride=4, refinement_channels=4, refinement_stride=2),
    ],
    ids=["paper", "folded", "refinement", "folded refinement"],
)
def test_an_untrained_network_can_start_at_one_depth_everywhere(config):
    net = network(config)
    assert net(*inputs()).depth_m.std() > 0.01
    net.start_at_constant_depth()
    output = net(*inputs())
    torch.testing.assert_close(output.depth_m, torch.full((1, 1, 32, 64), 17.0))
    if config.uncertainty:
        torch.testing.assert_close(
            output.uncertainty_m, output.uncertainty_m.mean().expand(1, 1, 32, 64)
        )


def test_a_residual_network_has_its_start_already():
    net = network(RESIDUAL)
    net.start_at_constant_depth()
    image, sparse_m, filled_m = inputs()
    assert torch.equal(net(image, sparse_m, filled_m).depth_m, filled_m)


def test_propagation_leaves_that_start_where_nothing_is_measured():
    image, sparse_m, filled_m = inputs()
    other_m = sparse_m * 1.5  # measurements that differ from the completion
    depth_m = network(FULL)(image, other_m, filled_m).depth_m
    assert torch.equal(depth_m != filled_m, sparse_m > 0)


def test_a_log_correction_stays_within_a_factor_of_four():
    image, sparse_m, filled_m = inputs()
    net = trained(replace(FULL, propagation_steps=0))
    nn.init.constant_(net.refinement[-1].bias, 1e3)
    torch.testing.assert_close(net(image, sparse_m, filled_m).depth_m, 4 * filled_m)


def test_corrections_within_the_dead_zone_are_none_and_others_are_smaller_by_it():
    config = replace(FULL, propagation_steps=0)
    plain, careful = trained(config), trained(replace(config, dead_zone=0.1))
    image, sparse_m, filled_m = inputs()
    filled_m = filled_m.clamp(min=1)
    with torch.no_grad():
        whole = (plain(image, sparse_m, filled_m).depth_m / filled_m).log()
        found = (careful(image, sparse_m, filled_m).depth_m / filled_m).log()
    expected = torch.where(whole.abs() <= 0.1, 0.0, whole - 0.1 * whole.sign())
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)
    assert (expected == 0).any()
    assert (expected != 0).any()


def test_what_lies_in_the_dead_zone_still_learns():
    net = network(replace(FULL, dead_zone=0.1)).train()
    image, sparse_m, filled_m = inputs()
    net(image, sparse_m, filled_m).depth_m.sum().backward()
    assert net.refinement[-1].bias.grad[0] != 0


@pytest.mark.parametrize("stride", [1, 2, 4])
def test_the_refinement_sees_what_lies_around_each_pixel(stride):
    net = trained(replace(FULL, trunk_stride=4, refinement_stride=stride, propagation_steps=0))
    nn.init.zeros_(net.trunk.head.weight)  # only the refinement contributes
    image, sparse_m, filled_m = inputs(32, 32)
    changed = image.clone()
    changed[..., 17, 14] += 1.0
    is_changed = net(image, sparse_m, filled_m).depth_m != net(changed, sparse_m, filled_m).depth_m
    rows, columns = is_changed[0, 0].nonzero().T
    reach = 2 * stride  # two 3x3 kernels, in folded pixels
    cell_row, cell_column = 17 // stride * stride, 14 // stride * stride
    assert (rows.min(), rows.max()) == (cell_row - reach, cell_row + stride - 1 + reach)
    assert (columns.min(), columns.max()) == (
        cell_column - reach,
        cell_column + stride - 1 + reach,
    )


def test_uncertainty_is_positive_even_where_the_network_is_sure():
    net = trained(RESIDUAL)
    nn.init.constant_(net.trunk.head.bias, -1e3)
    assert net(*inputs()).uncertainty_m.min() > 0


def test_a_network_from_points_alone_needs_no_completion_and_ignores_one():
    net = network(PAPER)
    image, sparse_m, filled_m = inputs()
    assert not net.takes_filled_depth
    assert torch.equal(net(image, sparse_m).depth_m, net(image, sparse_m, filled_m).depth_m)


def test_a_network_that_starts_from_a_completion_asks_for_it():
    net = network(RESIDUAL)
    assert net.takes_filled_depth
    with pytest.raises(ValueError, match="give filled_depth_m"):
        net(*inputs()[:2])


@pytest.mark.parametrize("size", [(16, 22), (14, 24)])
def test_sizes_that_the_scales_do_not_divide_are_refused(size):
    net = network(RESIDUAL)
    assert net.stride == 4
    with pytest.raises(ValueError, match=f"multiples of 4, got {size[0]} x {size[1]}"):
        net(*inputs(*size))


def test_a_black_image_counts_as_a_missing_camera():
    net = trained(RESIDUAL)
    _, sparse_m, filled_m = inputs()
    stem_inputs = []
    net.stems[0].register_forward_pre_hook(lambda _, args: stem_inputs.append(args[0]))
    net(torch.zeros(1, 3, 32, 64), sparse_m, filled_m)
    net(torch.full((1, 3, 32, 64), 0.5), sparse_m, filled_m)
    missing, grey = (nn.functional.pixel_shuffle(planes, 2) for planes in stem_inputs)
    assert torch.equal(missing, torch.zeros_like(missing))
    assert torch.equal(grey[:, :3], torch.zeros_like(grey[:, :3]))
    assert torch.equal(grey[:, 3], torch.ones_like(grey[:, 3]))


def test_one_missing_camera_does_not_touch_the_others_of_a_batch():
    net = trained(FULL)
    image, sparse_m, filled_m = inputs(batch=2)
    single = net(image[:1], sparse_m[:1], filled_m[:1]).depth_m
    image[1] = 0
    torch.testing.assert_close(net(image, sparse_m, filled_m).depth_m[:1], single)


def test_a_network_of_a_street_sees_the_direction_of_each_pixel_with_its_sign():
    net = trained(STREET)
    image, sparse_m, _ = inputs()
    height = image.shape[2]
    slopes = 0.05 * (height // 2 - torch.arange(height, dtype=torch.float32))  # upwards
    inverse = 1 / 30 + torch.maximum(-slopes / 1.65, slopes / 6)
    street_m = (1 / inverse)[:, None].expand(height, image.shape[3])[None, None].contiguous()
    street_m[:, :, 0] = street_m[:, :, 1]  # as padding repeats it
    trunk_inputs = []
    net.trunk.register_forward_pre_hook(lambda _, args: trunk_inputs.append(args[0]))
    net(image, sparse_m, street_m)
    plane = trunk_inputs[0][0, -1, :, 0]
    steps = plane.diff()
    assert (steps[1:] < 0).all()
    assert steps[0] == 0
    assert plane[height // 2].abs() < 1e-5
    assert plane[0] > 0 > plane[-1]


@each_config
def test_an_empty_sweep_gives_finite_numbers(config):
    image, sparse_m, _ = inputs()
    empty_m = torch.zeros_like(sparse_m)
    for plane in trained(config)(image, empty_m, empty_m):
        assert plane is None or plane.isfinite().all()


@pytest.mark.parametrize("config", [PAPER, FULL, STREET], ids=["paper", "full", "street"])
def test_the_exported_graph_takes_other_sizes_and_gives_the_same(config):
    net = trained(config)
    num_inputs = 3 if net.takes_filled_depth else 2
    stride = net.stride
    rows, columns = torch.export.Dim("rows", min=2), torch.export.Dim("columns", min=2)
    dynamic = {2: stride * rows, 3: stride * columns}
    shapes = (dynamic,) * num_inputs
    exported = torch.export.export(
        net, inputs(4 * stride, 6 * stride)[:num_inputs], dynamic_shapes=shapes
    ).module()
    other = inputs(8 * stride, 3 * stride)[:num_inputs]
    for found, expected in zip(exported(*other), net(*other), strict=True):
        if expected is None:
            assert found is None
        else:
            torch.testing.assert_close(found, expected)


@each_config
def test_settings_survive_json_and_the_command_lines_parser(config):
    parser = ArgumentParser(exit_on_error=False)
    parser.add_argument("--network", type=DepthCompletionConfig)
    read = json.loads(json.dumps({"network": asdict(config)}))
    assert parser.instantiate(parser.parse_object(read)).network == config


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"residual": True}, "set filled_input too"),
        ({"filled_input": True, "residual": True, "correction": "between"}, "set surroundings_px"),
        ({"surroundings_px": 6}, "set filled_input to true and shift_conv to null"),
        ({"surroundings_px": 6, "filled_input": True}, "and shift_conv to null"),
        ({"surroundings_px": -1}, "surroundings_px must be at least 0"),
        ({"keep_measured": True}, "keep_measured needs the classical completion"),
        (
            {"refinement_channels": 4, "refinement_stride": 2},
            "refinement_stride must be at most trunk_stride 1, got 2",
        ),
        ({"trunk_stride": 2, "refinement_stride": 2}, "needs refinement_channels"),
        ({"unet": UNetConfig(), "refinement_channels": 4}, "set refinement_channels to 0"),
        ({"correction": "log"}, "set residual"),
        ({"dead_zone": 0.1}, "set correction to log"),
        ({"dead_zone": -0.1}, "dead_zone must be from 0"),
        ({"least_correction": 1.0}, "least_correction must be from 0"),
        ({"least_correction_above": -0.1}, "least_correction_above must be from 0"),
        (
            {"least_correction_above": SignedThreshold(nearer=0.0, farther=1.0)},
            "above must be from 0",
        ),
        (
            {"least_correction_beside": SignedThreshold(nearer=float("nan"), farther=0.0)},
            "beside must be",
        ),
        ({"least_correction_beside": 0.1}, "beside is the logarithm of a factor"),
        ({"depth_scale_m": 0.0}, "depth_scale_m must be from 0.001 to 1e"),
        ({"stem_channels": 0}, "stem_channels must be at least 1"),
        ({"propagation_steps": -1}, "propagation_steps must be at least 0, got -1"),
    ],
)
def test_wrong_settings_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        DepthCompletionConfig(**settings)


@pytest.mark.parametrize(
    ("settings", "wrong", "message"),
    [
        (
            DepthCompletionConfig(),
            {"stem_fusion": "mean"},
            "^stem_fusion must be one of sum, concatenate, joint, got 'mean'",
        ),
        (DepthCompletionConfig(), {"trunk_stride": 3}, "trunk_stride must be one of 1, 2, 4"),
        (TrunkConfig(), {"exchange": "some"}, "trunk.exchange must be one of all, neighbours"),
        (ShiftConvConfig(), {"stride": 8}, "shift_conv.stride must be one of 1, 2, 4, got 8"),
    ],
)
def test_choices_that_there_are_not_are_refused(settings, wrong, message):
    with pytest.raises(ValueError, match=message):
        set_unchecked(settings, **wrong)


def test_between_surfaces_depth_moves_as_far_as_the_measurements_around():
    net = network(BETWEEN)
    image, sparse_m, filled_m = inputs(16, 24)
    assert torch.equal(net(image, sparse_m, filled_m).depth_m, filled_m)  # as it starts
    surroundings = find_surroundings(sparse_m, filled_m, BETWEEN.surroundings_px)
    for bias, reached in ((50.0, surroundings.farthest_m), (-50.0, surroundings.nearest_m)):
        with torch.no_grad():
            net.refinement[-1].bias[0] = bias  # the share; the factor and the uncertainty follow
        torch.testing.assert_close(net(image, sparse_m, filled_m).depth_m, reached)
