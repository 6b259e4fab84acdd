"""Sweep quality checks, from the points alone."""

import math
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from sightline.health.ring_order import SEAM_DEG, number_rings, ring_by_ring
from sightline.health.sphere import to_sphere
from sightline.ops.compiled import compiled

CELL_DEG = 1.0
"""Side of the azimuth and elevation cells of sweep regions."""
LOWEST_DEG, HIGHEST_DEG = -12.0, -1.0
"""Elevation range in which the ground, or objects on it, nearly always return an echo."""

WIDEST_DEG = 39.0
"""Maximum azimuth of the checked part of a sweep: KITTI's camera covers a little more."""
SECTOR_DEG = 2.0
"""Width of the azimuth sectors of a whole turn."""

_GAP = 1.5  # typical steps of azimuth; a wider one lacks a return
_WIDEST_GAP = 4.5  # a wider one is not a lost return but a hole: glass, sky
_SPIKE_M, _SPIKE_SHARE = 0.1, 0.02  # minimum offset of a false return, also as a share of the range
_ALONE_M = 1.0  # distance of clutter in front of both neighbours
_CLOSE_M = 20.0  # maximum range of clutter from fog, rain and snow
_STRAY_DEG = 0.12  # offset of azimuth or elevation from the middle of two close neighbours
_LEVER_DEG_M = 12.0  # lasers are up to 0.2 m off the origin: near returns appear rotated
_NEAR_M = 25.0  # range up to which surfaces are even enough to measure the range noise
_ABOVE_M = -1.3  # minimum height of clutter, above the road, in the LiDAR's frame
_TINY = 1e-4
_SMALLEST_HOLE = 12  # connected cells; fewer are glass or a dark car
_MIN_POINTS = 3
_FAR_M = 15.0  # range beyond which fog absorbs much of the light
_MIN_FAR_POINTS = 50  # minimum number of returns beyond it


class LidarChecks(NamedTuple):
    """Checks of a sweep; a larger number is a worse sweep.

    All but the last use the part ahead (`is_ahead`), which is as complete in KITTI's reduced
    sweeps as in whole ones, for any camera.
    """

    sparse: float
    """-log2 of the number of points."""
    ringless: float
    """-log2 of the number of rings."""
    gappy: float
    """Log2 of the share of steps along rings that skip one to three returns."""
    holes: float
    """Share of the cells below the horizon without points."""
    narrow: float
    """-log2 of the azimuth range [degrees] with points."""
    rough: float
    """Log2 of the distance [m] of a return from the middle of its neighbours on the ring: the 25 %
    quantile, at short range."""
    spiky: float
    """Log2 of the share of returns that differ from both their neighbours, which agree."""
    stray: float
    """Log2 of the share of returns off the ray of their laser: sound sensors have none."""
    jagged: float
    """Log2 of the unevenness of the steps of azimuth, in degrees."""
    cluttered: float
    """Log2 of the share of spikes at short range and above the road."""
    short: float
    """-log2 of the 95 % quantile of the range [m]."""
    faded: float
    """-log2 of the 95 % quantile of the reflectance beyond 15 m: fog absorbs light with distance.
    NaN with too few returns there, or if all are 0: the sensor measures no reflectance."""
    blind: float
    """Share of the azimuth sectors of a whole turn without points; 0 for sweeps cut to the camera's
    view."""


MIN_SPREADS = LidarChecks(
    sparse=0.4,
    ringless=0.06,
    gappy=0.6,
    holes=0.12,
    narrow=0.05,
    rough=1.4,
    spiky=1.0,
    stray=1.0,
    jagged=2.0,
    cluttered=1.0,
    short=1.3,
    faded=0.25,
    blind=0.01,
)
"""Minimum spreads for limits that also serve other sensors: variation of each check between sound
LiDARs of other makes."""
FEW_RINGS_MIN_SPREADS = MIN_SPREADS._replace(
    sparse=0.8, ringless=0.3, holes=0.3, spiky=1.8, stray=2.0, faded=1.5
)
"""Minimum spreads for LiDARs of 32 and 16 beams, which differ more in their beam directions, in the
share of beams that pass trees and poles, and in the scale of their reflectances."""


def check_lidar(points: Float32[np.ndarray, "num_points 4"]) -> LidarChecks:
    """Check a sweep: a few ms on one core, up to 0.3 s for another point order than KITTI's."""
    ahead = ring_by_ring(points[is_ahead(points)])
    count = len(ahead)
    if count < _MIN_POINTS:
        return NOTHING
    ranges, azimuth, elevation = to_sphere(ahead)
    steps = np.diff(azimuth)
    num_rings = int(number_rings(azimuth)[-1]) + 1
    widths = np.abs(steps)
    step = float(np.median(widths))
    gaps = (widths > _GAP * step) & (widths < _WIDEST_GAP * step)
    empty = cell_counts(azimuth, elevation) == 0
    columns = np.unique(np.floor(azimuth).astype(np.int64))
    rough, num_spikes, num_stray, num_clutter = _compare_neighbours(
        *(each.astype(np.float64) for each in (ranges, azimuth, elevation, ahead[:, 2]))
    )
    return LidarChecks(
        sparse=-_log2(float(count)),
        ringless=-_log2(float(num_rings)),
        gappy=_log2(float(gaps.mean())),
        holes=float(empty.mean()),
        narrow=-_log2(float(len(columns))),
        rough=_log2(float(np.quantile(rough, 0.25)) if len(rough) else 0.0),
        spiky=_log2(num_spikes / count),
        stray=_log2(num_stray / count),
        jagged=_log2(float(np.median(np.abs(widths - step)))),
        cluttered=_log2(num_clutter / count),
        short=-_log2(float(np.quantile(ranges, 0.95))),
        faded=_fading(ranges, ahead[:, 3]),
        blind=float(blind_sectors(points).mean()),
    )


