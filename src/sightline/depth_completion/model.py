"""Depth completion network with Shift-Convolution and a light HRNet."""

import math
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from sightline.depth_completion.config import DepthCompletionConfig
from sightline.depth_completion.hrnet import HighResolutionTrunk
from sightline.depth_completion.propagation import NEIGHBOURS, propagate
from sightline.depth_completion.shift_conv import ShiftConvBranch
from sightline.depth_completion.street_depth import FARTHEST_STREET_M
from sightline.depth_completion.surroundings import NUM_PLANES, Surroundings, find_surroundings
from sightline.depth_completion.unet import UNet
from sightline.networks.residual import ConvNorm

_MAX_LOG_CORRECTION = math.log(4)  # corrects a completed depth by a factor of 4 at most
_MAX_LOG_BETWEEN = 0.3  # after the share of the way to a measurement around
_UNCERTAINTY_FLOOR_M = 0.01
_START_M = 17.0  # mean depth of street scenes within a LiDAR's reach


class DepthCompletionOutput(NamedTuple):
    """Output of the network in metres. Depth is not clamped and may be zero or negative."""

    depth_m: Float[Tensor, "batch 1 height width"]
    uncertainty_m: Float[Tensor, "batch 1 height width"] | None
    """Expected absolute error of `depth_m`: positive."""
    e_point_m: Float[Tensor, "batch 1 height width"] | None
    """The filled map of the Shift-Convolution branch."""


