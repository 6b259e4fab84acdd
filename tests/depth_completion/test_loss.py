import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.depth_completion import loss as loss_module
from sightline.depth_completion.loss import DepthLossConfig, depth_completion_loss
from sightline.depth_completion.model import DepthCompletionOutput
from sightline.depth_completion.targets import ExpansionConfig, expand_depth
from tests.depth_completion.sparse_maps import random_map
from tests.reference import emd as reference

ALL_TERMS = {"mse": 0.7, "rmse": 0.6, "l1": 0.5, "emd": 0.4, "uncertainty": 0.3}
DENSE_TERMS = {"dense_l1": 0.8, "dense_relative": 0.9, "uncertainty": 0.3}
NO_TERMS = dict.fromkeys(ALL_TERMS, 0.0)

sizes = st.tuples(st.integers(1, 20), st.integers(1, 26))
densities = st.sampled_from([0.02, 0.3, 1.0])


def batch_of(*maps):
    return torch.from_numpy(np.stack(maps)[:, None]).double()


def random_output(seed, truth_m):
    generator = torch.Generator().manual_seed(seed)
    maps = [
        60 * torch.rand(truth_m.shape, generator=generator, dtype=torch.float64) + 0.5
        for _ in range(3)
    ]
    return DepthCompletionOutput(*(one.requires_grad_() for one in maps))


def losses(output, truth_m, *, step=0, **config):
    return depth_completion_loss(output, truth_m, DepthLossConfig(**config), step=step)


def depth_only(depth_m):
    return DepthCompletionOutput(depth_m=depth_m, uncertainty_m=None, e_point_m=None)


def e_point_only(e_point_m):
    return DepthCompletionOutput(
        depth_m=torch.zeros_like(e_point_m), uncertainty_m=None, e_point_m=e_point_m
    )


@given(st.integers(0, 2**31), sizes, densities)
def test_depth_errors_are_per_image_means_over_the_valid_pixels(seed, shape, density):
    truth_m = batch_of(*(random_map(seed + index, shape, density) for index in range(3)))
    output = random_output(seed, truth_m)
    found = losses(output, truth_m, unit_m=10.0, **{**ALL_TERMS, "emd": 0.0})
    rows = []
    for depth, truth, scale in zip(output.depth_m, truth_m, output.uncertainty_m, strict=True):
        valid = truth > 0
        if valid.any():
            error = (depth - truth)[valid].detach().numpy() / 10
            b = scale[valid].detach().numpy() / 10
            mse = np.mean(error**2)
            rows.append(
                (mse, np.sqrt(mse), np.mean(abs(error)), np.mean(abs(error) / b + np.log(b)))
            )
    expected = np.mean(rows, axis=0) if rows else np.zeros(4)
    terms = [found.mse, found.rmse, found.l1, found.uncertainty]
    np.testing.assert_allclose([term.item() for term in terms], expected, rtol=1e-9)
    assert found.total.item() == pytest.approx(np.dot(expected, (0.7, 0.6, 0.5, 0.3)))


