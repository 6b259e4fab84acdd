"""The compact second stage's flip test: regions mirrored left to right, turned round, and both."""

from collections.abc import Mapping
from typing import Final

from torch import Tensor

from sightline.detection3d.region_coding import mirror_regions, turn_regions
from sightline.detection3d.region_network import RegionOutput
from sightline.detection3d.regions import CutRegions, mirror_cut, turn_cut
from sightline.detection3d.views import AS_IT_IS, View

_Inputs = Mapping[str, Tensor]


def _mirror(inputs: _Inputs) -> _Inputs:
    return mirror_cut(CutRegions(**inputs))._asdict()


def _turn(inputs: _Inputs) -> _Inputs:
    return turn_cut(CutRegions(**inputs))._asdict()


def _mirror_and_turn(inputs: _Inputs) -> _Inputs:
    return _turn(_mirror(inputs))


def _mirror_back(output: RegionOutput) -> RegionOutput:
    return output._replace(values=mirror_regions(output.values))


def _turn_back(output: RegionOutput) -> RegionOutput:
    return output._replace(values=turn_regions(output.values), front_logits=-output.front_logits)


def _mirror_and_turn_back(output: RegionOutput) -> RegionOutput:
    return _mirror_back(_turn_back(output))


REGION_VIEWS: Final = (
    AS_IT_IS,
    View(_mirror, _mirror_back),
    View(_turn, _turn_back),
    View(_mirror_and_turn, _mirror_and_turn_back),
)
