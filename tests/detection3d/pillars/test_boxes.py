"""Boxes from heat: which cells give one, what becomes of their neighbours, and how they rank."""

import math

import pytest
import torch

from sightline.detection3d.classes import CAR, PEDESTRIAN
from sightline.detection3d.pillars.boxes import (
    CENTER_VALUES,
    PillarOutput,
    encode_centers,
    find_boxes,
)
from sightline.detection3d.pillars.config import (
    PillarDetectionConfig,
    PillarGridConfig,
    PillarNetworkConfig,
)

NETWORK = PillarNetworkConfig(
    classes=(CAR, PEDESTRIAN), grid=PillarGridConfig(x_m=(0.0, 16.0), y_m=(-8.0, 8.0), cell_m=0.5)
)
WITHOUT_MEAN = PillarDetectionConfig(mean_iou=None)


def output_of(*cells):
    """Cells that tell boxes: class, row, column, heat, box, logit of the quality."""
    size = NETWORK.grid.head_size
    heat = torch.full((1, 2, *size), -20.0, dtype=torch.float64)
    values = torch.zeros(1, 2, CENTER_VALUES, *size, dtype=torch.float64)
    for of_class, row, column, warmth, box, quality in cells:
        heat[0, of_class, row, column] = math.log(warmth / (1 - warmth))
        middle = torch.tensor([[row + 0.5, column + 0.5 - 8]], dtype=torch.float64)
        mean = torch.tensor([NETWORK.classes[of_class].mean_size_m], dtype=torch.float64)
        rows = torch.tensor([box], dtype=torch.float64)
        values[0, of_class, :10, row, column] = encode_centers(rows, middle, mean)[0]
        values[0, of_class, 10, row, column] = quality
    return PillarOutput(heat, values)


def car(x, y=0.0, yaw=0.3, length=4.0):
    return [x, y, -1.0, length, 1.6, 1.5, yaw]


def test_cold_ground_gives_nothing():
    found = find_boxes(output_of(), 0, NETWORK, PillarDetectionConfig())
    assert (found.boxes.shape, found.classes.shape, found.scores.shape) == ((0, 7), (0,), (0,))


def test_a_cell_warmer_than_those_around_it_gives_its_box_and_class():
    walker = [4.2, -1.6, -0.9, 0.8, 0.7, 1.8, 0.3]
    output = output_of((1, 4, 6, 0.6, walker, 0.0), (1, 5, 6, 0.5, car(9.0, 5.0, length=2.0), 0.0))
    found = find_boxes(output, 0, NETWORK, WITHOUT_MEAN)
    torch.testing.assert_close(found.boxes, torch.tensor([walker], dtype=torch.float64))
    assert found.classes.tolist() == [1]


def test_the_score_is_a_product_of_powers_of_heat_and_iou():
    found = find_boxes(output_of((0, 4, 6, 0.64, car(4.0), 0.0)), 0, NETWORK, WITHOUT_MEAN)
    assert found.scores.item() == pytest.approx(math.sqrt(0.64 * 0.5))  # a quality of a half
    settings = PillarDetectionConfig(quality_share=0.0)
    heat_alone = find_boxes(output_of((0, 4, 6, 0.64, car(4.0), 0.0)), 0, NETWORK, settings)
    assert heat_alone.scores.item() == pytest.approx(0.64)


def test_of_two_boxes_of_a_class_in_one_place_the_better_rated_stays():
    cells = ((0, 4, 8, 0.7, car(5.0), -5.0), (0, 7, 8, 0.6, car(5.2), 5.0))
    found = find_boxes(output_of(*cells), 0, NETWORK, WITHOUT_MEAN)
    assert found.boxes[:, 0].tolist() == pytest.approx([5.2])
    other_class = (1, 7, 8, 0.6, car(5.2), 5.0)
    assert len(find_boxes(output_of(cells[0], other_class), 0, NETWORK, WITHOUT_MEAN).boxes) == 2


def test_a_box_is_the_mean_of_those_around_it_by_heat_and_rating():
    cells = [
        (0, 4, 8, 0.6, car(5.0, length=4.0, yaw=3.1), 50.0),
        (0, 5, 8, 0.3, car(5.3, length=4.3, yaw=-3.1), 50.0),  # turned by less than it seems
        (0, 4, 9, 0.2, car(5.3, yaw=0.0), -50.0),  # a ninth of the third, to the fourth
        (1, 4, 7, 0.1, car(9.0), 50.0),
        (0, 8, 8, 0.2, car(12.0), 50.0),  # elsewhere, so it is a box of its own
    ]
    found = find_boxes(output_of(*cells), 0, NETWORK, PillarDetectionConfig())
    weights = torch.tensor([0.6, 0.3, 0.2 / 81]).double()
    mean = (weights * torch.tensor([5.0, 5.3, 5.3])).sum() / weights.sum()
    assert found.boxes[0, 0].item() == pytest.approx(mean.item(), abs=1e-6)
    middle = math.pi - 0.0416 + 0.0832 / 3
    assert math.cos(found.boxes[0, 6].item() - middle) == pytest.approx(1, abs=1e-5)
    assert -math.pi <= found.boxes[0, 6] < math.pi


def test_the_front_is_where_most_of_them_have_it():
    cells = [
        (0, 4, 8, 0.5, car(5.0, yaw=0.2), 50.0),
        (0, 5, 8, 0.4, car(5.0, yaw=0.2 - math.pi), 50.0),
        (0, 4, 9, 0.4, car(5.0, yaw=0.2 - math.pi), 50.0),
    ]
    found = find_boxes(output_of(*cells), 0, NETWORK, PillarDetectionConfig())
    assert found.boxes[0, 6].item() == pytest.approx(0.2 - math.pi)


def test_no_more_cells_and_boxes_than_wanted():
    cells = [(0, 2 * k + 1, 8, 0.2 + 0.1 * k, car(4.0 * k), 0.0) for k in range(5)]
    few = PillarDetectionConfig(max_boxes=2, mean_iou=None)
    assert find_boxes(output_of(*cells), 0, NETWORK, few).boxes[:, 0].tolist() == [16, 12]
    few_cells = PillarDetectionConfig(max_cells=3, mean_iou=None)
    assert len(find_boxes(output_of(*cells), 0, NETWORK, few_cells).boxes) == 3


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match=r"min_heat must be from 0 to 1, got 1\.5"):
        PillarDetectionConfig(min_heat=1.5)
    with pytest.raises(ValueError, match="mean_iou must be None or from 0 to below 1, got 1"):
        PillarDetectionConfig(mean_iou=1.0)
    with pytest.raises(ValueError, match="max_cells must be at least 1, got 0"):
        PillarDetectionConfig(max_cells=0)
    with pytest.raises(ValueError, match="times max_boxes must be up to 33554432, got 1000000 t"):
        PillarDetectionConfig(max_cells=10**6)
