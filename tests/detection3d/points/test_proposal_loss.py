"""The loss of coded boxes against plain numbers."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.points.box_coding import encode_boxes, split_prediction
from sightline.detection3d.points.config import BoxCodingConfig, ProposalLossConfig
from sightline.detection3d.points.proposal_training import box_code_loss
from tests.reference.box_coding import cross_entropy
from tests.reference.proposals import smooth_l1

CODING = BoxCodingConfig(scope_m=1.0, heading_bins=3)


def coded(seed, count):
    generator = torch.Generator().manual_seed(seed)
    boxes = torch.randn(count, 7, generator=generator).double()
    boxes[:, 3:6] = boxes[:, 3:6].abs() + 1
    values = torch.randn(count, CODING.channels, generator=generator).double()
    nothing, ones = torch.zeros(count, 3).double(), torch.ones(count, 3).double()
    return values.requires_grad_(), encode_boxes(boxes, nothing, ones, CODING)


@given(seed=st.integers(0, 999), count=st.integers(1, 5))
def test_bins_count_by_cross_entropy_and_residuals_of_the_true_bins_by_smooth_l1(seed, count):
    values, target = coded(seed, count)
    prediction = split_prediction(values, CODING)
    losses = box_code_loss(prediction, target, ProposalLossConfig())
    center = heading = size = 0.0
    for k in range(count):
        for scores, residuals, true_bin, residual in (
            (prediction.x_bins, prediction.x_residuals, target.x_bin, target.x_residual),
            (prediction.y_bins, prediction.y_residuals, target.y_bin, target.y_residual),
        ):
            chosen = true_bin[k].item()
            center += cross_entropy(scores[k].tolist(), chosen)
            center += smooth_l1(residuals[k, chosen].item() - residual[k].item())
        center += smooth_l1(prediction.z_offset[k, 0].item() - target.z_offset[k].item())
        chosen = target.heading_bin[k].item()
        heading += cross_entropy(prediction.heading_bins[k].tolist(), chosen)
        error = prediction.heading_residuals[k, chosen] - target.heading_residual[k]
        heading += smooth_l1(error.item())
        errors = (prediction.size_residual[k] - target.size_residual[k]).tolist()
        size += sum(map(smooth_l1, errors)) / 3
    assert losses.center.item() == pytest.approx(center / count)
    assert losses.heading.item() == pytest.approx(heading / count)
    assert losses.size.item() == pytest.approx(size / count)
    assert losses.total.item() == pytest.approx((center + heading + 3 * size) / count)


def test_without_points_on_objects_it_is_0_and_so_is_the_gradient():
    values, target = coded(0, 0)
    loss = box_code_loss(split_prediction(values, CODING), target, ProposalLossConfig()).total
    loss.backward()
    assert loss.item() == 0
    assert values.grad.shape == (0, CODING.channels)


def test_a_weight_out_of_range_is_refused():
    with pytest.raises(ValueError, match="size_weight must be finite and not negative, got nan"):
        ProposalLossConfig(size_weight=float("nan"))
    with pytest.raises(ValueError, match="ignored_margin_m must be finite and not neg"):
        ProposalLossConfig(ignored_margin_m=-1.0)
