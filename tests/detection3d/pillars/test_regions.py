"""What the second stage sees of proposals, point by point."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.classes import CAR, PEDESTRIAN
from sightline.detection3d.pillars.region_config import RegionConfig
from sightline.detection3d.pillars.regions import cut_regions
from tests.reference import compact3d as reference
from tests.reference.geometry import box_contains

CONFIG = RegionConfig(classes=(CAR, PEDESTRIAN), num_points=16, in_channels=1)
step = st.integers(-8, 8).map(lambda number: number / 2 + 0.01)
box = st.tuples(
    step, step, st.just(0.1), st.sampled_from([1.0, 4.0]), st.just(1.7), st.just(1.5),
    st.sampled_from([0.0, 0.7, -2.0]),
)  # fmt: skip


def exact(rows, columns):
    return torch.tensor(rows, dtype=torch.float64).reshape(-1, columns)


def cut(points, boxes, classes, config=CONFIG):
    features = torch.arange(len(points), dtype=torch.float64)[:, None] + 1
    return cut_regions(
        exact(points, 3),
        features,
        exact(boxes, 7),
        torch.tensor(classes, dtype=torch.int64),
        config,
        seed=3,
    )


@given(
    points=st.lists(st.tuples(step, step, st.sampled_from([0.0, 0.9, 5.0])), max_size=12),
    boxes=st.lists(box, min_size=1, max_size=3),
)
def test_a_region_holds_its_points_in_the_frame_of_the_box_and_their_distances_to_its_faces(
    points, boxes
):
    regions = cut(points, boxes, [k % 2 for k in range(len(boxes))])
    for k, each in enumerate(boxes):
        margins = [2 * margin for margin in CONFIG.margin_m]
        sizes = [size + margin for size, margin in zip(each[3:6], margins, strict=True)]
        around = (*each[:3], *sizes, each[6])
        expected = set()
        for index, point in enumerate(points):
            if box_contains(around, point):
                place = reference.in_frame_of(each, point)
                faces = [half / 2 - at for half, at in zip(each[3:6], place, strict=True)]
                faces += [half / 2 + at for half, at in zip(each[3:6], place, strict=True)]
                expected.add(tuple(round(v, 6) + 0.0 for v in (*place, *faces, index + 1)))
        seen = {tuple(round(v, 6) + 0.0 for v in row) for row in regions.points[k].tolist()}
        assert seen == (expected or {(0.0,) * 10})
        bearing = math.atan2(each[1], each[0]) - each[6]
        mean = CONFIG.classes[k % 2].mean_size_m
        assert regions.context[k].tolist() == pytest.approx(
            [
                *(math.log(size / usual) for size, usual in zip(each[3:6], mean, strict=True)),
                math.hypot(each[0], each[1]) / 40,
                math.cos(bearing),
                math.sin(bearing),
                math.log(1 + len(expected)) / 4,
                float(k % 2 == 0),
                float(k % 2 == 1),
            ],
            abs=1e-6,
        )


def test_turning_everything_about_the_sensor_changes_nothing():
    generator = torch.Generator().manual_seed(0)
    points = 4 * torch.rand(200, 3, generator=generator).double() - 2
    boxes = exact([(0.3, 0.5, 0.1, 3.0, 1.5, 1.5, 0.4)], 7)
    turn = torch.tensor(1.1).double()
    rotation = torch.tensor([[turn.cos(), -turn.sin(), 0], [turn.sin(), turn.cos(), 0], [0, 0, 1]])
    turned = boxes.clone()
    turned[:, :3] = boxes[:, :3] @ rotation.double().T
    turned[:, 6] += turn
    classes, features = torch.tensor([0]), points[:, :1]
    straight = cut_regions(points, features, boxes, classes, CONFIG, seed=1)
    around = cut_regions(points @ rotation.double().T, features, turned, classes, CONFIG, seed=1)
    torch.testing.assert_close(around.points, straight.points, atol=1e-6, rtol=0)
    torch.testing.assert_close(around.context, straight.context, atol=1e-6, rtol=0)


def test_no_proposals_give_no_regions_and_no_points_give_empty_ones():
    assert cut([(0.0, 0.0, 0.0)], [], []).points.shape == (0, 16, 10)
    empty = cut([], [(1.0, 0, 0, 4, 2, 1.5, 0)], [1])
    assert not empty.points.any()
    assert empty.context[0, 6] == 0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"classes": (CAR, CAR)}, "classes must hold one or more different ones"),
        ({"margin_m": (0.1, -0.1, 0.0)}, "margin_m must be from 0 to 100, got"),
        (
            {"num_points": 0},
            "num_points must be from 1 to 16384, got 0",
        ),
        ({"point_widths": ()}, "point_widths must hold one positive width a layer, got"),
        ({"margin_m": (1e9, 0.6, 0.4)}, "margin_m must be from 0 to 100, got"),
        ({"num_points": 10**6}, "num_points must be from 1 to 16384, got 1000000"),
        ({"region_width": 0}, "region_width must be at least 1, got 0"),
    ],
)
def test_settings_out_of_range_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        RegionConfig(**wrong)