class DepthCompletionNet(nn.Module):
    """The network of Yu and Kee 2021, Fig. 8, and the variants that its settings allow.

    "3D LiDAR Depth Completion Based on Shift-Convolution Using Adjacent Pixel Information"; this
    folder cites its sections, equations and figures.

    The Shift-Convolution branch spreads the sparse depth to the E-Point; image, sparse depth,
    E-Point and a classical completion go through one convolution each into the trunk.

    A missing camera is a black image, which the network replaces by uniform grey.
    """

    def __init__(self, config: DepthCompletionConfig) -> None:
        super().__init__()
        self.config = config
        points = 2 if config.validity_channel else 1
        self.shift_branch = (
            ShiftConvBranch(points, config.shift_conv) if config.shift_conv else None
        )
        planes = [4 if config.presence_channel else 3]
        if config.surroundings_px:
            planes += [NUM_PLANES]
        else:
            planes += [points] + [1] * (config.shift_conv is not None) + [1] * config.filled_input
        self.outputs = _output_channels(config)
        self.stems = nn.ModuleList()
        self.refinement: nn.Sequential | None = None
        if config.unet:
            self.trunk: nn.Module = UNet(sum(planes), sum(self.outputs), config.unet)
        else:
            self._add_stems_and_trunk(planes)
        if config.residual:  # the first prediction is the classical completion itself
            for parameter in self._last_convolution().parameters():
                nn.init.zeros_(parameter)

    def _add_stems_and_trunk(self, planes: list[int]) -> None:
        """Add stems, trunk and refinement for inputs of so many planes each."""
        config, stem = self.config, self.config.stem_channels
        stem_planes = [sum(planes)] if config.stem_fusion == "joint" else planes
        self.stems.extend(ConvNorm(count * config.trunk_stride**2, stem) for count in stem_planes)
        is_wider = config.stem_fusion == "concatenate"
        in_channels = stem * len(planes) if is_wider else stem
        features = config.refinement_channels or sum(self.outputs)
        unfolding = config.trunk_stride // config.refinement_stride
        self.trunk = HighResolutionTrunk(in_channels, features * unfolding**2, config.trunk)
        cells = config.refinement_stride**2
        if config.refinement_channels:
            self.refinement = _refinement(
                features + sum(planes) * cells,
                config.refinement_hidden_channels or features,
                sum(self.outputs) * cells,
            )

    def start_at_constant_depth(self) -> None:
        """Let an untrained network predict 17 m everywhere; a residual one stays as it is.

        The last convolution sums thousands of features, none of them negative. With random weights
        it predicts hundreds of metres, and a training spends its first hundreds of updates on that.
        """
        if self.config.residual:
            return
        last = self._last_convolution()
        nn.init.zeros_(last.weight)
        assert last.bias is not None, "all last convolutions have one"
        nn.init.zeros_(last.bias)
        cells = len(last.bias) // sum(self.outputs)  # depth comes first, a channel for each cell
        nn.init.constant_(last.bias[:cells], _START_M / self.config.depth_scale_m)

    def _last_convolution(self) -> nn.Conv2d:
        last = self.refinement[-1] if self.refinement else self.trunk.get_submodule("head")
        assert isinstance(last, nn.Conv2d), "trunks and refinements end so"
        return last

    @property
    def stride(self) -> int:
        """Number that must divide height and width of the inputs."""
        return self.config.stride

    @property
    def takes_filled_depth(self) -> bool:
        """Whether `forward` needs the classical completion."""
        return self.config.filled_input

    def forward(
        self,
        image: Float[Tensor, "batch 3 height width"],
        sparse_depth_m: Float[Tensor, "batch 1 height width"],
        filled_depth_m: Float[Tensor, "batch 1 height width"] | None = None,
    ) -> DepthCompletionOutput:
        """Predict depth from an image (RGB in [0, 1], black if missing) and maps [m], 0 = none.

        A network without that input ignores a classical completion.

        Raises:
            ValueError: Sizes are no multiples of `stride`, or the completion is missing.
        """
        if not torch.compiler.is_compiling():  # while tracing, sizes are symbols
            self._check_size(image)
        config = self.config
        if config.filled_input and filled_depth_m is None:
            raise ValueError("this network starts from a classical completion: give filled_depth_m")
        planes = [_camera_planes(image, with_presence=config.presence_channel)]
        surroundings = e_point_m = None
        if config.surroundings_px:
            assert filled_depth_m is not None, "the config requires both"
            surroundings = find_surroundings(sparse_depth_m, filled_depth_m, config.surroundings_px)
            planes.append(surroundings.planes)
        else:
            points = self._points(sparse_depth_m)
            planes.append(points)
            if self.shift_branch is not None:
                e_point = self.shift_branch(points)
                e_point_m = e_point.to(sparse_depth_m.dtype) * config.depth_scale_m
                planes.append(e_point)
            if filled_depth_m is not None and config.filling == "street":
                planes.append(_direction_plane(filled_depth_m))
            elif filled_depth_m is not None and config.filled_input:
                planes.append(filled_depth_m / config.depth_scale_m)
        raw = self._predict(planes).to(sparse_depth_m.dtype)  # sums in metres need all digits
        outputs = torch.split(raw, self.outputs, dim=1)
        depth_m = self._depth_m(outputs[0], filled_depth_m, surroundings)
        if config.propagation_steps:
            affinity, confidence = outputs[-2:]
            depth_m = propagate(
                depth_m, affinity, confidence, sparse_depth_m, steps=config.propagation_steps
            )
        uncertainty_m = None
        if config.uncertainty:
            uncertainty_m = F.softplus(outputs[1]) + _UNCERTAINTY_FLOOR_M
        return DepthCompletionOutput(depth_m, uncertainty_m, e_point_m)

    def _check_size(self, image: Tensor) -> None:
        height, width = image.shape[-2:]
        if height % self.stride or width % self.stride:
            raise ValueError(
                f"height and width must be multiples of {self.stride}, got {height} x {width}; "
                "pad or crop the inputs"
            )

    def _points(self, sparse_depth_m: Tensor) -> Tensor:
        scaled = sparse_depth_m / self.config.depth_scale_m
        if not self.config.validity_channel:
            return scaled
        return torch.cat((scaled, (sparse_depth_m > 0).to(scaled.dtype)), dim=1)

    def _predict(self, planes: list[Tensor]) -> Tensor:
        if self.config.unet:
            output: Tensor = self.trunk(torch.cat(planes, dim=1))
            return output
        stride = self.config.trunk_stride
        stem_inputs = [torch.cat(planes, dim=1)] if self.config.stem_fusion == "joint" else planes
        folded = [
            stem(F.pixel_unshuffle(plane, stride))
            for stem, plane in zip(self.stems, stem_inputs, strict=True)
        ]
        if self.config.stem_fusion != "concatenate":
            fused = folded[0]
            for other in folded[1:]:
                fused = fused + other
        else:
            fused = torch.cat(folded, dim=1)
        fine = self.config.refinement_stride
        features = F.pixel_shuffle(self.trunk(fused), stride // fine)
        if self.refinement is None:
            return features
        inputs = planes if fine == 1 else [F.pixel_unshuffle(plane, fine) for plane in planes]
        return F.pixel_shuffle(self.refinement(torch.cat((features, *inputs), dim=1)), fine)

    def _depth_m(
        self, predicted: Tensor, filled_depth_m: Tensor | None, surroundings: Surroundings | None
    ) -> Tensor:
        if not self.config.residual:
            return predicted * self.config.depth_scale_m
        assert filled_depth_m is not None, "a residual network takes the classical completion"
        if self.config.correction == "metres":
            return filled_depth_m + predicted * self.config.depth_scale_m
        if self.config.correction == "between":
            assert surroundings is not None, "the config requires both"
            bounded = torch.tanh(predicted)
            share, factor = bounded[:, :1], bounded[:, 1:]
            farther = share.clamp(min=0) * (surroundings.farthest_m - filled_depth_m)
            nearer = share.clamp(max=0) * (filled_depth_m - surroundings.nearest_m)
            between: Tensor = filled_depth_m + farther + nearer
            return between * (_MAX_LOG_BETWEEN * factor).exp()
        bounded = _MAX_LOG_CORRECTION * torch.tanh(predicted / _MAX_LOG_CORRECTION)
        if self.config.dead_zone:
            # Detached: without a gradient inside the zone no correction would leave it.
            zone = self.config.dead_zone
            bounded = bounded - bounded.detach().clamp(-zone, zone)
        return filled_depth_m * bounded.exp()


def _output_channels(config: DepthCompletionConfig) -> list[int]:
    """Channels of depth, uncertainty, and the propagation's affinities and confidence."""
    depth = [2 if config.correction == "between" else 1]
    propagation = [NEIGHBOURS, 1] if config.propagation_steps > 0 else []
    return depth + [1] * config.uncertainty + propagation


def _refinement(in_channels: int, channels: int, out_channels: int) -> nn.Sequential:
    return nn.Sequential(
        ConvNorm(in_channels, channels),
        nn.Conv2d(channels, out_channels, kernel_size=3, padding=1),
    )


def _direction_plane(street_m: Tensor) -> Tensor:
    """Tell where each pixel looks, from the depth of a plain street: 2 up, 0 ahead, -2 down.

    That depth alone is the same for a direction above the horizon and one below it. Above, it grows
    downwards; rows that repeat the one below them, as padding does, are above.
    """
    growth = street_m[:, :, 1:] - street_m[:, :, :-1]
    is_above = torch.cat((growth, growth[:, :, -1:]), dim=2) >= 0
    away = 2 * (1 - street_m / FARTHEST_STREET_M)
    return torch.where(is_above, away, -away)


def _camera_planes(image: Tensor, *, with_presence: bool) -> Tensor:
    """Centre the image at zero (all zero if black); optionally append its presence channel."""
    present = (image.amax(dim=(1, 2, 3), keepdim=True) > 0).to(image.dtype)
    centred = (image - 0.5) * present
    if not with_presence:
        return centred
    return torch.cat((centred, present.expand_as(image[:, :1])), dim=1)
