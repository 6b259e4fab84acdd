"""Depth completion that adapts to the spacing of the measurements, from 64 beams down to 8."""

from dataclasses import dataclass, fields
from typing import Final, Literal, get_args

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float32, Int64

from sightline.depth_completion.adaptive_kernels import (
    NO_NEIGHBOUR,
    bridge_rows,
    fill_columns,
    gap_counts,
    hidden_pixels,
    inverse,
    move_towards,
    right_neighbours,
    smooth_rows,
    trace_rings,
)
from sightline.depth_completion.classical import classical_depth
from sightline.depth_completion.sparse_map import check_sparse_depth
from sightline.structures.predictions import DepthMap

HiddenRule = Literal["contrast", "window"]
"""Search range for nearer returns that hide a return from the camera. `contrast`: grows with the
difference of the inverse depths, as parallax does. `window`: constant (versions up to 0.2)."""

MAX_SPACING_PX = 64  # largest spacing within a ring; bounds the search in very sparse maps
HOLE_COLUMNS = 3  # column spacings beyond the valid guesses at which a hole begins
SMOOTHING_PASSES = 2  # two running means make a triangle
SEARCH_COLUMNS = 5  # column spacings to each side of the search for the nearest return
KITTI_COLUMNS = 3  # column spacing of KITTI's sweeps in its images [px]
# Rule "contrast": reach in ring spacings (beside: column spacings), and its growth in column
# spacings per difference of inverse depths [m]. Wider than the parallax of KITTI's mount, some 20:
# true depth bleeds at edges too. Tuned on frames with real depth truth.
REACH_ABOVE, REACH_BELOW, REACH_BESIDE = (0.6, 50.0), (0.8, 133.0), (4 / 3, 40 / 3)
NEAR_PX = 5  # side of the square around a measurement where morphological completion is used
_MEDIAN_PX, _GAUSS_PX, GAUSS_SIGMA_PX = 5, 5, 0.8


@dataclass(frozen=True, kw_only=True, slots=True)
class AdaptiveConfig:
    """Settings of adaptive completion, in multiples of the spacings measured in each map.

    Column spacing: columns between neighbours of a ring; grows with the focal length. Ring
    spacing: rows between neighbouring rings. Tuned on 13 KITTI frames with real depth truth.
    """

    surface_ratio: float = 1.05
    """Largest ratio of two neighbouring depths on one surface."""
    ground_slope: float = 0.0016
    """Largest growth of inverse depth [1/m] per row downwards on one surface in KITTI's images,
    for any depth ratio; twice the growth on a level road."""
    nearer_share: float = 0.7
    """Share of a gap between two surfaces that takes the nearer surface's depth. Negative: such
    gaps are interpolated linearly, like all gaps between sparse rings."""
    dense_rings: float = 2.5
    """Largest ring spacing of dense rings, in column spacings."""
    hidden_rule: HiddenRule = "contrast"
    """Rule for nearer measurements that hide a farther one from the camera."""
    hidden_ratio: float = 1.2
    """Smallest depth ratio at which a nearer measurement hides another."""
    hidden_rows: float = 5.0
    """Rule `window`: search range above and below, in column spacings; at least one ring
    spacing."""
    hidden_columns: float = 2.0
    """Rule `window`: search range to each side, in column spacings."""
    link_columns: float = 4.0
    """Longest bridged gap within a ring, in column spacings."""
    smoothing: float = 0.25
    """Averaged columns to either side, per row of distance to the nearest ring."""
    softening: float = 0.01
    """Largest relative difference to the smoothed local median; depths beyond it take the
    median's value. Infinite: depths stay unchanged."""
    trusted_rings: float = 4.0
    """Largest valid gap between two rings, in ring spacings."""
    classical_share: float = 0.5
    """Weight of morphological completion (`classical_depth`) near measurements where both methods
    differ, if the ring spacing is within the reach of its kernels."""
    classical_difference: float = 0.03
    """Smallest relative difference of the two methods at which they are mixed."""
    classical_rows: float = 7.0
    """Largest ring spacing [px] at which morphological completion is mixed in."""

    def __post_init__(self) -> None:
        """Check the choices and ranges."""
        if self.hidden_rule not in get_args(HiddenRule):
            raise ValueError(
                f"hidden_rule must be one of {', '.join(get_args(HiddenRule))}, got "
                f"{self.hidden_rule!r}"
            )
        minimum = {"surface_ratio": 1.0, "hidden_ratio": 1.0, "nearer_share": -1.0}
        maximum = {"nearer_share": 1.0, "classical_share": 1.0, "softening": np.inf}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, str):
                continue
            low, high = minimum.get(field.name, 0.0), maximum.get(field.name)
            if not low <= value <= (np.finfo(float).max if high is None else high):
                bound = "finite" if high is None else f"at most {high:g}"
                raise ValueError(f"{field.name} must be at least {low} and {bound}, got {value}")


