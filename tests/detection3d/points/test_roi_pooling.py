"""The second stage's input: points in and around each proposal."""

import pytest
import torch

from sightline.detection3d.points.config import RefinementConfig, RoiPoolingConfig
from sightline.detection3d.points.refinement import PointRefinement
from sightline.detection3d.stages import Proposed
from tests.detection3d.boxes import car, rows
from tests.ops.clouds import street

SCENE = street(0, 4000)[0]
FEATURES = torch.cat((SCENE, torch.arange(4000.0)[:, None]), dim=1)  # the index of each point


def pool_rois(points, features, boxes, *, seed):
    """The regions of a stage with the default settings, and their inputs."""
    stage = PointRefinement(RefinementConfig(), RoiPoolingConfig())
    sweep = torch.cat((points, points.new_zeros(len(points), 1)), dim=1)
    classes = torch.zeros(len(boxes), dtype=torch.int64)
    proposed = Proposed(boxes, classes, torch.ones(len(boxes)), features)
    regions = stage.regions(sweep, proposed, seed=seed)
    return regions, regions.inputs["points"], regions.inputs["features"]


def test_a_roi_has_512_points_of_the_box_and_a_metre_around_it_with_their_features():
    proposals = rows([car(12.0, 1.0, 0.4), car(30.0, -5.0, 2.0)]).float()
    regions, inside, features = pool_rois(SCENE, FEATURES, proposals, seed=1)
    assert inside.shape == (2, 512, 3)
    assert torch.equal(regions.boxes, proposals)
    assert torch.equal(features[..., :3], inside)
    for box, points in zip(proposals, inside, strict=True):
        offset = points - box[:3]
        cos, sin = box[6].cos(), box[6].sin()
        along = (cos * offset[:, 0] + sin * offset[:, 1]).abs()
        across = (cos * offset[:, 1] - sin * offset[:, 0]).abs()
        assert 2.0 < along.max() <= 3.0 + 1e-5
        assert 1.0 < across.max() <= 2.0 + 1e-5
        assert offset[:, 2].abs().max() <= 1.75 + 1e-5


def test_proposals_without_points_and_all_zero_ones_are_left_out():
    at_the_origin = torch.zeros(1, 3)
    cloud, features = torch.cat((SCENE, at_the_origin)), torch.cat((FEATURES, torch.zeros(1, 4)))
    proposals = torch.cat((rows([car(-50.0), car(12.0)]), torch.zeros(2, 7))).float()
    regions, _, _ = pool_rois(cloud, features, proposals, seed=0)
    assert regions.places.tolist() == [1]
    assert torch.equal(regions.boxes, proposals[1:2])


def test_sparse_rois_repeat_their_points_and_crowded_ones_draw_without_repetition():
    box = rows([car(0.0)]).float()
    few = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2.9, 1.9, 1.7], [3.1, 0, 0]])
    _, points, _ = pool_rois(few, few, box, seed=0)
    assert points[0].unique(dim=0).tolist() == few[:3].tolist()
    crowd = torch.rand(2000, 3)
    _, points, _ = pool_rois(crowd, crowd, box, seed=0)
    assert len(points[0].unique(dim=0)) == 512


def test_no_points_and_no_proposals_give_no_rois():
    for cloud, proposals in ((SCENE[:0], rows([car(1.0)])), (SCENE, rows([]))):
        _, _, features = pool_rois(cloud, cloud, proposals.float(), seed=0)
        assert features.shape == (0, 512, 3)


def test_features_learn_from_what_was_pooled_of_them():
    features = FEATURES.clone().requires_grad_()
    _, _, pooled = pool_rois(SCENE, features, rows([car(12.0)]).float(), seed=0)
    pooled.sum().backward()
    assert features.grad[:, 0].sum() == 512
    assert set(features.grad[:, 0].nonzero()[:, 0].tolist()) == set(
        pooled[..., 3].flatten().int().tolist()
    )


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match="margin_m must be from 0 to 100, got -1"):
        RoiPoolingConfig(margin_m=-1.0)
    with pytest.raises(ValueError, match="num_points must be from 1 to 16384, got 0"):
        RoiPoolingConfig(num_points=0)
