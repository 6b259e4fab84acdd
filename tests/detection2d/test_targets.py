import pytest
import torch

from sightline.detection2d.targets import TargetConfig, covered_shares, make_targets
from tests.detection2d.frames import labels
from tests.reference import ssd as reference

ROWS = [
    ("Car", 0.0, 0.0, 40.0, 30.0),
    ("Van", 10.0, 0.0, 50.0, 40.0),
    ("Cyclist", 5.0, 5.0, 9.0, 25.0),
    ("Tram", 0.0, 0.0, 90.0, 90.0),
    ("DontCare", 60.0, 0.0, 80.0, 20.0),
    ("Person_sitting", 1.0, 1.0, 12.0, 20.0),
]


def test_ours_are_found_neighbours_ignored_for_one_class_and_dont_care_for_all():
    found = make_targets(labels(ROWS), TargetConfig())
    assert found.boxes.tolist() == [list(ROWS[0][1:]), list(ROWS[2][1:])]
    assert found.class_indices.tolist() == [0, 2]
    assert found.ignored_boxes.tolist() == [list(ROWS[index][1:]) for index in (1, 4, 5)]
    assert found.ignored_classes.int().tolist() == [[1, 0, 0], [1, 1, 1], [0, 1, 0]]


def test_a_neighbour_that_is_not_named_is_nothing():
    found = make_targets(labels(ROWS), TargetConfig(ignored_names=("Van",)))
    assert found.ignored_boxes.tolist() == [list(ROWS[index][1:]) for index in (1, 4)]


@pytest.mark.parametrize(
    ("settings", "columns"),
    [
        ({"min_height_px": 31.0}, {}),
        ({"min_width_px": 41.0}, {}),
        ({"max_truncation": 0.4}, {"truncation": torch.full((1,), 0.5, dtype=torch.float64)}),
        ({"max_occlusion": 1}, {"occlusion": torch.full((1,), 2)}),
    ],
)
def test_what_can_hardly_be_seen_is_ignored_for_its_own_class(settings, columns):
    car = labels([ROWS[0]], **columns)
    assert len(make_targets(car, TargetConfig()).boxes) == 1
    found = make_targets(car, TargetConfig(**settings))
    assert len(found.boxes) == 0
    assert found.ignored_boxes.tolist() == [list(ROWS[0][1:])]
    assert found.ignored_classes.int().tolist() == [[1, 0, 0]]


def test_a_frame_without_objects_has_no_targets():
    found = make_targets(labels([]), TargetConfig())
    assert found.boxes.shape == found.ignored_boxes.shape == (0, 4)
    assert found.ignored_classes.shape == (0, 3)


def test_shares_of_boxes_in_regions_are_those_of_plain_arithmetic():
    generator = torch.Generator().manual_seed(0)
    low = torch.randint(0, 9, (2, 20, 2), generator=generator).float()
    boxes = torch.cat((low, low + torch.randint(0, 9, (2, 20, 2), generator=generator)), dim=2)
    expected = [
        [reference.covered(box, region) for region in boxes[1].tolist()]
        for box in boxes[0].tolist()
    ]
    torch.testing.assert_close(covered_shares(boxes[0], boxes[1]), torch.tensor(expected))


def test_names_that_have_no_neighbour_are_refused():
    with pytest.raises(
        ValueError, match="ignored_names may hold Van, Truck, Person_sitting, got C"
    ):
        TargetConfig(ignored_names=("Van", "Car"))
