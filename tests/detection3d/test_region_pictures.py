import numpy as np
import pytest
import torch

from sightline.detection3d.pictures import LABELLED, PROPOSED, RIGHT
from sightline.detection3d.points.config import ProposalSamplingConfig, RoiPoolingConfig
from sightline.detection3d.region_pictures import (
    _AROUND,
    _HARD,
    _INSIDE,
    DrawnRegion,
    pool_points,
    proposals_picture,
    region_picture,
    regions_legend,
)

BOX = (20.0, 3.0, -0.8, 4.0, 1.6, 1.5, 0.4)
POOLING = RoiPoolingConfig(num_points=32)


def pixels_of(picture, color):
    return int((np.abs(picture.astype(int) - color).max(axis=2) <= 12).sum())


def region(box=BOX):
    return DrawnRegion(sample_id="000007", box=box, score=0.9, iou=0.6, num_inside=40)


def test_points_are_pooled_from_the_enlarged_box_alone():
    points = torch.tensor([[20.0, 3.0, -0.8, 0.5], [20.0, 4.7, -0.8, 0.5], [30.0, 3.0, -0.8, 0.5]])
    boxes = torch.tensor([BOX, (60.0, *BOX[1:])])
    (near, empty), counts = pool_points(points, boxes, POOLING, seed=0)
    assert counts == [2, 0]
    assert near.shape == (32, 3)
    assert near.unique(dim=0).tolist() == points[:2, :3].tolist()
    assert empty.shape == (0, 3)


def test_points_in_the_proposal_and_around_it_and_the_object_are_told_apart():
    inside = torch.tensor([BOX[:3]]) + torch.tensor([[0.1, 0.05, 0.03], [0.0, 0.0, -0.3]])
    around = inside + torch.tensor([[-2.6, 0.0, 0.0]])
    nothing, truths = torch.zeros(0, 3), torch.tensor([BOX], dtype=torch.float64)
    plain = region_picture(region(), nothing, truths[:0], POOLING)
    for points, color in ((inside, _INSIDE), (around, _AROUND)):
        drawn = region_picture(region(), points, truths[:0], POOLING)
        assert pixels_of(drawn, color) > pixels_of(plain, color)
    moved = truths + torch.tensor([0.0, 0.5, 0, 0, 0, 0, 0])
    assert pixels_of(region_picture(region(), nothing, moved, POOLING), LABELLED) > pixels_of(
        plain, LABELLED
    )
    far = truths + torch.tensor([15.0, 0, 0, 0, 0, 0, 0])
    assert np.array_equal(region_picture(region(), nothing, far, POOLING), plain)


@pytest.mark.parametrize("yaw", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("place", [(8.0, -3.0, -1.0), (60.0, 20.0, 0.5)])
def test_the_whole_enlarged_box_is_in_the_picture(place, yaw):
    picture = region_picture(
        region((*place, *BOX[3:6], yaw)), torch.zeros(0, 3), torch.zeros(0, 7).double(), POOLING
    )[-330:]
    inner = picture[3:-3, 3:-3]
    assert picture.astype(int).sum() == inner.astype(int).sum()
    assert pixels_of(picture, _AROUND) > 40


def test_proposals_have_the_colour_of_their_part_in_the_sampling():
    truths = torch.tensor([BOX], dtype=torch.float64)
    shifts = {RIGHT: 0.2, _HARD: 2.0, PROPOSED: 10.0}
    limits, points = ProposalSamplingConfig(), torch.zeros(0, 3)
    for color, shift_m in shifts.items():
        proposals = truths.float() + torch.tensor([shift_m, 0, 0, 0, 0, 0, 0])
        picture = proposals_picture("000007", points, proposals, truths, limits)
        without = proposals_picture("000007", points, proposals[:0], truths, limits)
        assert picture.shape == without.shape
        for other in shifts:
            gained = pixels_of(picture, other) - pixels_of(without, other)
            assert (gained > 60) == (other == color)


def test_the_legend_is_as_wide_as_asked_for_and_breaks_its_line():
    wide, narrow = regions_legend(1200, POOLING), regions_legend(400, POOLING)
    assert (wide.shape[1], narrow.shape[1]) == (1200, 400)
    assert len(narrow) > len(wide)
