"""What is wrong with a sweep, told from its points alone."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from sightline.health.ring_order import SEAM_DEG, number_rings, ring_by_ring
from sightline.health.sphere import to_sphere
from sightline.ops.compiled import compiled

CELL_DEG = 1.0
"""Side of the cells of azimuth and elevation that regions are told by."""
LOWEST_DEG, HIGHEST_DEG = -12.0, -1.0
"""Elevations between which the ground, or what stands on it, answers nearly always."""

WIDEST_DEG = 39.0
"""Azimuths up to which a sweep is looked at: KITTI's camera sees a little more."""
SECTOR_DEG = 2.0
"""Width of the sectors of a whole turn."""

_GAP = 1.5  # typical steps of azimuth; a wider one lacks a return
_WIDEST_GAP = 4.5  # beyond it lies no lost return but a hole: glass, sky
_SPIKE_M, _SPIKE_SHARE = 0.1, 0.02  # of the range, by which a false return leaves its neighbours
_ALONE_M = 1.0  # in front of both neighbours: clutter
_CLOSE_M = 20.0  # that of fog, rain and snow lies nearer
_STRAY_DEG = 0.12  # of azimuth or elevation, off the middle of neighbours that are near each other
_LEVER_DEG_M = 12.0  # lasers sit up to 0.2 m off the origin: nearer returns seem turned
_NEAR_M = 25.0  # up to here surfaces are even enough to tell the noise of ranges
_ABOVE_M = -1.3  # the road lies below it, in the LiDAR's frame
_TINY = 1e-4
_FEWEST = 3
_FAR_M = 15.0  # beyond it fog has taken much of the light
_FEWEST_FAR = 50  # returns beyond it, to tell anything by


class LidarChecks(NamedTuple):
    """What is looked at in a sweep; each number grows as the sweep gets worse.

    All but the last look at what lies ahead (`lies_ahead`), a part that KITTI's reduced sweeps hold
    as completely as whole ones do, whatever camera there is.
    """

    sparse: float
    """-log2 of the number of points."""
    ringless: float
    """-log2 of the number of rings."""
    gappy: float
    """Log2 of the share of steps along rings that skip one to three returns."""
    holes: float
    """Share of the cells below the horizon that have no point."""
    narrow: float
    """-log2 of the azimuths [degrees] that have points."""
    rough: float
    """Log2 of how far [m] a return lies off the middle of its neighbours on the ring: the quarter
    of the smallest, near by."""
    spiky: float
    """Log2 of the share of returns that lie off both their neighbours, which agree."""
    stray: float
    """Log2 of the share of returns that are off the ray of their laser: no sound sensor has any."""
    jagged: float
    """Log2 of the unevenness of the steps of azimuth, in degrees."""
    cluttered: float
    """Log2 of the share of spikes that are near and above the road."""
    short: float
    """-log2 of the range [m] that a twentieth of the points exceed."""
    faded: float
    """-log2 of the reflectance that a twentieth of the returns beyond 15 m exceed: fog takes light
    with the distance. NaN where there are hardly any, or all are 0: a sensor that tells none."""
    blind: float
    """Share of the sectors of a whole turn without points; 0 for what the camera sees alone."""


LEAST_SPREADS = LidarChecks(
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
"""By how much each differs between sound LiDARs of other makes: least spreads for limits that shall
serve them, too."""
FEW_RINGS_LEAST_SPREADS = LEAST_SPREADS._replace(sparse=0.8, ringless=0.3, holes=0.3)
"""Least spreads of LiDARs of 32 and 16 beams, which differ more in where their beams point."""


def check_lidar(points: Float32[np.ndarray, "num_points 4"]) -> LidarChecks:
    """Looks at a sweep: a few ms on one core, in another order than KITTI's up to 0.3 s."""
    ahead = ring_by_ring(points[lies_ahead(points)])
    count = len(ahead)
    if count < _FEWEST:
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
"""What is said of a sweep that has no points to look at."""


def lies_ahead(
    points: Float32[np.ndarray, "num_points 4"],
) -> Bool[np.ndarray, " num_points"]:
    """Which points lie within `WIDEST_DEG` of straight ahead and above `LOWEST_DEG`."""
    widest, lowest = (math.tan(math.radians(angle)) for angle in (WIDEST_DEG, LOWEST_DEG))
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    ahead: Bool[np.ndarray, " num_points"] = np.abs(y) < np.float32(widest) * x
    ahead &= z > np.float32(lowest) * np.hypot(x, y)
    return ahead


def _fading(
    ranges: Float32[np.ndarray, " num_points"], reflectances: Float32[np.ndarray, " num_points"]
) -> float:
    far = reflectances[ranges > _FAR_M]
    if len(far) < _FEWEST_FAR or not far.any():
        return math.nan
    return -_log2(max(float(np.quantile(far, 0.95)), 0.0))


def _log2(value: float) -> float:
    return float(np.log2(value + _TINY))


def cell_counts(
    azimuth_deg: Float32[np.ndarray, " num_points"],
    elevation_deg: Float32[np.ndarray, " num_points"],
) -> Int64[np.ndarray, "rows columns"]:
    """Points in each cell ahead, the highest elevations and the leftmost azimuths first."""
    rows = round((HIGHEST_DEG - LOWEST_DEG) / CELL_DEG)
    columns = round(2 * WIDEST_DEG / CELL_DEG)
    row = np.floor((HIGHEST_DEG - elevation_deg) / CELL_DEG).astype(np.int64)
    column = np.floor((WIDEST_DEG - azimuth_deg) / CELL_DEG).astype(np.int64)
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    flat = row[inside] * columns + column[inside]
    return np.bincount(flat, minlength=rows * columns).reshape(rows, columns)


def blind_sectors(points: Float32[np.ndarray, "num_points 4"]) -> Bool[np.ndarray, " num_sectors"]:
    """Of a whole sweep the sectors of azimuth without any point; counter-clockwise from behind.

    Of a sweep that is cut to the camera's view, which has no point behind the sensor, none: it says
    nothing about them.
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
    """Deviations [m] from the middle of both neighbours; numbers of spikes, strays, clutter."""
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
