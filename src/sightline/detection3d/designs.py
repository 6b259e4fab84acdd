"""Construction of the stages from the settings."""

from torch import nn

from sightline.detection3d.detector_config import Detection3DConfig
from sightline.detection3d.pillar_proposals import PillarProposals
from sightline.detection3d.point_proposals import PointProposals
from sightline.detection3d.point_refinement import PointRefinement
from sightline.detection3d.region_stage import RegionStage


def build_first_stage(config: Detection3DConfig) -> tuple[str, nn.Module]:
    """Build the first stage, a `FirstStage`, and return it after the name of its settings."""
    if config.pillars is not None:
        return "pillars", PillarProposals(config.pillars, config.centers)
    assert config.points is not None, "settings name a first stage"
    return "points", PointProposals(config.points, config.proposals, config.training_proposals)


def build_second_stage(config: Detection3DConfig) -> tuple[str, nn.Module] | None:
    """Build the second stage, a `SecondStage`, after its settings' name; None if there is none."""
    if config.regions is not None:
        return "regions", RegionStage(config.regions)
    if config.refinement is None:
        return None
    return "refinement", PointRefinement(config.refinement, config.pooling)