@given(st.integers(0, 2**31), sizes, densities)
def test_weights_count_pixels_and_large_errors_cost_up_to_fourfold(seed, shape, density):
    truth_m = batch_of(*(random_map(seed + index, shape, density) for index in range(2)))
    output = random_output(seed, truth_m)
    generator = torch.Generator().manual_seed(seed)
    weight = torch.rand(truth_m.shape, generator=generator, dtype=torch.float64)
    weight = torch.where(weight < 0.3, 0.0, weight)
    config = DepthLossConfig(
        mse=0.0, rmse=0.0, l1=0.5, rising_l1=2.0, emd=0.0, uncertainty=0.3, unit_m=4.0
    )
    found = depth_completion_loss(output, truth_m, config, step=0, weight=weight)
    l1, rising, likelihood_loss, images = 0.0, 0.0, 0.0, 0
    for image, truth in enumerate(truth_m[:, 0].tolist()):
        pixels = [(y, x) for y, row in enumerate(truth) for x, true in enumerate(row) if true > 0]
        images += bool(pixels)
        total = sum(weight[image, 0, y, x].item() for y, x in pixels) or 1.0
        for y, x in pixels:
            share = weight[image, 0, y, x].item() / total
            error = abs(output.depth_m[image, 0, y, x].item() - truth[y][x])
            scale = output.uncertainty_m[image, 0, y, x].item() / 4
            l1 += share * error / 4
            rising += share * (error + error**2 / (3 + 0.3 * error)) / 4
            likelihood_loss += share * (error / 4 / scale + np.log(scale))
    terms = [each / max(images, 1) for each in (l1, rising, likelihood_loss)]
    np.testing.assert_allclose(
        [found.l1.item(), found.rising_l1.item(), found.uncertainty.item()], terms, rtol=1e-9
    )
    expected = 0.5 * terms[0] + 2 * terms[1] + 0.3 * terms[2]
    np.testing.assert_allclose(found.total.item(), expected, rtol=1e-9)


@given(st.integers(0, 2**31), sizes, densities)
def test_dense_truth_counts_beside_the_rings_and_tells_the_uncertainty(seed, shape, density):
    truth_m = batch_of(*(random_map(seed + index, shape, density) for index in range(3)))
    dense_m = batch_of(*(random_map(seed + index, shape, density) for index in (7, 8, 9)))
    output = random_output(seed, truth_m)
    config = DepthLossConfig(unit_m=10.0, **{**NO_TERMS, **DENSE_TERMS})
    found = depth_completion_loss(output, truth_m, config, step=0, dense_truth_m=dense_m)
    rows = []
    for depth, truth, scale in zip(output.depth_m, dense_m, output.uncertainty_m, strict=True):
        valid = truth > 0
        if valid.any():
            given, true = depth[valid].detach().numpy(), truth[valid].numpy()
            error, b = abs(given - true) / 10, scale[valid].detach().numpy() / 10
            logarithm = np.log(np.maximum(given / true, 0.01))
            rows.append((error.mean(), abs(logarithm).mean(), np.mean(error / b + np.log(b))))
    expected = np.mean(rows, axis=0) if rows else np.zeros(3)
    terms = [found.dense_l1, found.dense_relative, found.uncertainty]
    np.testing.assert_allclose([term.item() for term in terms], expected, rtol=1e-5)
    assert found.total.item() == pytest.approx(np.dot(expected, (0.8, 0.9, 0.3)), rel=1e-5)


def test_a_depth_of_zero_or_less_costs_no_more_than_a_hundredth_of_the_true_one():
    truth_m = torch.full((1, 1, 2, 2), 20.0)
    truth_m[..., 1, 1] = 0  # no truth there
    depth_m = torch.tensor([[[[0.0, -5.0], [0.2, 0.0]]]], requires_grad=True)
    config = DepthLossConfig(**{**NO_TERMS, "dense_relative": 1.0})
    output = depth_only(depth_m)
    found = depth_completion_loss(output, truth_m * 0, config, step=0, dense_truth_m=truth_m)
    assert found.total.item() == pytest.approx(np.log(100))
    found.total.backward()
    assert depth_m.grad.isfinite().all()


@settings(max_examples=50)
@given(
    st.integers(0, 2**31),
    sizes,
    st.sampled_from([0.0, 0.05, 1.0]),
    st.integers(2, 9),
    st.integers(0, 1),
    st.sampled_from(["repeated", "literal"]),
)
def test_tile_emd_is_scipys_wasserstein_distance_of_each_tile(
    seed, shape, density, tile_px, step, variant
):
    expansion = ExpansionConfig(variant=variant, literal_px=3)
    truth_m = batch_of(random_map(seed, shape, density), random_map(seed + 1, shape, 0.5))
    output = random_output(seed, truth_m)
    config = {"emd_tile_px": tile_px, "unit_m": 1.0, "expansion": expansion}
    found = losses(output, truth_m, step=step, **config).emd.item()
    expanded = expand_depth(truth_m, expansion)[:, 0].numpy()
    expected = [
        reference.tile_emd(
            p[0].detach().numpy(), q, tile_px=tile_px, offset_px=tile_px // 2 if step else 0
        )
        for p, q in zip(output.e_point_m, expanded, strict=True)
        if q.any()
    ]
    assert found == pytest.approx(np.mean(expected) if expected else 0.0, abs=1e-9)