NOTHING = LidarChecks(*(float("inf"),) * len(LidarChecks._fields))
"""Checks of a sweep without points."""


def is_ahead(
    points: Float32[np.ndarray, "num_points 4"],
) -> Bool[np.ndarray, " num_points"]:
    """Test which points lie within `WIDEST_DEG` of straight ahead and above `LOWEST_DEG`."""
    widest, lowest = (math.tan(math.radians(angle)) for angle in (WIDEST_DEG, LOWEST_DEG))
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    ahead: Bool[np.ndarray, " num_points"] = np.abs(y) < np.float32(widest) * x
    ahead &= z > np.float32(lowest) * np.hypot(x, y)
    return ahead


def _fading(
    ranges: Float32[np.ndarray, " num_points"], reflectances: Float32[np.ndarray, " num_points"]
) -> float:
    far = reflectances[ranges > _FAR_M]
    if len(far) < _MIN_FAR_POINTS or not far.any():
        return math.nan
    return -_log2(max(float(np.quantile(far, 0.95)), 0.0))


def _log2(value: float) -> float:
    return float(np.log2(value + _TINY))


def cell_counts(
    azimuth_deg: Float32[np.ndarray, " num_points"],
    elevation_deg: Float32[np.ndarray, " num_points"],
) -> Int64[np.ndarray, "rows columns"]:
    """Count the points in each cell ahead, from the top elevation and the leftmost azimuth."""
    rows = round((HIGHEST_DEG - LOWEST_DEG) / CELL_DEG)
    columns = round(2 * WIDEST_DEG / CELL_DEG)
    row = np.floor((HIGHEST_DEG - elevation_deg) / CELL_DEG).astype(np.int64)
    column = np.floor((WIDEST_DEG - azimuth_deg) / CELL_DEG).astype(np.int64)
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    flat = row[inside] * columns + column[inside]
    return np.bincount(flat, minlength=rows * columns).reshape(rows, columns)


def blind_sectors(points: Float32[np.ndarray, "num_points 4"]) -> Bool[np.ndarray, " num_sectors"]:
    """Mark the azimuth sectors of a whole sweep without points; counter-clockwise from behind.

    A sweep cut to the camera's view has no points behind the sensor; then no sector is marked.
    """
    sectors = round(360 / SECTOR_DEG)
    if not (points[:, 0] < 0).any():
        return np.zeros(sectors, dtype=np.bool_)
    azimuth_deg = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    sector = np.floor((azimuth_deg + 180) / SECTOR_DEG).astype(np.int64) % sectors
    blind: Bool[np.ndarray, " num_sectors"] = np.bincount(sector, minlength=sectors) == 0
    return blind


@compiled
def _compare_neighbours(
    ranges: Float64[np.ndarray, " num_points"],
    azimuth: Float64[np.ndarray, " num_points"],
    elevation: Float64[np.ndarray, " num_points"],
    height: Float64[np.ndarray, " num_points"],
) -> tuple[Float64[np.ndarray, " num_near"], int, int, int]:
    """Compute deviations [m] from the middle of both neighbours; count spikes, strays, clutter."""
    deviations = np.empty(len(ranges))
    count, num_spikes, num_stray, num_clutter = 0, 0, 0, 0
    for i in range(1, len(ranges) - 1):
        first, last = azimuth[i] - azimuth[i - 1], azimuth[i + 1] - azimuth[i]
        if first < -SEAM_DEG or last < -SEAM_DEG:
            continue
        before, here, after = ranges[i - 1], ranges[i], ranges[i + 1]
        off = abs(here - 0.5 * (before + after))
        limit = _SPIKE_M + _SPIKE_SHARE * here
        if abs(before - after) < limit and off > limit:
            num_spikes += 1
        lifted = abs(elevation[i] - 0.5 * (elevation[i - 1] + elevation[i + 1]))
        swung = min(abs(first), abs(last)) if first * last < 0 else 0.0
        agree = abs(elevation[i + 1] - elevation[i - 1]) < _STRAY_DEG
        parallax = abs(1 / max(here, 0.1) - 2 / max(before + after, 0.1))
        if agree and max(lifted, swung) > _STRAY_DEG + _LEVER_DEG_M * parallax:
            num_stray += 1
        in_front = here < min(before, after) - _ALONE_M
        if in_front and here < _CLOSE_M and height[i] > _ABOVE_M:
            num_clutter += 1
        if here < _NEAR_M:
            deviations[count] = off
            count += 1
    return deviations[:count], num_spikes, num_stray, num_clutter


def bad_sweep_regions(
    points: Float32[np.ndarray, "num_points 4"],
) -> Bool[np.ndarray, "rows columns"]:
    """Mark `CELL_DEG` cells below the horizon in large holes without points."""
    _, azimuth_deg, elevation_deg = to_sphere(points)
    empty = (cell_counts(azimuth_deg, elevation_deg) == 0).astype(np.uint8)
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(empty, connectivity=4)
    large = statistics[:, cv2.CC_STAT_AREA] >= _SMALLEST_HOLE
    large[0] = False  # label of the cells that are not empty
    bad: Bool[np.ndarray, "rows columns"] = large[labels]
    return bad
