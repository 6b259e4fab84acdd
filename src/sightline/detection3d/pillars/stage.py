"""First stage on pillars: a bird's-eye-view map of statistics, and a convolutional network.

The features are plain statistics, computed before the network and not by it. So the exported graph
consists of convolutions alone, has one shape for any number of points, and needs no scatter.
"""

import math
from collections.abc import Mapping, Sequence
from functools import partial

import torch
import torch.nn.functional as F
from jaxtyping import Float, Float32, Float64, Int64
from torch import Tensor, nn

from sightline.detection3d.config import Detection3DLossConfig
from sightline.detection3d.pillars.boxes import (
    CENTER_VALUES,
    PillarOutput,
    find_boxes,
    mirror_centers,
)
from sightline.detection3d.pillars.config import (
    LOCAL_CHANNELS,
    PillarDetectionConfig,
    PillarGridConfig,
    PillarNetworkConfig,
)
from sightline.detection3d.pillars.training import (
    PillarLosses,
    PillarTargets,
    pillar_loss,
    pillar_targets,
)
from sightline.detection3d.stages import UNCHANGED, FirstStage, Proposed, StageView
from sightline.detection3d.sweeps import Sweep, SweepTruth
from sightline.networks.residual import ConvNorm, ResidualBlock

PILLAR_COUNT_SCALE = 0.5  # factor on log(1 + number of points)
_INITIAL_HEAT = 0.03  # heat of every cell before training
_NORM_MOMENTUM = 0.05  # batches are of a few sweeps
_ASIDE_AFTER_SLICES = 5  # channel of the mean y offset, counted from the point count
_UPPER = ([0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2])  # rows and columns of a covariance, once each
_LOCAL_ASIDE = (1, 4, 7)  # local statistics that change signs with y: mean y, xy, yz
GROUND_SHIFT_M = 1.0  # heights are relative to the middle of road users, 1 m below the sensor


def pillar_features(
    points: Float[Tensor, "num_points fields"], grid: PillarGridConfig
) -> Float32[Tensor, "channels rows columns"]:
    """Compute the features of each pillar, zeros for empty ones, from any number of points.

    Channels: for each height, how close a point comes to it (1 at it, falling to 0 at the next
    heights); half the logarithm of 1 + the number of points; mean, highest and lowest z [m] + 1;
    the mean offset along x and y from the pillar's middle (-1 to 1 at its borders); the mean
    reflectance, if requested; and local statistics, if requested (`_local_statistics`). After Lang
    et al. 2019 (PointPillars), with heights kept apart and without layers before the scatter.

    Pillars and grid contain their lower borders but not their upper ones; in z, the grid contains
    both. Computed in float64: the order of the points does not matter beyond its rounding, and on a
    CPU the same points give the same bits. No gradient. The memory format is channels last.

    Points are x, y, z [m] (LiDAR frame), and reflectance as the fourth field, if requested.
    """
    values = points.detach().double()
    place = torch.stack(
        ((values[:, 0] - grid.x_m[0]) / grid.cell_m, (values[:, 1] - grid.y_m[0]) / grid.cell_m), 1
    )
    size, z = place.new_tensor([grid.rows, grid.columns]), values[:, 2]
    is_within = ((place >= 0) & (place < size)).all(dim=1)  # False for NaN
    is_within &= (z >= grid.z_m[0]) & (z <= grid.z_m[1])
    place, values = place[is_within], values[is_within]
    row, column = place.long().unbind(dim=1)
    pillar = row * grid.columns + column
    z = values[:, 2]
    number = grid.rows * grid.columns
    count = torch.bincount(pillar, minlength=number).double()
    means = [z, *(2 * (place - place.floor()) - 1).unbind(dim=1)]
    if grid.reflectance:
        means.append(values[:, 3])
    summed = values.new_zeros(number, len(means)).index_add_(0, pillar, torch.stack(means, dim=1))
    mean = summed / count.clamp(min=1)[:, None]
    highest, lowest = (
        values.new_zeros(number).scatter_reduce_(0, pillar, z, how, include_self=False)
        for how in ("amax", "amin")
    )
    heights = torch.stack((mean[:, 0], highest, lowest), dim=1) + GROUND_SHIFT_M
    heights = torch.where(count[:, None] > 0, heights, 0.0)
    columns = [
        _slices(pillar, z, number, grid),
        PILLAR_COUNT_SCALE * torch.log1p(count)[:, None],
        heights,
        mean[:, 1:],
    ]
    if grid.local_window:
        columns.append(_local_statistics(pillar, values[:, :3], count, grid))
    together = torch.cat(columns, dim=1).float()
    return together.reshape(grid.rows, grid.columns, -1).permute(2, 0, 1)


