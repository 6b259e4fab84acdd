"""Views of a frame that a network is shown: bands along the horizon, as KITTI's camera sees it.

The networks learned from one camera: 722 px of focal length, level, 375 rows of which 173 lie above
the horizon. What depends on another camera is taken out here: its scale, the height of its view and
its pitch. Sky, upper floors and the own bonnet are not searched.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import torch
from jaxtyping import Float32
from torch import Tensor

from sightline.augmentation.sample_changes import crop
from sightline.detection2d.config import InputConfig
from sightline.detection2d.placement import (
    Candidates,
    Placement,
    camera_image,
    lidar_image,
    padded,
    place,
    whole_strides,
)
from sightline.geometry.projection import DHI_RANGE_M
from sightline.structures.level import level_calibration
from sightline.structures.sample import CameraLidarSample

_COARSER: Final = 2  # ratio of the scales of both views
_EDGE_PX, _OVERLAP_PX = 3.0, 20.0  # of the fine view's lower edge, where the coarse one takes over


@dataclass(frozen=True, kw_only=True, slots=True)
class View:
    """A band of a resized frame, which a network is shown."""

    sample: CameraLidarSample
    """The band, at the network's scale, with its calibration."""
    placement: Placement
    """Placement of the band in the frame."""
    range_m: float = DHI_RANGE_M
    """Far end of the LiDAR image's depth channel. Half the scale shows an object like one at twice
    the distance, which half the range tells the network, too."""
    ends_above: float = math.inf
    """Row of the frame [px]; the other view answers for boxes that end on it or below."""
    ends_below: float = -math.inf
    """Row of the frame [px]; the other view answers for boxes that end on it or above."""

    @property
    def full_height(self) -> int:
        """Rows of the resized frame [px]."""
        return round(self.placement.image_size[0] * self.placement.scale_y)

    @property
    def is_cut(self) -> bool:
        """Whether rows of the frame are not in the band."""
        return self.sample.image_size[0] < self.full_height

    def inputs(
        self, names: Sequence[str], config: InputConfig, stride: int
    ) -> dict[str, Float32[Tensor, "1 3 height width"]]:
        """Make the network's inputs, padded to whole strides."""
        images = {
            "image": camera_image(self.sample),
            "lidar": lidar_image(self.sample, config, range_m=self.range_m),
        }
        size = whole_strides(self.sample.image_size, stride)
        return {name: padded(images[name], size)[None] for name in names}

    def own(self, found: Candidates) -> Candidates:
        """Select the candidates for which the view answers."""
        ends = found.boxes[:, 3]
        return found.select((ends < self.ends_above) & (ends > self.ends_below))


def views_of(
    sample: CameraLidarSample, config: InputConfig, *, stride: int, smallest_px: int
) -> tuple[View, ...]:
    """Make the views of a frame: one, or a coarser one, too, if its road is cut off.

    The frame is resized as by `place`. Of its rows, those up to `rows_above_horizon` above the
    horizon and `rows_below_horizon` below it remain; a band that would reach beyond the frame is
    moved into it. KITTI's frames remain whole. Where rows are cut off at the bottom, the same is
    done at half the scale, for near objects: it answers for boxes that end near that border or
    below. The whole frame is one view for a network of one input size, and where the coarser view
    would be smaller than the network's smallest input.

    The horizon is that of the level frame (`CameraLidarSample.level_from_lidar`), at the principal
    point's column.

    Args:
        sample: The frame.
        config: Preparation of frames.
        stride: Stride of the network. Bands begin at a multiple, so that gates fit together.
        smallest_px: Smallest side of the network's input.
    """
    fine = _band(sample, config, stride, scale=config.scale)
    bottom = fine.placement.top + fine.sample.image_size[0]
    if bottom >= fine.full_height:
        return (fine,)
    coarse = _band(sample, config, stride, scale=config.scale / _COARSER)
    if min(whole_strides(coarse.sample.image_size, stride)) < smallest_px:
        given, placement = place(sample, config)
        return (View(sample=given, placement=placement),)
    edge = torch.tensor([0.0, fine.sample.image_size[0] - 1.0, 0.0, 0.0])
    ends = [float(fine.placement.to_image(edge[None] - px)[0, 1]) for px in (_EDGE_PX, _OVERLAP_PX)]
    return (
        replace(fine, ends_above=ends[0]),
        replace(coarse, range_m=DHI_RANGE_M / _COARSER, ends_below=ends[1]),
    )


def _band(sample: CameraLidarSample, config: InputConfig, stride: int, *, scale: float) -> View:
    """Resize a frame and cut it to the rows along the horizon."""
    given, placement = place(sample, replace(config, scale=scale))
    height, width = given.image_size
    horizon = None if config.size is not None else _horizon(given)
    if horizon is None:
        return View(sample=given, placement=placement)
    above = round(config.scale * config.rows_above_horizon)
    below = round(config.scale * config.rows_below_horizon)
    top = min(max(math.floor(horizon - above), 0), max(height - above - below, 0))
    top = top // stride * stride
    bottom = min(max(math.ceil(horizon + below), above + below), height)
    if (top, bottom) == (0, height):
        return View(sample=given, placement=placement)
    band = crop(given, top, 0, bottom - top, width)
    return View(sample=band, placement=replace(placement, top=top))


def _horizon(sample: CameraLidarSample) -> float | None:
    """Row [px] of the horizon straight ahead; None: the camera does not look ahead."""
    calibration = level_calibration(sample.calibration, sample.level_from_lidar)
    ahead = calibration.camera_from_lidar[:3, 0]
    _, y, z = (calibration.image_from_camera[:, :3] @ ahead).tolist()
    return y / z if z > 0 else None


def gate_over_frame(
    gates: Sequence[Float32[Tensor, "groups _rows _columns"]], views: Sequence[View], stride: int
) -> Float32[Tensor, "new_rows new_columns"]:
    """Lay the gates of a frame's views over it: means of groups, without padding.

    The finest view is on top; where no view reaches, the gate is 0, since nothing is used there.

    Args:
        gates: Gate of each view.
        views: Views of the frame, the finest first.
        stride: Stride of the network.
    """
    seen = [_without_padding(gate, view, stride) for gate, view in zip(gates, views, strict=True)]
    first = views[0]
    if len(seen) == 1 and not first.is_cut:
        return seen[0]
    cell_px = whole_strides(first.sample.image_size, stride)[0] / gates[0].shape[1]
    laid = seen[0].new_zeros(max(round(first.full_height / cell_px), 1), seen[0].shape[1])
    middles = [torch.arange(count) + 0.5 for count in laid.shape]
    for gate, view in zip(reversed(seen), reversed(views), strict=True):
        finer = first.full_height / view.full_height
        rows = (middles[0] / finer - view.placement.top / cell_px).floor().long()
        columns = (middles[1] / finer).long().clamp(max=gate.shape[1] - 1)
        is_seen = (rows >= 0) & (rows < gate.shape[0])
        laid[is_seen] = gate[rows[is_seen]][:, columns]
    return laid


def _without_padding(
    gate: Float32[Tensor, "groups rows columns"], view: View, stride: int
) -> Float32[Tensor, "new_rows new_columns"]:
    """Average a gate's groups, and remove the padding."""
    size = view.sample.image_size
    rows, columns = (
        max(round(count * side / whole), 1)
        for count, side, whole in zip(
            gate.shape[1:], size, whole_strides(size, stride), strict=True
        )
    )
    return gate.mean(dim=0)[:rows, :columns].contiguous()
