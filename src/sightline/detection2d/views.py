"""Views of a frame that a network is shown: bands along the horizon, as KITTI's camera sees it.

The networks learned from one camera: 722 px of focal length, level, 375 rows of which 173 lie above
the horizon. What depends on another camera is taken out here: its scale, the height of its view and
its pitch. Sky, upper floors and the own bonnet are not searched; near and far objects are seen at
the sizes that the networks know.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
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
    scale_of,
    whole_strides,
)
from sightline.geometry.projection import DHI_RANGE_M
from sightline.structures.level import horizon_row
from sightline.structures.sample import CameraLidarSample

_STEP: Final = 2  # ratio of the scales of two views
_EDGE_PX: Final = 3.0  # a box that comes as near to where a view is cut off is cut off, too
_NEAR_PX: Final = 60.0  # least height of the coarser view's boxes
_FAR_PX: Final = 80.0  # greatest height of the finer view's boxes


LEAST_STEP: Final = 1.3
"""Least ratio of a finer view's scale to the first one's; it has no more pixels than the frame."""


@dataclass(frozen=True, kw_only=True, slots=True)
class View:
    """A band of a resized frame, which a network is shown."""

    sample: CameraLidarSample
    """The band, at the network's scale, with its calibration."""
    placement: Placement
    """Placement of the band in the frame."""
    range_m: float = DHI_RANGE_M
    """Far end of the LiDAR image's depth channel. At half the scale an object looks as if it were
    twice as far away; half the range gives its depth the matching value."""
    heights_px: tuple[float, float] = (0.0, math.inf)
    """Heights of the boxes that are taken from this view, in pixels of the band."""

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
        """Select the candidates that are taken from this view.

        They have suitable heights and, unless it is the coarsest view, do not touch an edge where
        it is cut off.
        """
        heights = (found.boxes[:, 3] - found.boxes[:, 1]) * self.placement.scale_y
        least, greatest = self.heights_px
        is_own = (heights >= least) & (heights < greatest)
        if self.is_cut and not least:
            start, end = self.placement.top, self.placement.top + self.sample.image_size[0]
            edges = torch.tensor([[0.0, _EDGE_PX, 0.0, end - start - 1 - _EDGE_PX]])
            _, first, _, last = self.placement.to_image(edges)[0].tolist()
            is_own &= (found.boxes[:, 1] >= first) | (start == 0)
            is_own &= (found.boxes[:, 3] <= last) | (end == self.full_height)
        return found.select(is_own)


def views_of(
    sample: CameraLidarSample, config: InputConfig, *, stride: int, smallest_px: int
) -> tuple[View, ...]:
    """Make the views of a frame: one, two or three.

    The first is the frame resized as by `place`. Of its rows, those up to `rows_above_horizon`
    above the horizon and `rows_below_horizon` below it remain; a band that would reach beyond the
    frame is moved into it. So frames with no more rows than both together remain whole, like all of
    KITTI's.

    Where rows are cut off, a view of half the scale adds near objects. If the frame has 1.3 times
    the scale, a view of up to twice the scale adds far ones. The whole frame is the only view for a
    network of one input size, and where a view would be smaller than the network's smallest input.

    The horizon is that of the level frame (`CameraLidarSample.level_from_lidar`), straight ahead.

    Args:
        sample: The frame.
        config: Preparation of frames.
        stride: Stride of the network. Bands begin at a multiple, so that gates fit together.
        smallest_px: Smallest side of the network's input.
    """
    if config.size is not None:
        given, placement = place(sample, config)
        return (View(sample=given, placement=placement),)
    views = [_band(sample, config, config.scale, stride)]
    first = views[0]
    if first.is_cut:
        views.append(_beside(first, _band(sample, config, config.scale / _STEP, stride)))
    longer = replace(config, longest_focal_px=_STEP * config.longest_focal_px)
    if scale_of(sample, longer) >= LEAST_STEP * scale_of(sample, config):
        views.append(_beside(first, _band(sample, longer, config.scale, stride)))
    if min(min(whole_strides(view.sample.image_size, stride)) for view in views) < smallest_px:
        given, placement = place(sample, config)
        return (View(sample=given, placement=placement),)
    return tuple(views)


def draw_band(
    sample: CameraLidarSample, config: InputConfig, stride: int, rng: np.random.Generator
) -> tuple[CameraLidarSample, float, float]:
    """Draw one of a frame's views for training; a frame with a single whole view stays whole.

    Returns:
        The rows of the frame that the view shows, not resized; its scale; its `range_m`.
    """
    bare = replace(sample, image=None, points=None)  # of which only the geometry is resized
    views = views_of(bare, config, stride=stride, smallest_px=stride)
    view = views[int(rng.integers(len(views)))]
    scale = view.placement.scale_y
    if not view.is_cut:
        return sample, scale, view.range_m
    height, width = sample.image_size
    top = min(round(view.placement.top / scale), height - 1)
    rows = min(max(round(view.sample.image_size[0] / scale), 1), height - top)
    return crop(sample, top, 0, rows, width), scale, view.range_m


def _beside(first: View, other: View) -> View:
    """Complete a coarser or finer view by the distances and sizes that it has for the network."""
    ratio = other.placement.scale_y / first.placement.scale_y
    heights_px = (_NEAR_PX, math.inf) if ratio < 1 else (0.0, _FAR_PX)
    return replace(other, range_m=DHI_RANGE_M * ratio, heights_px=heights_px)


def _band(sample: CameraLidarSample, config: InputConfig, scale: float, stride: int) -> View:
    """Resize a frame and cut it to the rows along the horizon."""
    given, placement = place(sample, replace(config, scale=scale))
    height, width = given.image_size
    horizon = horizon_row(given)
    above = round(config.scale * config.rows_above_horizon)
    below = round(config.scale * config.rows_below_horizon)
    if horizon is None or height <= above + below:
        return View(sample=given, placement=placement)
    top = min(max(math.floor(horizon - above), 0), height - above - below) // stride * stride
    bottom = min(max(math.ceil(horizon + below), above + below), height)
    band = crop(given, top, 0, bottom - top, width)
    return View(sample=band, placement=replace(placement, top=top))


def gate_over_frame(
    gates: Sequence[Float32[Tensor, "groups _rows _columns"]], views: Sequence[View], stride: int
) -> Float32[Tensor, "new_rows new_columns"]:
    """Lay the gates of a frame's views over it: means of groups, without padding.

    The first view is on top, a coarser one around it, a finer one is left out. Where none reaches,
    the gate is 0, since nothing is used there.

    Args:
        gates: Gate of each view.
        views: Views of the frame.
        stride: Stride of the network.
    """
    first = views[0]
    seen = [_without_padding(gate, view, stride) for gate, view in zip(gates, views, strict=True)]
    if not first.is_cut:
        return seen[0]
    cell_px = whole_strides(first.sample.image_size, stride)[0] / gates[0].shape[1]
    laid = seen[0].new_zeros(max(round(first.full_height / cell_px), 1), seen[0].shape[1])
    middles = [torch.arange(count) + 0.5 for count in laid.shape]
    for gate, view in zip(reversed(seen), reversed(views), strict=True):
        finer = first.full_height / view.full_height
        if finer < 1:
            continue
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
