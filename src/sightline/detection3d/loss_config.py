"""Settings of the detectors' training losses."""

import math
from dataclasses import dataclass, field

from sightline.detection3d.pillar_loss import PillarLossConfig
from sightline.detection3d.pillar_targets import PillarTargetsConfig
from sightline.detection3d.proposal_loss import ProposalLossConfig
from sightline.detection3d.proposal_sampling import ProposalSamplingConfig
from sightline.detection3d.refinement_loss import RefinementLossConfig
from sightline.detection3d.region_examples import RegionExamplesConfig
from sightline.detection3d.region_loss import RegionLossConfig


@dataclass(frozen=True, kw_only=True)
class Detection3DLossConfig:
    """Settings of both stages' losses."""

    points: ProposalLossConfig = field(default_factory=ProposalLossConfig)
    """Losses of the point first stage."""
    pillars: PillarLossConfig = field(default_factory=PillarLossConfig)
    """Losses of the pillar first stage."""
    cells: PillarTargetsConfig = field(default_factory=PillarTargetsConfig)
    """Targets of the pillar first stage's cells."""
    first_weight: float = 1.0
    """Weight of the first stage's loss, where both are trained."""
    sampling: ProposalSamplingConfig = field(default_factory=ProposalSamplingConfig)
    """Sampling of proposals to train the plain second stage."""
    refinement: RefinementLossConfig = field(default_factory=RefinementLossConfig)
    """Losses of the plain second stage."""
    region_examples: RegionExamplesConfig = field(default_factory=RegionExamplesConfig)
    """Training examples of the compact second stage."""
    regions: RegionLossConfig = field(default_factory=RegionLossConfig)
    """Losses of the compact second stage."""

    def __post_init__(self) -> None:
        """Checks the weight."""
        if not 0 <= self.first_weight < math.inf:
            raise ValueError(
                f"loss.first_weight must be finite and not negative, got {self.first_weight}"
            )
