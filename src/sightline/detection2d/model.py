"""The detectors' networks: streams of the sensors, their fusion, heads."""

from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection2d.config import Detection2DConfig
from sightline.detection2d.gated_fusion import GatedFusion
from sightline.detection2d.inputs import VggInput
from sightline.detection2d.readings import DetectorOutput, GateReading, Readings
from sightline.detection2d.ssd_head import SsdHead
from sightline.detection2d.vgg_stream import MAP_CHANNELS, VggStream, scaled

Image = Float[Tensor, "batch 3 height width"]


class Detector(nn.Module):
    """A camera-LiDAR detector in the image, by one of the ways of `Fusion`.

    Kim et al. 2018, Fig. 1, with `gated`; the other ways are the systems that it is compared with.
    """

    def __init__(self, config: Detection2DConfig) -> None:
        super().__init__()
        self.config = config
        self.prepare = VggInput()
        channels = [scaled(count, config.width) for count in MAP_CHANNELS]
        self.streams = nn.ModuleDict(
            {
                name: VggStream(planes, config.width, config.dgfn.l2_norm_scale)
                for name, planes in _stream_planes(config).items()
            }
        )
        gated = config.fusion == "gated"
        self.fusions = (
            nn.ModuleList(GatedFusion(count, count, count, gated=gated) for count in channels)
            if config.fusion in ("gated", "ones")
            else None
        )
        seen_by = ("joint",) if self.fusions is not None else tuple(self.streams)
        self.heads = nn.ModuleDict({name: SsdHead(channels, config.dgfn) for name in seen_by})

    @property
    def stride(self) -> int:
        """Height and width must be multiples of it."""
        return 1

    @property
    def input_names(self) -> tuple[str, ...]:
        """Which images `forward` takes."""
        fusion = self.config.fusion
        return {"camera": ("image",), "lidar": ("lidar",)}.get(fusion, ("image", "lidar"))

    def forward(self, image: Image | None = None, lidar: Image | None = None) -> DetectorOutput:
        """Detects in images of any size; one that the network does not take is passed over.

        Args:
            image: RGB in [0, 1], black where the camera delivered nothing.
            lidar: Depth, height and intensity in [0, 1], as `lidar_image` makes them.

        Raises:
            ValueError: An image that the network needs is not given.
        """
        readings = self.read(image, lidar)
        decoded = [
            cast("SsdHead", head).decode(reading)
            for head, reading in zip(self.heads.values(), readings.heads, strict=True)
        ]
        finest = readings.gates[0] if readings.gates else None
        return DetectorOutput(
            scores=torch.cat([scores for scores, _ in decoded], dim=1),
            boxes=torch.cat([boxes for _, boxes in decoded], dim=1),
            camera_gate=None if finest is None else finest.camera_logits.float().sigmoid(),
            lidar_gate=None if finest is None else finest.lidar_logits.float().sigmoid(),
        )

    def read(self, image: Image | None = None, lidar: Image | None = None) -> Readings:
        """What the heads and gates say, as losses take it; arguments as for `forward`."""
        given = {"image": image, "lidar": lidar}
        missing = [name for name in self.input_names if given[name] is None]
        if missing:
            raise ValueError(
                f"a network of fusion {self.config.fusion} needs the inputs "
                f"{', '.join(self.input_names)}; {', '.join(missing)} is missing"
            )
        size = next(planes for planes in given.values() if planes is not None).shape[-2:]
        maps = {name: self.streams[name](planes) for name, planes in self._planes(given).items()}
        gates: list[GateReading] = []
        if self.fusions is not None:
            joint = []
            for fuse, camera_map, lidar_map in zip(
                self.fusions, maps["camera"], maps["lidar"], strict=True
            ):
                fused, gate = fuse(camera_map, lidar_map)
                joint.append(fused)
                gates += [gate] if gate is not None else []
            maps = {"joint": joint}
        heads = tuple(self.heads[name](seen, (size[0], size[1])) for name, seen in maps.items())
        return Readings(heads=heads, gates=tuple(gates))

    def _planes(self, given: dict[str, Image | None]) -> dict[str, Tensor]:
        """What each stream sees."""
        image, lidar = given["image"], given["lidar"]
        planes = {}
        if image is not None:
            planes["camera"] = self.prepare.camera(image)
        if lidar is not None:
            planes["lidar"] = self.prepare.lidar(lidar)
        if self.config.fusion == "early":
            return {"both": torch.cat((planes["camera"], planes["lidar"]), dim=1)}
        return {name: planes[name] for name in self.streams}


def _stream_planes(config: Detection2DConfig) -> dict[str, int]:
    """The streams by name, and how many planes each sees."""
    if config.fusion == "early":
        return {"both": 6}
    if config.fusion in ("camera", "lidar"):
        return {config.fusion: 3}
    return {"camera": 3, "lidar": 3}
