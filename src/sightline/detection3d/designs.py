"""Which stages the settings name."""

from torch import nn

from sightline.detection3d.detector_config import Detection3DConfig
from sightline.detection3d.pillar_proposals import PillarProposals
from sightline.detection3d.point_proposals import PointProposals
from sightline.detection3d.point_refinement import PointRefinement
from sightline.detection3d.region_stage import RegionStage


def build_first_stage(config: Detection3DConfig) -> tuple[str, nn.Module]:
    """The first stage, a `FirstStage`, and the name of its settings."""
    if config.pillars is not None:
        return "pillars", PillarProposals(config.pillars, config.centers)
    assert config.points is not None, "settings name a first stage"
    return "points", PointProposals(config.points, config.proposals, config.training_proposals)


def build_second_stage(config: Detection3DConfig) -> tuple[str, nn.Module] | None:
    """The second stage, a `SecondStage`, and the name of its settings; None where there is none."""
    if config.regions is not None:
        return "regions", RegionStage(config.regions)
    if config.refinement is None:
        return None
    return "refinement", PointRefinement(config.refinement, config.pooling)
