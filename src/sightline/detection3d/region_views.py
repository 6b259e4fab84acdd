"""Flip test of the compact second stage: regions unchanged, and turned by half a turn.

`Detection3DConfig` checks that they are canonical.
"""

from collections.abc import Mapping
from typing import Final

from torch import Tensor

from sightline.detection3d.region_coding import turn_regions
from sightline.detection3d.region_network import RegionOutput
from sightline.detection3d.regions import CutRegions, flip_heading
from sightline.detection3d.views import AS_IT_IS, View


def _turn(inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return flip_heading(CutRegions(**inputs))._asdict()


def _turn_back(output: RegionOutput) -> RegionOutput:
    return output._replace(values=turn_regions(output.values), front_logits=-output.front_logits)


REGION_VIEWS: Final = (AS_IT_IS, View(_turn, _turn_back))
