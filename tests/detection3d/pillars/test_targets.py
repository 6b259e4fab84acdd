"""Heat and predicted boxes against a walk over all cells."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.pillars.config import PillarGridConfig, PillarTargetsConfig
from sightline.detection3d.pillars.training import pillar_targets
from sightline.detection3d.sweeps import SweepTruth
from tests.reference import compact3d as reference

GRID = PillarGridConfig(x_m=(2.0, 10.0), y_m=(-4.0, 4.0), cell_m=0.25)
CONFIG = PillarTargetsConfig()
place = st.integers(-8, 48).map(lambda number: number / 4 + 0.03)  # some outside
side = st.integers(-24, 24).map(lambda number: number / 4 - 0.04)
box = st.tuples(
    place, side, st.just(0.0), st.sampled_from([0.8, 4.0]), st.sampled_from([0.7, 1.8]),
    st.just(1.5), st.sampled_from([0.0, 0.31, 1.5, -2.0]),
)  # fmt: skip


def scene(boxes=(), classes=(), ignored=(), ignored_classes=()):
    return SweepTruth(
        boxes=torch.tensor(boxes, dtype=torch.float64).reshape(-1, 7),
        classes=torch.tensor(classes, dtype=torch.int64),
        ignored_boxes=torch.tensor(ignored, dtype=torch.float64).reshape(-1, 7),
        ignored_classes=torch.tensor(ignored_classes, dtype=torch.bool).reshape(-1, 2),
    )


@given(entries=st.lists(st.tuples(box, st.integers(0, 1)), max_size=4))
def test_heat_and_told_boxes_are_what_a_walk_over_all_cells_finds(entries):
    boxes, classes = [entry[0] for entry in entries], [entry[1] for entry in entries]
    targets = pillar_targets([scene(), scene(boxes, classes)], 2, GRID, CONFIG)
    rows = {tuple(cell): k for k, cell in enumerate(targets.cells.tolist())}
    assert not targets.heat[0].any()
    assert len(rows) == len(targets.cells) == len(targets.boxes) == len(targets.weights)
    expected_number = 0
    for index in range(2):
        mine = [entry for entry, of_class in entries if of_class == index]
        heat, owners = reference.pillar_targets(mine, GRID, CONFIG)
        expected = torch.zeros(GRID.head_size)
        for cell, warmth in heat.items():
            expected[cell] = warmth
        torch.testing.assert_close(targets.heat[1, index], expected, atol=4e-4, rtol=0)
        assert torch.equal(targets.heat[1, index] == 1, expected == 1)
        expected_number += len(owners)
        for cell, owner in owners.items():
            k = rows[1, index, *cell]
            assert targets.boxes[k].tolist() == pytest.approx(owner)
            same = sum(1 for other in owners.values() if other == owner)
            twins = mine.count(owner)
            assert targets.weights[k].item() == pytest.approx(1 / same) or twins > 1
    assert expected_number == len(rows)


@given(ignored=box, of_classes=st.tuples(st.booleans(), st.booleans()), outside=st.booleans())
def test_heat_does_not_count_in_ignored_boxes_and_those_with_their_centre_outside(
    ignored, of_classes, outside
):
    found = (1.9, 0.2, 0.0, 4.0, 1.8, 1.5, 0.3)  # its centre is before the grid
    boxes, classes = ([found], [1]) if outside else ([], [])
    targets = pillar_targets([scene(boxes, classes, [ignored], [of_classes])], 2, GRID, CONFIG)
    for index in range(2):
        expected = set()
        if of_classes[index]:
            expected |= reference.ignored_cells(ignored, GRID, CONFIG.ignored_margin_m)
        if outside and index == 1:
            expected |= reference.ignored_cells(found, GRID, CONFIG.ignored_margin_m)
        uncounted = {tuple(cell) for cell in (~targets.counts[0, index]).nonzero().tolist()}
        assert uncounted == expected
    assert len(targets.cells) == 0


def test_a_centre_counts_whatever_is_ignored_over_it():
    car = (5.0, 0.0, 0.0, 4.0, 1.8, 1.5, 0.0)
    targets = pillar_targets([scene([car], [0], [car], [(True, True)])], 2, GRID, CONFIG)
    assert targets.counts[0, 0, 6, 8]
    assert targets.heat[0, 0, 6, 8] == 1
    assert not targets.counts[0, 1, 6, 8]


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match="heat_share must be above 0 and at most 1, got 0"):
        PillarTargetsConfig(heat_share=0.0)
    with pytest.raises(ValueError, match="ignored_margin_m must be finite and not negative"):
        PillarTargetsConfig(ignored_margin_m=-1.0)
