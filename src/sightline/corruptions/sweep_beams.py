"""Beams of a sweep, whatever LiDAR took it: of an assumed LiDAR, or its own rings."""

from typing import Final, NamedTuple

import numpy as np
import torch
from jaxtyping import Float32, Float64, Int64

from sightline.corruptions.sensor import SpinningLidar
from sightline.data.formats.lidar_origin import seen_from_lidar
from sightline.data.formats.ring_elevations import elevations_deg, rings_by_elevation
from sightline.data.formats.rings import rings_of_any_order
from sightline.geometry.intensity_checks import holds_rings
from sightline.geometry.user_warning import warn_user
from sightline.structures.sample import CameraLidarSample

_MIN_POINTS: Final = 1000  # with fewer points, rings are not searched
_MIN_RING_POINTS: Final = 20  # of a ring whose elevation counts
_FAR_SHARE: Final = 0.75  # nearer points of a ring seem higher: lasers sit above the origin
_MAX_DOUBTFUL_SHARE: Final = 0.15  # of points between rings, which noise moves there
_MIN_EXPLAINED_SHARE: Final = 0.9  # of the elevations' variance, explained by ring numbers
_RING_SLACK_DEG: Final = 2.0  # of rings beyond a LiDAR's view; KITTI's seem up to 1.3 higher
_MIN_RINGS_A_BEAM: Final = 0.8  # of a LiDAR that has no ring between its beams; KITTI's have 1
_VIEW_SHARES: Final = (0.01, 0.99)  # of the points: edges of the view
_VIEW_SLACK_DEG: Final = 3.0  # of these beyond a LiDAR's view; KITTI's near points: up to 2.2


class SweepBeams(NamedTuple):
    """Beams of a sweep."""

    numbers: Int64[np.ndarray, " num_points"]
    """Beam of each point, from the top."""
    num_beams: int


def beams_of(sample: CameraLidarSample, lidar: SpinningLidar) -> SweepBeams:
    """Find the beams of a sample's sweep in the LiDAR's own frame.

    They are those of the assumed LiDAR, nearest in elevation (`SpinningLidar.ring_of`), if the
    rings of the sweep lie in its view at least as densely as its beams. Otherwise they are the
    rings themselves, in any order of the points: those without a return have no number. Points in
    a vehicle's frame are seen from KITTI's height of a LiDAR.

    A sweep without rings, such as of a solid-state LiDAR, and one of few points also have the beams
    of the assumed LiDAR; it warns if the points do not lie in its view.
    """
    points = _own_points(sample)
    assumed = SweepBeams(lidar.ring_of(torch.from_numpy(points)).numpy(), lidar.num_beams)
    if len(points) < _MIN_POINTS:
        return assumed
    rings = _rings(points)
    if rings is None:
        if not _is_in_view(_edges_deg(points), lidar, _VIEW_SLACK_DEG):
            highest, lowest = lidar.beam_elevations_deg[0], lidar.beam_elevations_deg[-1]
            warn_user(
                "a sweep shows no rings, by order or by elevation, as of a solid-state LiDAR, or "
                f"after a correction for motion: the {lidar.num_beams} beams of the assumed LiDAR, "
                f"{lowest:g} to {highest:g} degrees, stand for its own, so shares of lost points "
                "differ from the documented ones; give sweeps of a spinning LiDAR in its "
                "own frame as it took them, or another kind",
            )
        return assumed
    rings_deg = _ring_elevations_deg(points, rings)
    if not len(rings_deg) or _is_of(lidar, rings_deg):
        return assumed
    return SweepBeams(rings, int(rings.max()) + 1)


def view_of(sample: CameraLidarSample, lidar: SpinningLidar) -> tuple[float, float]:
    """Find the lowest and the highest elevation [degrees] of a sweep's LiDAR in its own frame.

    They are those of the assumed LiDAR, unless the sweep's points lie beyond.
    """
    points = _own_points(sample)
    edges_deg = _edges_deg(points) if len(points) >= _MIN_POINTS else None
    if edges_deg is None or _is_in_view(edges_deg, lidar, _VIEW_SLACK_DEG):
        return lidar.beam_elevations_deg[-1], lidar.beam_elevations_deg[0]
    return float(edges_deg[0]), float(edges_deg[1])


def _own_points(sample: CameraLidarSample) -> Float32[np.ndarray, "num_points 4"]:
    """Points as seen from the LiDAR."""
    points = seen_from_lidar(sample).points
    assert points is not None, "a LiDAR's corruption has a sweep"
    array: Float32[np.ndarray, "num_points 4"] = points.numpy()
    return array


def _rings(
    points: Float32[np.ndarray, "num_points 4"],
) -> Int64[np.ndarray, " num_points"] | None:
    """Number the rings from the top; None if there are none."""
    try:
        rings, _ = rings_of_any_order(points)
    except ValueError:
        try:
            rings = rings_by_elevation(points, _MAX_DOUBTFUL_SHARE, try_leaning=False)
        except ValueError:
            return None
    return rings if holds_rings(rings, points, min_share=_MIN_EXPLAINED_SHARE) else None


def _ring_elevations_deg(
    points: Float32[np.ndarray, "num_points 4"], rings: Int64[np.ndarray, " num_points"]
) -> Float64[np.ndarray, " num_rings"]:
    """Median elevations of the farthest points of each ring with enough points."""
    elevations, ranges_m = elevations_deg(points), np.linalg.norm(points[:, :3], axis=1)
    found = []
    for number in np.flatnonzero(np.bincount(rings) >= _MIN_RING_POINTS):
        is_ring = rings == number
        far_m = np.quantile(ranges_m[is_ring], _FAR_SHARE)
        found.append(float(np.median(elevations[is_ring][ranges_m[is_ring] >= far_m])))
    return np.array(found, dtype=np.float64)


def _is_of(lidar: SpinningLidar, rings_deg: Float64[np.ndarray, " num_rings"]) -> bool:
    """Test whether each beam of a LiDAR takes its share of rings: they fill its view."""
    beams = np.array(lidar.beam_elevations_deg)
    view_deg = np.array([rings_deg.min(), rings_deg.max()])
    low, high = np.abs(beams - view_deg[:, None]).argmin(axis=1)
    is_dense = len(rings_deg) >= _MIN_RINGS_A_BEAM * (low - high + 1)
    return bool(is_dense) and _is_in_view(view_deg, lidar, _RING_SLACK_DEG)


def _edges_deg(points: Float32[np.ndarray, "num_points 4"]) -> Float64[np.ndarray, "2"]:
    edges_deg: Float64[np.ndarray, "2"] = np.quantile(elevations_deg(points), _VIEW_SHARES)
    return edges_deg


def _is_in_view(view_deg: Float64[np.ndarray, "2"], lidar: SpinningLidar, slack_deg: float) -> bool:
    beams = lidar.beam_elevations_deg
    return bool(beams[-1] - slack_deg <= view_deg[0] and view_deg[1] <= beams[0] + slack_deg)
