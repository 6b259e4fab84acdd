"""Flip test of the compact first stage: the scene unchanged, and mirrored left to right."""

from collections.abc import Mapping
from functools import partial

from torch import Tensor

from sightline.detection3d.center_coding import mirror_centers
from sightline.detection3d.pillar_config import PillarGridConfig
from sightline.detection3d.pillar_features import mirror_pillars
from sightline.detection3d.pillar_network import PillarOutput
from sightline.detection3d.views import AS_IT_IS, View


def pillar_views(grid: PillarGridConfig) -> tuple[View, ...]:
    """Make both views of maps on a grid that reaches as far to the left as to the right."""
    return AS_IT_IS, View(partial(_mirror, grid=grid), _mirror_back)


def _mirror(inputs: Mapping[str, Tensor], *, grid: PillarGridConfig) -> dict[str, Tensor]:
    return {"pillars": mirror_pillars(inputs["pillars"], grid)}


def _mirror_back(output: PillarOutput) -> PillarOutput:
    return PillarOutput(output.heat_logits.flip(-1), mirror_centers(output.center_values))