def mirror_pillars(
    pillars: Float32[Tensor, "batch channels rows columns"], grid: PillarGridConfig
) -> Float32[Tensor, "batch channels rows columns"]:
    """Mirror maps left to right, on a grid that reaches as far to the left as to the right.

    A point on the border of two pillars is then in another pillar than after mirroring the points.
    """
    mirrored = pillars.flip(-1)
    mirrored[:, grid.slices + _ASIDE_AFTER_SLICES] *= -1
    if grid.local_window:
        first = grid.channels - LOCAL_CHANNELS
        mirrored[:, [first + number for number in _LOCAL_ASIDE]] *= -1
    return mirrored


def _slices(
    pillar: Int64[Tensor, " num_points"],
    z: Float64[Tensor, " num_points"],
    number: int,
    grid: PillarGridConfig,
) -> Float64[Tensor, "number slices"]:
    """Compute how close points come to each height; points beyond the ends count at the end."""
    level = ((z - grid.lowest_slice_m) / grid.slice_m).clamp(0, grid.slices - 1)
    below = level.floor()
    share = level - below
    occupied = z.new_zeros(number * grid.slices)
    first = pillar * grid.slices + below.long()
    occupied.scatter_reduce_(0, first, 1 - share, "amax")
    is_between = share > 0  # the last height has no next one
    occupied.scatter_reduce_(0, first[is_between] + 1, share[is_between], "amax")
    return occupied.reshape(number, grid.slices)


def _local_statistics(
    pillar: Int64[Tensor, " num_points"],
    xyz: Float64[Tensor, "num_points 3"],
    count: Float64[Tensor, " number"],
    grid: PillarGridConfig,
) -> Float64[Tensor, "number 9"]:
    """Compute mean and covariance of the points in a square of pillars around each filled pillar.

    Channels: the mean x, y, z [m] less that of the pillar's own points; the covariances xx, xy, xz,
    yy, yz, zz [m^2]. They describe a local shape whatever its place and the density of the points.
    After Malic et al. 2025 (GBlobs), with squares of pillars for the neighbours of each point.
    """
    products = (xyz[:, :, None] * xyz[:, None, :])[:, *_UPPER]
    moments = torch.cat((xyz, products), dim=1)
    summed = moments.new_zeros(len(count), LOCAL_CHANNELS).index_add_(0, pillar, moments)
    together = torch.cat((count[:, None], summed), dim=1)
    maps = together.T.reshape(1, -1, grid.rows, grid.columns)
    half = grid.local_window // 2
    around = F.avg_pool2d(maps, grid.local_window, stride=1, padding=half, divisor_override=1)
    around = around.reshape(LOCAL_CHANNELS + 1, -1).T
    mean = around[:, 1:] / around[:, :1].clamp(min=1)
    covariance = mean[:, 3:] - (mean[:, :3, None] * mean[:, None, :3])[:, *_UPPER]
    own = summed[:, :3] / count.clamp(min=1)[:, None]
    statistics = torch.cat((mean[:, :3] - own, covariance), dim=1)
    return torch.where(count[:, None] > 0, statistics, 0.0)


_conv = partial(ConvNorm, momentum=_NORM_MOMENTUM)
_block = partial(ResidualBlock, momentum=_NORM_MOMENTUM)