FIRST_EDITION: Final = AdaptiveConfig(
    surface_ratio=1.15,
    nearer_share=-1.0,
    hidden_rule="window",
    hidden_ratio=1.15,
    softening=np.inf,
    classical_share=0.0,
)
"""Adaptive completion of versions up to 0.2, from which the shipped networks start."""


def adaptive_depth(
    sparse_depth_m: Float32[np.ndarray, "height width"],
    config: AdaptiveConfig = AdaptiveConfig(),
) -> DepthMap:
    """Complete depth between the rings of a sweep, for any number of rings.

    1. Measures the spacing along and between rings.
    2. Removes measurements that have nearer ones both above and below, within the distance that
       parallax may move a surface: the LiDAR measures points that are hidden from the camera.
    3. Joins each measurement to the next of its ring, linear in inverse depth on one surface.
    4. Fills columns between rings, linear in inverse depth on one surface, which is exact for
       planes. Between two surfaces the nearer one fills most of the gap. The top ring's depth
       continues upwards, the slope of the ground continues below the lowest ring.
    5. Fills missing parts of the sweep along rows, between the valid pixels on either side.
    6. Averages depth along rows to remove stripes, wider with the distance from a ring, and
       replaces depths that differ from the local median.
    7. With about 64 beams, takes the mean with morphological completion, whose errors at contours
       are different.

    If anything is measured, every pixel gets a depth. Pixels are valid between two rings that are
    not too far apart, and within a ring spacing of a ring; the rest, such as the sky, is a guess.
    Measured pixels that are not hidden keep their values. Takes some 15 ms on one core for
    1216x352.

    Raises:
        ValueError: `sparse_depth_m` contains invalid depths.
    """
    check_sparse_depth(sparse_depth_m)
    indices = np.flatnonzero(sparse_depth_m > 0)
    pixels = np.stack(np.divmod(indices, sparse_depth_m.shape[1]), axis=1)
    if not len(pixels):
        return DepthMap(
            depth_m=torch.zeros(sparse_depth_m.shape),
            valid=torch.zeros(sparse_depth_m.shape, dtype=torch.bool),
        )
    inverse_depth = inverse(sparse_depth_m)
    spacing = _measure_spacing(inverse_depth, pixels)
    is_hidden = _find_hidden(inverse_depth, pixels, spacing, config)
    inverse_depth[*pixels[is_hidden].T] = 0
    pixels = pixels[~is_hidden]
    depth_m, is_trusted = _between_rings(inverse_depth, pixels, spacing, config)
    depth_m = _limit_to_median(depth_m, config.softening)
    if config.classical_share and spacing.rows <= config.classical_rows:
        depth_m = _mix_with_classical(depth_m, sparse_depth_m, config)
    depth_m[*pixels.T] = sparse_depth_m[*pixels.T]  # undoes the rounding of two inversions
    return DepthMap(depth_m=torch.from_numpy(depth_m), valid=torch.from_numpy(is_trusted))


def _between_rings(
    inverse_depth: Float32[np.ndarray, "height width"],
    pixels: Int64[np.ndarray, "n 2"],
    spacing: "_Spacing",
    config: AdaptiveConfig,
) -> tuple[Float32[np.ndarray, "height width"], Bool[np.ndarray, "height width"]]:
    """Run steps 3 to 5 and the averaging of 6; returns depth [m] and the mask of valid pixels."""
    traced = _trace(inverse_depth, pixels, spacing, config)
    is_dense = spacing.rows <= config.dense_rings * spacing.columns
    filled, distance, is_trusted = fill_columns(
        traced,
        config.trusted_rings * spacing.rows,
        spacing.rows,
        config.surface_ratio,
        config.ground_slope * KITTI_COLUMNS / spacing.columns,
        config.nearer_share if is_dense else -1.0,
    )
    has_rings = filled[0] > 0  # a column is filled from top to bottom or not at all
    to_ring = np.where(has_rings, distance, np.float32(np.inf))
    if not has_rings.all():
        nearest = _nearest_true(has_rings)
        filled, distance = filled.take(nearest, axis=1), distance.take(nearest, axis=1)
    min_hole_distance = float(spacing.rows + HOLE_COLUMNS * spacing.columns)
    depth_m = inverse(bridge_rows(filled, to_ring, is_trusted, min_hole_distance))
    for _ in range(SMOOTHING_PASSES):
        depth_m = smooth_rows(depth_m, distance, config.smoothing)
    return depth_m, is_trusted


