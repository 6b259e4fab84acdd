"""Pitch and roll errors of the LiDAR relative to the camera, from upper edges in both.

`yaw_error` works along rings; this works across them: where the range jumps from one ring to the
next higher one, there is the top of an object. Its edge in the image is searched at every pitch
angle, separately for parts of the view from left to right; their differences give the roll.
`yaw_error` uses `edge_strength`, too.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from sightline.health.ring_order import number_rings
from sightline.health.sphere import to_sphere
from sightline.ops.compiled import compiled

_TILTS_DEG = np.linspace(-4.8, 4.8, 121)
_PITCHES_DEG = np.linspace(-3.2, 3.2, 41)
_ROLLS_DEG = np.linspace(-1.6, 1.6, 9)
_NONE_DEG = 0.2  # pitch error of edges halfway between rings
_PARTS = np.linspace(-0.86, 0.86, 7)  # borders, as tangents of the azimuth: KITTI's whole view
_JUMP_M = 0.5  # minimum range jump from one ring to the next at a top
_JUMP_SHARE = 0.1  # same, as a share of the nearer range
_BESIDE_DEG = 0.15  # maximum azimuth difference of points above each other
_WIDEST_RING_STEP_DEG = 3.0
_BLUR_PX = (1.0, 3.0)  # blur of the image's edges, along and across them
_ALONG_PX, _ACROSS_PX = 81, 41  # neighbourhood of an edge: along the gradient and across
_MIDDLES = (_PARTS[1:] + _PARTS[:-1]) / 2


class TopEdges(NamedTuple):
    """Upper edges of objects."""

    places: Float64[np.ndarray, "num_edges 3"]
    """Positions halfway between the rings, at the nearer range [m]."""
    weights: Float64[np.ndarray, " num_edges"]
    """Logarithm of the ratio of both ranges, at most 1."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TopMatch:
    """Match of upper edges at each angle, in each part of the view; can be summed over frames."""

    strengths: Float64[np.ndarray, "num_parts num_tilts"]
    """Sums of the image's edge strength at the edges, times the weights."""
    weights: Float64[np.ndarray, "num_parts num_tilts"]

    def __add__(self, other: "TopMatch") -> "TopMatch":
        """Sum the matches of both."""
        return TopMatch(
            strengths=self.strengths + other.strengths, weights=self.weights + other.weights
        )

    def faded(self, share: float) -> "TopMatch":
        """Scale the match's weight."""
        return TopMatch(strengths=share * self.strengths, weights=share * self.weights)


class TiltEstimate(NamedTuple):
    """Uncalibrated rotation of the LiDAR about its y and x axes."""

    pitch_deg: float
    """Pitch as defined by `data.faults.TurnedLidar`."""
    roll_deg: float
    """Roll as defined by `data.faults.TurnedLidar`."""
    behind: float
    """Deficit of the match without tilt to the best one, in standard deviations over all tilts."""


def match_tops(
    image: UInt8[np.ndarray, "height width 3"],
    points: Float32[np.ndarray, "num_points 4"],
    image_from_lidar: Float64[np.ndarray, "3 4"],
) -> TopMatch:
    """Match the upper edges of one frame.

    Args:
        image: RGB.
        points: Points about the camera's view, ring by ring (`ring_by_ring`).
        image_from_lidar: Projection as in a `Calibration`.
    """
    places, weights = find_top_edges(points)
    sharp = edge_strength(image, "vertical")
    strength = cv2.GaussianBlur(sharp, (0, 0), _BLUR_PX[0], sigmaY=_BLUR_PX[1])
    tangents = places[:, 1] / np.maximum(places[:, 0], 1e-3)
    parts = np.clip(np.searchsorted(_PARTS, tangents) - 1, 0, len(_MIDDLES) - 1)
    sums, totals = _strength_by_part(
        places, weights, parts, image_from_lidar, strength, np.radians(_TILTS_DEG), len(_MIDDLES)
    )
    return TopMatch(strengths=sums, weights=totals)