class PillarNetwork(nn.Module):
    """Residual stages, an upsampling path, and a centre head.

    After Yin et al. 2021 (CenterPoint), section 4, without its second stage: a heat map and a box
    for each class, here each by a layer of its own.
    """

    def __init__(self, config: PillarNetworkConfig) -> None:
        super().__init__()
        self.num_classes = len(config.classes)
        fine, middle, coarse = config.channels
        self.stages = nn.ModuleList(
            nn.Sequential(_conv(before, width, stride=2), *(_block(width) for _ in range(blocks)))
            for before, width, blocks in zip(
                (config.grid.channels, fine, middle), config.channels, config.blocks, strict=True
            )
        )
        width = config.head_channels
        self.coarse_to_middle = nn.Conv2d(coarse, middle, 1)
        self.mix_middle = _conv(middle, middle)
        self.middle_to_fine = nn.Conv2d(middle, width, 1)
        self.fine_to_head = nn.Conv2d(fine, width, 1)
        self.tower = nn.Sequential(nn.ReLU(inplace=True), _conv(width, width), _conv(width, width))
        self.heat = nn.Conv2d(width, self.num_classes, 1)
        self.center = nn.Conv2d(width, self.num_classes * CENTER_VALUES, 1)
        assert self.heat.bias is not None, "made with one"
        nn.init.constant_(self.heat.bias, -math.log(1 / _INITIAL_HEAT - 1))

    def forward(self, pillars: Float[Tensor, "batch channels height width"]) -> PillarOutput:
        """Compute output maps from pillar maps, at half their rows and columns."""
        fine = self.stages[0](pillars)
        middle = self.stages[1](fine)
        coarse = self.stages[2](middle)
        twice = partial(F.interpolate, scale_factor=2.0)
        middle = self.mix_middle(middle + twice(self.coarse_to_middle(coarse)))
        seen = self.tower(self.fine_to_head(fine) + twice(self.middle_to_fine(middle)))
        heat, center = self.heat(seen).float(), self.center(seen).float()
        return PillarOutput(heat, center.unflatten(1, (self.num_classes, CENTER_VALUES)))


def _mirror(inputs: Mapping[str, Tensor], *, grid: PillarGridConfig) -> dict[str, Tensor]:
    return {"pillars": mirror_pillars(inputs["pillars"], grid)}


def _mirror_back(output: PillarOutput) -> PillarOutput:
    return PillarOutput(output.heat_logits.flip(-1), mirror_centers(output.center_values))


class PillarProposals(FirstStage):
    """First stage for sweeps with any number of points.

    The flip test needs a grid that reaches as far to the left as to the right.
    """

    output_type = PillarOutput

    def __init__(self, config: PillarNetworkConfig, centers: PillarDetectionConfig) -> None:
        super().__init__()
        self.config = config
        self.centers = centers
        self.views = UNCHANGED, StageView(partial(_mirror, grid=config.grid), _mirror_back)
        self.network = PillarNetwork(config)

    def inputs(self, sweeps: Sequence[Sweep]) -> dict[str, Tensor]:
        """Compute the sweeps' pillar maps, channels last."""
        maps = [pillar_features(sweep, self.config.grid) for sweep in sweeps]
        as_they_lie = torch.stack([each.permute(1, 2, 0) for each in maps])
        return {"pillars": as_they_lie.permute(0, 3, 1, 2)}

    @torch.no_grad()
    def propose(
        self, output: PillarOutput, sweeps: Sequence[Sweep], *, training: bool
    ) -> tuple[Proposed, ...]:
        """Decode by `find_boxes`; the same in training."""
        del training
        return tuple(
            find_boxes(output, number, self.config, self.centers) for number in range(len(sweeps))
        )

    def losses(
        self,
        output: PillarOutput,
        sweeps: Sequence[Sweep],
        truths: Sequence[SweepTruth],
        config: Detection3DLossConfig,
    ) -> PillarLosses:
        """Compute `pillar_loss`."""
        del sweeps
        grid, device = self.config.grid, output.heat_logits.device
        scenes = [truth.cpu() for truth in truths]
        targets = pillar_targets(scenes, len(self.config.classes), grid, config.cells)
        moved = PillarTargets(*(values.to(device) for values in targets))
        return pillar_loss(output, moved, self.config, config.pillars)