def _limit_to_median(
    depth_m: Float32[np.ndarray, "height width"], tolerance: float
) -> Float32[np.ndarray, "height width"]:
    """Replace depths that differ from the smoothed local median by the median."""
    if not np.isfinite(tolerance):
        return depth_m
    median = cv2.medianBlur(depth_m, _MEDIAN_PX)
    smooth = cv2.GaussianBlur(median, (_GAUSS_PX, _GAUSS_PX), GAUSS_SIGMA_PX)
    return move_towards(depth_m, smooth, smooth > 0, tolerance, 1.0)


def _mix_with_classical(
    depth_m: Float32[np.ndarray, "height width"],
    sparse_depth_m: Float32[np.ndarray, "height width"],
    config: AdaptiveConfig,
) -> Float32[np.ndarray, "height width"]:
    """Average with morphological completion near and above measurements, where both differ."""
    filtered = classical_depth(sparse_depth_m).depth_m.numpy()
    beside = cv2.dilate((sparse_depth_m > 0).view(np.uint8), np.ones((1, NEAR_PX), np.uint8))
    is_near = cv2.dilate(beside, np.ones((NEAR_PX, 1), np.uint8)) > 0
    is_above = beside.argmax(axis=0) > np.arange(len(beside))[:, None]
    return move_towards(
        depth_m,
        filtered,
        (is_near | is_above) & (filtered > 0),
        config.classical_difference,
        config.classical_share,
    )


@dataclass(frozen=True, slots=True)
class _Spacing:
    """Median spacing of measured pixels."""

    columns: int
    """Columns between neighbours of a ring."""
    rows: int
    """Rows between neighbouring rings."""


def _measure_spacing(
    inverse_depth: Float32[np.ndarray, "height width"], pixels: Int64[np.ndarray, "n 2"]
) -> _Spacing:
    steps = right_neighbours(inverse_depth, pixels, MAX_SPACING_PX, MAX_SPACING_PX)
    gaps = steps[steps[:, 0] != NO_NEIGHBOUR, 0]
    columns = int(np.median(gaps)) if len(gaps) else 1
    covered = cv2.dilate(inverse_depth, np.ones((1, columns | 1), np.uint8)) > 0
    cumulative = np.cumsum(gap_counts(covered))
    rows = int(np.searchsorted(cumulative, cumulative[-1] / 2)) if cumulative[-1] else columns
    return _Spacing(columns, rows)


def _find_hidden(
    inverse_depth: Float32[np.ndarray, "height width"],
    pixels: Int64[np.ndarray, "n 2"],
    spacing: _Spacing,
    config: AdaptiveConfig,
) -> Bool[np.ndarray, " n"]:
    """Mask of the measured pixels that are hidden from the camera, by `config.hidden_rule`."""
    if config.hidden_rule == "window":
        beside = float(round(config.hidden_columns * spacing.columns))
        rows = float(max(round(config.hidden_rows * spacing.columns), spacing.rows))
        above, below, columns = (rows, 0.0), (rows, 0.0), (beside, 0.0)
    else:
        above, below, columns = (
            (base * unit, growth * spacing.columns)
            for (base, growth), unit in zip(
                (REACH_ABOVE, REACH_BELOW, REACH_BESIDE),
                (spacing.rows, spacing.rows, spacing.columns),
                strict=True,
            )
        )
    reach = max(SEARCH_COLUMNS * spacing.columns, spacing.rows)
    window = np.ones((2 * reach + 1, 2 * SEARCH_COLUMNS * spacing.columns + 1), np.uint8)
    nearest_around = cv2.dilate(inverse_depth, window)
    return hidden_pixels(
        inverse_depth, nearest_around, pixels, config.hidden_ratio, above, below, columns
    )


def _trace(
    inverse_depth: Float32[np.ndarray, "height width"],
    pixels: Int64[np.ndarray, "n 2"],
    spacing: _Spacing,
    config: AdaptiveConfig,
) -> Float32[np.ndarray, "height width"]:
    reach_columns = round(config.link_columns * spacing.columns)
    reach_rows = max(spacing.rows // 2, 1)  # half way to the next ring
    steps = right_neighbours(inverse_depth, pixels, reach_columns, reach_rows)
    return trace_rings(inverse_depth, pixels, steps, config.surface_ratio)


def _nearest_true(is_true: Bool[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Index of the nearest true entry for each index; the left one at a tie."""
    true_indices = np.flatnonzero(is_true)
    indices = np.arange(len(is_true))
    right = np.searchsorted(true_indices, indices).clip(max=len(true_indices) - 1)
    left = (right - 1).clip(min=0)
    is_left = np.abs(true_indices[left] - indices) <= np.abs(true_indices[right] - indices)
    return true_indices[np.where(is_left, left, right)]