@given(st.integers(0, 2**31), sizes)
def test_global_emd_is_scipys_wasserstein_distance_of_whole_images(seed, shape):
    truth_m = batch_of(random_map(seed, shape, 1.0), random_map(seed + 1, shape, 1.0))
    output = random_output(seed, truth_m)
    found = losses(output, truth_m, emd_kind="global", unit_m=1.0).emd.item()
    expanded = expand_depth(truth_m)[:, 0].numpy()
    whole = [
        reference.tile_emd(p[0].detach().numpy(), q, tile_px=100, offset_px=0)
        for p, q in zip(output.e_point_m, expanded, strict=True)
    ]
    assert found == pytest.approx(np.mean(whole))


def test_a_mirrored_map_has_no_global_emd_but_one_in_tiles():
    truth_m = batch_of(np.tile(np.linspace(5, 50, 128, dtype=np.float32), (64, 1)))
    mirrored = e_point_only(expand_depth(truth_m).flip(-1))
    assert losses(mirrored, truth_m, emd_kind="global").emd.item() == pytest.approx(0.0, abs=1e-12)
    # two tiles, whose means of 16 and 39 m are exchanged
    assert losses(mirrored, truth_m, unit_m=1.0).emd.item() == pytest.approx(22.7, abs=0.1)


def test_tiles_lie_half_a_tile_further_on_odd_steps():
    truth_m = torch.full((1, 1, 8, 8), 10.0)
    truth_m[..., 4:] = 20.0
    swapped = truth_m.clone()
    swapped[..., 3], swapped[..., 4] = 20.0, 10.0
    config = {"emd_tile_px": 4, "unit_m": 1.0, "expansion": ExpansionConfig(median_px=1)}
    even = [
        losses(e_point_only(swapped), truth_m, step=step, **config).emd.item() for step in (0, 2)
    ]
    odd = [
        losses(e_point_only(swapped), truth_m, step=step, **config).emd.item() for step in (1, 3)
    ]
    assert even == [2.5, 2.5]  # one column in four is 10 m off in each tile
    assert odd == [0.0, 0.0]  # both columns lie in one tile


@pytest.mark.parametrize("emd_kind", ["tiles", "global"])
def test_gradients_equal_finite_differences(emd_kind):
    truth_m = batch_of(random_map(1, (4, 5), 0.5), random_map(2, (4, 5), 0.2), np.zeros((4, 5)))
    maps = random_output(3, truth_m)
    config = DepthLossConfig(**{**ALL_TERMS, "uncertainty": 0.0}, emd_kind=emd_kind, emd_tile_px=3)

    def total(depth_m, e_point_m):
        output = DepthCompletionOutput(depth_m, None, e_point_m)
        return depth_completion_loss(output, truth_m, config, step=1).total

    assert torch.autograd.gradcheck(total, (maps.depth_m, maps.e_point_m))

    def calibration(uncertainty_m):
        output = DepthCompletionOutput(maps.depth_m.detach(), uncertainty_m, None)
        only = DepthLossConfig(**{**NO_TERMS, "uncertainty": 1.0})
        return depth_completion_loss(output, truth_m, only, step=0).total

    assert torch.autograd.gradcheck(calibration, (maps.uncertainty_m,))


