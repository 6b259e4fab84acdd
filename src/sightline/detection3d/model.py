"""3D detector with one or two stages."""

from typing import cast

from torch import nn

from sightline.detection3d.designs import build_first_stage, build_second_stage
from sightline.detection3d.detector_config import Detection3DConfig
from sightline.detection3d.stages import FirstStage, SecondStage


class Detector3D(nn.Module):
    """Module of the stages, each named as its settings are; see `detect` for the other steps."""

    def __init__(self, config: Detection3DConfig) -> None:
        super().__init__()
        self.config = config
        self.first_name, first = build_first_stage(config)
        self.add_module(self.first_name, first)
        second = build_second_stage(config)
        self.second_name = None if second is None else second[0]
        if second is not None:
            self.add_module(*second)
        self.class_names = tuple(entry.name for entry in config.classes)

    @property
    def first(self) -> FirstStage:
        """First stage: sweeps to proposals."""
        return cast("FirstStage", self.get_submodule(self.first_name))

    @property
    def second(self) -> SecondStage | None:
        """Second stage: proposals to refined boxes."""
        if self.second_name is None:
            return None
        return cast("SecondStage", self.get_submodule(self.second_name))