def estimate_tilt(match: TopMatch) -> TiltEstimate:
    """Find the pitch and roll with the best match of upper edges.

    A roll tilts the left and the right of the view in opposite directions, by its sine: at an
    azimuth it is equivalent to a pitch of minus the roll times the azimuth's tangent.
    """
    means = match.strengths / np.maximum(match.weights, 1e-9)
    shares = match.weights.mean(axis=1)
    total = np.zeros((len(_ROLLS_DEG), len(_PITCHES_DEG)))
    for tangent, curve, share in zip(_MIDDLES, means, shares, strict=True):
        apparent = _PITCHES_DEG - _ROLLS_DEG[:, None] * tangent
        total += share * np.interp(apparent, _TILTS_DEG, curve)
    roll, pitch = np.unravel_index(int(total.argmax()), total.shape)
    spread = float(total.std())
    none = float(total[len(_ROLLS_DEG) // 2, np.abs(_PITCHES_DEG) < _NONE_DEG].max())
    behind = (float(total.max()) - none) / spread if spread else 0.0
    return TiltEstimate(
        pitch_deg=float(_PITCHES_DEG[pitch]), roll_deg=float(_ROLLS_DEG[roll]), behind=behind
    )


def find_top_edges(points: Float32[np.ndarray, "num_points 4"]) -> TopEdges:
    """Find edges where the range jumps from a ring to the next higher one, above the same place.

    Args:
        points: Points ring by ring, see `ring_by_ring`.
    """
    if not len(points):
        return TopEdges(np.zeros((0, 3)), np.zeros(0))
    ranges, azimuth_deg, elevation_deg = (each.astype(np.float64) for each in to_sphere(points))
    rings = number_rings(azimuth_deg.astype(np.float32))
    starts = np.searchsorted(rings, np.arange(rings[-1] + 2))
    above = _points_above(azimuth_deg, starts)
    lower = np.flatnonzero(above >= 0)
    upper = above[lower]
    near, far = ranges[lower], ranges[upper]
    step = elevation_deg[upper] - elevation_deg[lower]
    is_top = (far - near > np.maximum(_JUMP_M, _JUMP_SHARE * near)) & (near > 0)
    is_top &= (step > 0) & (step < _WIDEST_RING_STEP_DEG)
    lower, upper, near, far = lower[is_top], upper[is_top], near[is_top], far[is_top]
    elevation = np.radians((elevation_deg[lower] + elevation_deg[upper]) / 2)
    azimuth = np.radians(azimuth_deg[lower])
    ray = (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth))
    places = near[:, None] * np.stack((*ray, np.sin(elevation)), axis=1)
    return TopEdges(places, np.minimum(np.log(far / near), 1.0))


@compiled
def _points_above(
    azimuth_deg: Float64[np.ndarray, " num_points"], starts: Int64[np.ndarray, " num_edges"]
) -> Int64[np.ndarray, " num_points"]:
    """Find for each point the one of the next higher ring at nearly its azimuth; -1 if none."""
    above = np.full(len(azimuth_deg), -1)
    for ring in range(1, len(starts) - 1):
        place, end = starts[ring - 1], starts[ring]
        for i in range(starts[ring], starts[ring + 1]):
            while place + 1 < end and abs(azimuth_deg[place + 1] - azimuth_deg[i]) <= abs(
                azimuth_deg[place] - azimuth_deg[i]
            ):
                place += 1
            if place < end and abs(azimuth_deg[place] - azimuth_deg[i]) < _BESIDE_DEG:
                above[i] = place
    return above


@compiled
def _strength_by_part(
    points: Float64[np.ndarray, "num_edges 3"],
    weights: Float64[np.ndarray, " num_edges"],
    parts: Int64[np.ndarray, " num_edges"],
    image_from_lidar: Float64[np.ndarray, "3 4"],
    strength: Float32[np.ndarray, "height width"],
    angles: Float64[np.ndarray, " num_angles"],
    num_parts: int,
) -> tuple[
    Float64[np.ndarray, "num_parts num_angles"], Float64[np.ndarray, "num_parts num_angles"]
]:
    """Sum strength and weights at each pitch [rad] at the points' pixels after undoing it."""
    height, width = strength.shape
    matrix = image_from_lidar
    sums = np.zeros((num_parts, len(angles)))
    totals = np.zeros((num_parts, len(angles)))
    for number in range(len(angles)):
        cosine, sine = np.cos(angles[number]), np.sin(angles[number])
        for i in range(len(points)):
            x = cosine * points[i, 0] - sine * points[i, 2]
            y = points[i, 1]
            z = cosine * points[i, 2] + sine * points[i, 0]
            depth = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
            if depth < 1.0:
                continue
            u = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]) / depth
            v = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]) / depth
            column, row = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
            if column < 0 or column >= width or row < 0 or row >= height:
                continue
            sums[parts[i], number] += weights[i] * strength[row, column]
            totals[parts[i], number] += weights[i]
    return sums, totals


def edge_strength(
    image: UInt8[np.ndarray, "height width 3"], gradient: Literal["horizontal", "vertical"]
) -> Float32[np.ndarray, "height width"]:
    """Compute the root of the gradient over its local mean, so that faint edges count too."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    is_horizontal = gradient == "horizontal"
    order = (1, 0) if is_horizontal else (0, 1)
    slope = cv2.Sobel(cv2.GaussianBlur(grey, (0, 0), 1), cv2.CV_32F, *order)
    strength = np.sqrt(np.abs(slope))
    around_px = (_ALONG_PX, _ACROSS_PX) if is_horizontal else (_ACROSS_PX, _ALONG_PX)
    even: Float32[np.ndarray, "height width"]
    even = strength / (cv2.blur(strength, around_px) + 1)
    return even