def test_the_uncertainty_term_leaves_the_depth_alone_and_is_lowest_at_the_mean_error():
    truth_m = torch.full((1, 1, 2, 2), 20.0, dtype=torch.float64)
    depth_m = (truth_m + torch.tensor([[[[1.0, -3.0], [2.0, -2.0]]]])).requires_grad_()
    scale_m = torch.full((1,), 2.0, dtype=torch.float64, requires_grad=True)  # the mean |error|
    output = DepthCompletionOutput(depth_m, scale_m.expand(1, 1, 2, 2), None)
    losses(output, truth_m, **{**NO_TERMS, "uncertainty": 1.0}).total.backward()
    assert scale_m.grad.item() == pytest.approx(0.0, abs=1e-12)
    assert not depth_m.grad.any()


def test_an_exact_depth_has_zero_loss_and_finite_gradients():
    truth_m = batch_of(random_map(5, (20, 20), 0.3))
    depth_m = truth_m.clone().requires_grad_()
    e_point_m = expand_depth(truth_m).requires_grad_()
    output = DepthCompletionOutput(depth_m, None, e_point_m)
    total = losses(output, truth_m, **{**ALL_TERMS, "uncertainty": 0.0}).total
    total.backward()
    assert total.item() == 0.0
    assert not depth_m.grad.any()
    assert e_point_m.grad.isfinite().all()


def test_a_batch_without_truth_has_loss_0_and_gradient_0():
    truth_m = torch.zeros(2, 1, 10, 10)
    output = random_output(0, truth_m)
    found = losses(output, truth_m, **ALL_TERMS)
    assert [term.item() for term in found] == [0.0] * len(found)
    found.total.backward()
    assert all(one.grad is None or not one.grad.any() for one in output)
    assert output.depth_m.grad is not None


def test_an_image_without_truth_changes_nothing():
    with_truth = batch_of(random_map(1, (12, 12), 0.3))
    truth_m = torch.cat((with_truth, torch.zeros_like(with_truth)))
    output = random_output(4, truth_m)
    first = DepthCompletionOutput(*(one[:1] for one in output))
    assert losses(output, truth_m, **ALL_TERMS) == losses(first, with_truth, **ALL_TERMS)


def test_outputs_that_a_network_does_not_have_cost_nothing():
    truth_m = batch_of(random_map(1, (12, 12), 0.3))
    found = losses(depth_only(truth_m + 1), truth_m, **ALL_TERMS)
    assert found.emd.item() == found.uncertainty.item() == 0.0
    assert found.l1.item() == pytest.approx(1 / 85)


def test_terms_of_weight_0_are_not_calculated(monkeypatch):
    def refuse(*_):
        pytest.fail("the ground truth was expanded")

    monkeypatch.setattr(loss_module, "expand_depth", refuse)
    truth_m = batch_of(random_map(1, (12, 12), 0.3))
    found = losses(random_output(0, truth_m), truth_m, **{**NO_TERMS, "l1": 2.0})
    assert found.mse.item() == found.rmse.item() == found.emd.item() == 0.0
    assert found.uncertainty.item() == 0.0
    assert found.total.item() == 2 * found.l1.item() > 0


def test_half_precision_outputs_are_summed_in_single_precision():
    truth_m = torch.full((1, 1, 64, 64), 20.0)
    output = depth_only(torch.full((1, 1, 64, 64), 21.0, dtype=torch.bfloat16))
    found = losses(output, truth_m, unit_m=1.0)
    assert found.mse.dtype == torch.float32
    assert found.mse.item() == found.rmse.item() == 1.0


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"l1": -1.0}, "weight of l1 must be finite and not negative, got -1.0"),
        ({"emd": float("nan")}, "weight of emd"),
        ({"emd_tile_px": 1}, "emd_tile_px must be at least 2, got 1"),
        ({"unit_m": 0.0}, "unit_m must be positive and finite, got 0.0"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(config, message):
    with pytest.raises(ValueError, match=message):
        DepthLossConfig(**config)
