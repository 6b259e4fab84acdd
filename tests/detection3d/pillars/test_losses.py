"""The first stage's losses against plain numbers."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.classes import CAR, PEDESTRIAN
from sightline.detection3d.pillars.boxes import (
    CENTER_VALUES,
    PillarOutput,
    corner_costs,
    encode_centers,
)
from sightline.detection3d.pillars.config import (
    PillarGridConfig,
    PillarLossConfig,
    PillarNetworkConfig,
)
from sightline.detection3d.pillars.training import PillarTargets, heat_loss, pillar_loss
from tests.reference import compact3d as reference

NETWORK = PillarNetworkConfig(
    classes=(CAR, PEDESTRIAN), grid=PillarGridConfig(x_m=(0.0, 8.0), y_m=(-4.0, 4.0), cell_m=0.5)
)
number = st.integers(-12, 12).map(lambda step: step / 4)
size = st.sampled_from([0.5, 1.0, 4.0])
box = st.tuples(number, number, number, size, size, size, number)


@given(
    cells=st.lists(
        st.tuples(st.floats(-6, 6), st.sampled_from([0.0, 0.3, 0.99, 1.0]), st.booleans()),
        min_size=1,
        max_size=6,
    )
)
def test_heat_counts_as_the_focal_loss_says_where_it_is_known(cells):
    logits, heat, counts = ([cell[k] for cell in cells] for k in range(3))
    given, target = (torch.tensor(each, dtype=torch.float64) for each in (logits, heat))
    loss = heat_loss(given, target, torch.tensor(counts))
    assert loss.item() == pytest.approx(reference.heat_loss(logits, heat, counts), abs=1e-9)


@given(predicted=box, target=box, knee=st.sampled_from([0.05, 1.0]))
def test_corners_are_compared_with_the_box_that_faces_the_nearer_way(predicted, target, knee):
    rows = [torch.tensor([each], dtype=torch.float64) for each in (predicted, target)]
    cost = corner_costs(*rows, knee_m=knee)
    assert cost.item() == pytest.approx(reference.corner_cost(predicted, target, knee), abs=1e-9)


def targets_of(cells, boxes, weights, heat=None):
    shape = (1, 2, *NETWORK.grid.head_size)
    return PillarTargets(
        heat=torch.zeros(shape) if heat is None else heat,
        counts=torch.ones(shape, dtype=torch.bool),
        cells=torch.tensor(cells, dtype=torch.int64).reshape(-1, 4),
        boxes=torch.tensor(boxes).reshape(-1, 7).float(),
        weights=torch.tensor(weights),
    )


def random_output(seed):
    generator = torch.Generator().manual_seed(seed)
    size = NETWORK.grid.head_size
    return PillarOutput(
        torch.randn(1, 2, *size, generator=generator).requires_grad_(),
        (0.3 * torch.randn(1, 2, CENTER_VALUES, *size, generator=generator)).requires_grad_(),
    )


@given(seed=st.integers(0, 99))
def test_told_boxes_cost_by_their_cells_and_objects_count_alike(seed):
    cells = [(0, 0, 2, 3), (0, 0, 2, 4), (0, 1, 6, 1)]
    car = (2.3, -0.4, -1.0, 4.2, 1.7, 1.5, 2.5)
    walker = (6.6, -2.4, -0.8, 0.8, 0.7, 1.8, -0.4)
    boxes, weights = [car, car, walker], [0.5, 0.5, 1.0]
    output = random_output(seed)
    losses = pillar_loss(output, targets_of(cells, boxes, weights), NETWORK, PillarLossConfig())
    box_loss = front = 0.0
    for (_, of_class, row, column), target, weight in zip(cells, boxes, weights, strict=True):
        values = output.center_values[0, of_class, :, row, column].tolist()
        mean = NETWORK.classes[of_class].mean_size_m
        code = reference.center_values(target, row + 0.5, column + 0.5 - 4, mean)
        errors = [given - expected for given, expected in zip(values, code, strict=False)]
        box_loss += weight / 2 * sum(reference.smooth_l1(error, 0.05) for error in errors[:8])
        front += weight / 2 * sum(error**2 for error in errors[8:10])
    assert losses.box.item() == pytest.approx(box_loss, rel=1e-4)
    assert losses.front.item() == pytest.approx(front, rel=1e-4)
    total = losses.heat + losses.box + 2 * losses.corners
    total = total + 2 * losses.front + 0.3 * losses.quality
    assert losses.total.item() == pytest.approx(total.item(), rel=1e-5)


def test_the_right_box_costs_nothing_but_its_quality():
    car = (2.3, -0.4, -1.0, 4.2, 1.7, 1.5, 2.5)
    output = random_output(0)
    middle = torch.tensor([[2.5, -0.5]])
    code = encode_centers(torch.tensor([car]), middle, torch.tensor([CAR.mean_size_m]))
    values = output.center_values.detach()
    values[0, 0, :10, 2, 3] = code[0]
    values[0, 0, 10, 2, 3] = 20.0
    losses = pillar_loss(
        PillarOutput(output.heat_logits, values),
        targets_of([(0, 0, 2, 3)], [car], [1.0]),
        NETWORK,
        PillarLossConfig(),
    )
    parts = [losses.box, losses.corners, losses.front, losses.quality]
    assert [part.item() for part in parts] == pytest.approx([0, 0, 0, 0], abs=1e-5)


def test_without_objects_only_heat_costs_and_teaches():
    output = random_output(1)
    losses = pillar_loss(output, targets_of([], [], []), NETWORK, PillarLossConfig())
    losses.total.backward()
    assert losses.total.item() == losses.heat.item() > 0
    assert [part.item() for part in losses[2:]] == [0, 0, 0, 0]
    assert output.heat_logits.grad.abs().max() > 0
    assert not output.center_values.grad.any()


def test_the_gradient_is_finite_and_the_quality_teaches_no_box():
    output = random_output(2)
    car = (2.3, -0.4, -1.0, 4.2, 1.7, 1.5, math.pi / 2)
    losses = pillar_loss(
        output, targets_of([(0, 0, 2, 3)], [car], [1.0]), NETWORK, PillarLossConfig()
    )
    losses.quality.backward(retain_graph=True)
    assert output.center_values.grad.nonzero().tolist() == [[0, 0, 10, 2, 3]]
    losses.total.backward()
    assert output.center_values.grad.isfinite().all()


def test_a_weight_out_of_range_is_refused():
    with pytest.raises(ValueError, match="corner_weight must be finite and not negative, got -1"):
        PillarLossConfig(corner_weight=-1.0)
    with pytest.raises(ValueError, match="knee must be positive and finite, got 0"):
        PillarLossConfig(knee=0.0)
