import pytest
import torch

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.objects import Objects
from sightline.structures.predictions import Perception


def three_objects(**changed):
    """Objects with both boxes, with a 3D box alone, and with an image box alone."""
    boxes2d = torch.tensor([[1.0, 2.0, 30.0, 20.0], [torch.nan] * 4, [5.0, 5.0, 9.0, 9.0]])
    boxes3d = torch.tensor([[9.0, 1, -1, 4, 2, 1.5, 0.5], [5.0, 9, -1, 4, 2, 1.5, 0], [0.0] * 7])
    columns = {
        "class_names": ("Car", "Car", "Cyclist"),
        "boxes2d": Boxes2D(boxes2d.double()),
        "boxes3d": Boxes3D(boxes3d.double()),
        "origins": ("measured", "measured", "none"),
        "scores": torch.tensor([0.9, 0.5, 0.25]).double(),
        "scores3d": torch.tensor([0.75, 0.5, 0.0]).double(),
        "image_support": torch.tensor([0.5, 0.0, 0.25]).double(),
        "lidar_support": torch.tensor([0.5, 0.5, 0.0]).double(),
        "num_points": torch.tensor([100, 5, 0]),
    }
    return Objects(**(columns | changed))


def test_a_missing_box_is_null_in_json_and_unset_in_its_mask():
    objects = three_objects()
    assert objects.has_box2d.tolist() == [True, False, True]
    assert objects.has_box3d.tolist() == [True, True, False]
    first, second, third = objects.to_json()
    assert first == {
        "class": "Car",
        "score": 0.9,
        "box_px": [1.0, 2.0, 30.0, 20.0],
        "box_3d": {
            "center_m": [9.0, 1.0, -1.0],
            "size_m": [4.0, 2.0, 1.5],
            "yaw_rad": 0.5,
            "score": 0.75,
            "origin": "measured",
        },
        "support": {"image": 0.5, "lidar": 0.5, "points": 100},
    }
    assert second["box_px"] is None
    assert third["box_3d"] is None


def test_selected_objects_keep_all_their_columns():
    kept = three_objects().select(torch.tensor([2, 0]))
    assert kept.class_names == ("Cyclist", "Car")
    assert kept.origins == ("none", "measured")
    assert kept.num_points.tolist() == [0, 100]
    assert kept.boxes2d.tensor[:, 0].tolist() == [5.0, 1.0]
    assert kept.boxes3d.tensor[:, 0].tolist() == [0.0, 9.0]


def test_objects_are_filtered_by_score_as_part_of_a_perception():
    kept = Perception(objects=three_objects()).filter_by_score(0.5)
    assert kept.objects.scores.tolist() == [pytest.approx(0.9), 0.5]


@pytest.mark.parametrize("min_score", [30.0, -0.1, float("nan")])
def test_scores_of_objects_are_probabilities_so_other_thresholds_are_refused(min_score):
    with pytest.raises(ValueError, match=f"min_score must be from 0 to 1, got {min_score}"):
        three_objects().filter_by_score(min_score)


def test_no_objects_are_an_empty_list_and_win_over_objects_of_a_later_part():
    joined = Perception.joined([Perception(objects=Objects.from_json([])), Perception()])
    assert len(joined.objects) == 0
    assert joined.to_json()["objects"] == []
    assert next(iter(joined.to_json())) == "objects"


def test_columns_of_other_lengths_are_refused():
    with pytest.raises(ValueError, match=r"need columns of one length, got .*'origins': 2"):
        three_objects(origins=("measured", "none"))


def test_an_unknown_origin_is_refused():
    with pytest.raises(ValueError, match="origins may be measured, refined, lifted, none"):
        three_objects(origins=("measured", "guessed", "none"))


def test_objects_come_back_from_json_rounded():
    rows = three_objects().to_json()
    again = Objects.from_json(rows)
    assert again.to_json() == rows
    assert again.has_box2d.tolist() == [True, False, True]
    assert again.has_box3d.tolist() == [True, True, False]
    assert again.origins == ("measured", "measured", "none")
    assert Objects.from_json(Objects.from_json([]).to_json()).to_json() == []
