"""Rows of boxes, detections, objects and labels by number, numbers, slice or mask."""

from dataclasses import fields

import numpy as np
import pytest
import torch
from torch import Tensor

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.labels import ObjectLabels
from sightline.structures.objects import Objects
from sightline.structures.predictions import Detections2D, Detections3D

NAMES = ("Car", "Cyclist", "Pedestrian", "Car")
COLUMN = torch.arange(4, dtype=torch.float64) / 4
BOXES2D = Boxes2D(torch.arange(16).reshape(4, 4).float())
BOXES3D = Boxes3D(torch.arange(28).reshape(4, 7).float())

TABLES = (
    BOXES2D,
    BOXES3D,
    Detections2D(class_names=NAMES, boxes=BOXES2D, scores=COLUMN),
    Detections3D(class_names=NAMES, boxes=BOXES3D, scores=COLUMN),
    ObjectLabels(
        class_names=NAMES,
        boxes2d=BOXES2D,
        boxes3d=BOXES3D,
        truncation=COLUMN,
        occlusion=torch.arange(4),
        alpha=COLUMN,
    ),
    Objects(
        class_names=NAMES,
        boxes2d=BOXES2D,
        boxes3d=BOXES3D,
        origins=("measured", "refined", "lifted", "none"),
        scores=COLUMN,
        scores3d=COLUMN,
        image_support=COLUMN,
        lidar_support=COLUMN,
        num_points=torch.arange(4),
    ),
)

CHOICES = (
    (torch.tensor([True] * 4), [0, 1, 2, 3]),
    (torch.tensor([False, True, False, True]), [1, 3]),
    (np.array([False, True, True, False]), [1, 2]),
    ([True, False, False, True], [0, 3]),
    (torch.tensor([2, 3]), [2, 3]),
    (torch.tensor([3, 0], dtype=torch.int32), [3, 0]),
    (np.array([3, 0, 1])[::-1], [1, 0, 3]),
    ([2, 0], [2, 0]),
    (range(1, 3), [1, 2]),
    (slice(None, None, -2), [3, 1]),
    (2, [2]),
    (-1, [3]),
    (np.int64(1), [1]),
    (np.uint8(2), [2]),
    (np.array([1, 2], np.uint64), [1, 2]),
    (torch.tensor(3), [3]),
    ([], []),
    (torch.zeros(0, dtype=torch.int64), []),
)


def chosen(table, rows):
    return table[rows] if isinstance(table, Boxes2D | Boxes3D) else table.select(rows)


def row_of(column, number):
    return column.tensor[number] if isinstance(column, Boxes2D | Boxes3D) else column[number]


@pytest.mark.parametrize("table", TABLES, ids=lambda table: type(table).__name__)
@pytest.mark.parametrize(("rows", "numbers"), CHOICES)
def test_every_column_has_the_chosen_rows_in_their_order(table, rows, numbers):
    part = chosen(table, rows)
    for field in fields(table):
        column, whole = getattr(part, field.name), getattr(table, field.name)
        assert len(column) == len(numbers)
        for place, number in enumerate(numbers):
            kept, given = row_of(column, place), row_of(whole, number)
            assert torch.equal(kept, given) if isinstance(given, Tensor) else kept == given


@pytest.mark.parametrize("table", TABLES, ids=lambda table: type(table).__name__)
@pytest.mark.parametrize(
    ("rows", "error", "said"),
    [
        (torch.tensor([True]), ValueError, "the mask has 1 values, expected 4, one for each row"),
        (
            torch.tensor([1, 0, 1, 0], dtype=torch.uint8),
            ValueError,
            "expected a whole number, a li",
        ),
        (torch.tensor([1.0, 2.0]), ValueError, "expected a whole number, a list or a tensor"),
        (torch.tensor([[0, 1]]), ValueError, "expected a whole number, a list or a tensor"),
        ((0, 1), ValueError, r"rows are chosen by \(0, 1\), expected a whole number, a list"),
        ([4], IndexError, "there is no row 4: there are 4, from 0"),
        (-5, IndexError, "there is no row -5"),
    ],
)
def test_rows_that_are_no_choice_are_refused(table, rows, error, said):
    with pytest.raises(error, match=said):
        chosen(table, rows)
