"""Networks of the 2D detectors: streams of the sensors, their fusion, heads."""

from collections.abc import Sequence
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection2d.compact.network import AlignedHead, CompactDesign
from sightline.detection2d.config import Detection2DConfig
from sightline.detection2d.dgfn.network import DgfnDesign, SsdHead
from sightline.detection2d.fusion import (
    DetectorOutput,
    GateOutput,
    RawOutputs,
    mix_heads,
)

Image = Float[Tensor, "batch 3 height width"]


class Detector(nn.Module):
    """Camera-LiDAR detector in the image, with one of the types of `Fusion`.

    The default settings give Kim et al. 2018, Fig. 1; the other types of fusion are its baselines.
    The compact design has the same types.
    """

    def __init__(self, config: Detection2DConfig) -> None:
        super().__init__()
        self.config = config
        design: DgfnDesign | CompactDesign
        if config.compact is not None:
            design = CompactDesign(config.compact, config.width)
        else:
            assert config.dgfn is not None, "settings name one of them"
            design = DgfnDesign(config.dgfn, config.width)
        self.stride = design.stride
        self.smallest_px = design.smallest_px
        self.prepare = design.prepare()
        planes = {"camera": self.prepare.camera_planes, "lidar": self.prepare.lidar_planes}
        if config.fusion == "early":
            planes = {"both": sum(planes.values())}
        elif config.fusion in planes:
            planes = {config.fusion: planes[config.fusion]}
        self.streams = nn.ModuleDict(
            {sensor: design.stream(sensor, count) for sensor, count in planes.items()}
        )
        is_joint = config.fusion in ("gated", "ones")
        self.fusions = (
            nn.ModuleList(design.fusions(gated=config.fusion == "gated")) if is_joint else None
        )
        seen = ("joint",) if is_joint else tuple(self.streams)
        self.heads = nn.ModuleDict({name: design.head(name) for name in seen})
        own = {sensor: design.auxiliary_head(sensor) for sensor in self.streams if is_joint}
        self.auxiliary = nn.ModuleDict(
            {sensor: head for sensor, head in own.items() if head is not None}
        )
        self.mixes_heads = is_joint and config.compact is not None and config.compact.own_heads
        if self.mixes_heads:
            cast("AlignedHead", self.heads["joint"]).start_at_nothing()

    @property
    def training_parts(self) -> tuple[str, ...]:
        """Names of modules for training only; weights for inference omit them."""
        return () if self.mixes_heads else ("auxiliary",)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the images that `forward` takes."""
        fusion = self.config.fusion
        return {"camera": ("image",), "lidar": ("lidar",)}.get(fusion, ("image", "lidar"))

    def forward(self, image: Image | None = None, lidar: Image | None = None) -> DetectorOutput:
        """Detect in images whose sides are multiples of `stride`.

        Args:
            image: RGB in [0, 1], black if the camera is missing.
            lidar: Depth, height and intensity in [0, 1]; see `lidar_image`.

        Raises:
            ValueError: A required image is missing, the images have different sizes, or their size
                does not suit the network.
        """
        outputs = self.run_heads(image, lidar)
        decoded = [
            cast("SsdHead | AlignedHead", head).decode(output)
            for head, output in zip(self.heads.values(), outputs.heads, strict=True)
        ]
        finest = outputs.gates[0] if outputs.gates else None
        return DetectorOutput(
            scores=torch.cat([scores for scores, _ in decoded], dim=1),
            boxes=torch.cat([boxes for _, boxes in decoded], dim=1),
            camera_gate=None if finest is None else finest.camera_logits.float().sigmoid(),
            lidar_gate=None if finest is None else finest.lidar_logits.float().sigmoid(),
        )

    def run_heads(
        self, image: Image | None = None, lidar: Image | None = None, *, auxiliary: bool = False
    ) -> RawOutputs:
        """Compute the outputs of heads and gates for the losses.

        Args:
            image: As for `forward`.
            lidar: As for `forward`; an image that the network does not take is ignored.
            auxiliary: Whether to run the streams' own heads also if only training needs them.

        Raises:
            ValueError: As for `forward`.
        """
        given = {"image": image, "lidar": lidar}
        size = self._checked_size({name: given[name] for name in self.input_names})
        maps = {sensor: self.streams[sensor](each) for sensor, each in self.planes(given).items()}
        are_own_run = auxiliary or self.mixes_heads
        own = {
            sensor: head(maps[sensor], size)
            for sensor, head in self.auxiliary.items()
            if are_own_run
        }
        gates: list[GateOutput] = []
        if self.fusions is not None:
            joint = []
            for fuse, camera_map, lidar_map in zip(
                self.fusions, maps["camera"], maps["lidar"], strict=True
            ):
                fused, gate = fuse(camera_map, lidar_map)
                joint.append(fused)
                gates += [gate] if gate is not None else []
            maps = {"joint": joint}
        heads = tuple(self.heads[name](seen, size) for name, seen in maps.items())
        if self.mixes_heads:
            heads = (mix_heads(heads[0], own["camera"], own["lidar"], gates),)
        return RawOutputs(heads=heads, gates=tuple(gates), auxiliary=own)

    def _checked_size(self, given: dict[str, Image | None]) -> tuple[int, int]:
        missing = [name for name, planes in given.items() if planes is None]
        if missing:
            raise ValueError(
                f"a network of fusion {self.config.fusion} needs the inputs "
                f"{', '.join(given)}; {', '.join(missing)} is missing"
            )
        sizes = [planes.shape[-2:] for planes in given.values() if planes is not None]
        if not torch.compiler.is_compiling():  # whose sizes may be symbols
            self._check_sizes(sizes)
        height, width = sizes[0]
        return height, width

    def _check_sizes(self, sizes: Sequence[torch.Size]) -> None:
        height, width = sizes[0]
        if any(size != sizes[0] for size in sizes):
            raise ValueError(
                "all images must be of one size, got "
                f"{' and '.join(f'{rows} x {columns}' for rows, columns in sizes)} (height x "
                "width); make them of the same frame"
            )
        if height % self.stride or width % self.stride:
            raise ValueError(
                f"height and width must be multiples of {self.stride}, got {height} x {width}; "
                "pad the inputs"
            )
        if min(height, width) < self.smallest_px:
            raise ValueError(
                f"height and width must be at least {self.smallest_px} px, got {height} x {width}; "
                "enlarge the frames (network.input.size)"
            )

    def planes(self, given: dict[str, Image | None]) -> dict[str, Tensor]:
        """Prepare the input planes of each stream from the given images, by name."""
        image, lidar = given["image"], given["lidar"]
        planes = {}
        if image is not None:
            planes["camera"] = self.prepare.camera(image)
        if lidar is not None:
            planes["lidar"] = self.prepare.lidar(lidar)
        if self.config.fusion == "early":
            return {"both": torch.cat((planes["camera"], planes["lidar"]), dim=1)}
        return {sensor: planes[sensor] for sensor in self.streams}
