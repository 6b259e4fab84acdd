"""Which stages the settings name."""

from torch import nn

from sightline.detection3d.classes import RoadUserClass
from sightline.detection3d.detector_config import Detection3DConfig
from sightline.detection3d.point_proposals import PointProposals
from sightline.detection3d.point_refinement import PointRefinement


def build_first_stage(config: Detection3DConfig) -> tuple[str, nn.Module]:
    """The first stage, a `FirstStage`, and the name of its settings."""
    assert config.points is not None, "settings name a first stage"
    return "points", PointProposals(config.points)


def build_second_stage(config: Detection3DConfig) -> tuple[str, nn.Module] | None:
    """The second stage, a `SecondStage`, and the name of its settings; None where there is none."""
    if config.refinement is None:
        return None
    return "refinement", PointRefinement(config.refinement, config.pooling)


def classes_of(config: Detection3DConfig) -> tuple[RoadUserClass, ...]:
    """What the first stage proposes, in the order of its outputs."""
    assert config.points is not None, "settings name a first stage"
    return config.points.classes
