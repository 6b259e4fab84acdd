"""Spinning LiDAR model for the corruptions: beams, rings and the weakest echo that is found."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from jaxtyping import Float32, Float64, Int64
from torch import Tensor

from sightline.corruptions.corruption import Sweep


@dataclass(frozen=True, kw_only=True, slots=True)
class SpinningLidar:
    """Spinning LiDAR with beams of fixed elevations that rotate about the vertical axis.

    Raises:
        ValueError: There is no beam, the elevations do not decrease or are not angles, or a range
            or the divergence is not finite and positive.
    """

    beam_elevations_deg: tuple[float, ...]
    """Elevations of the beams from the top."""
    max_range_m: float = 120.0
    """Maximum range, at which a target that reflects 90 % is just detected in clear air."""
    min_range_m: float = 0.9
    """Minimum range."""
    beam_divergence_mrad: float = 3.0
    """Full divergence angle of a beam."""

    def __post_init__(self) -> None:
        """Check beams and ranges."""
        elevations = np.array(self.beam_elevations_deg)
        if not (len(elevations) and (np.abs(elevations) <= 90).all()):
            raise ValueError(
                f"beam_elevations_deg must be angles from -90 to 90, got {self.beam_elevations_deg}"
            )
        if not (np.diff(elevations) < 0).all():
            raise ValueError("beam_elevations_deg must fall from the top beam to the lowest")
        if not 0 < self.min_range_m < self.max_range_m < np.inf:
            raise ValueError(
                "the ranges must be finite, min_range_m above 0 and below max_range_m; got "
                f"{self.min_range_m} and {self.max_range_m}"
            )
        if not 0 < self.beam_divergence_mrad < np.inf:
            raise ValueError(
                f"beam_divergence_mrad must be finite and above 0, got {self.beam_divergence_mrad}"
            )

    @property
    def num_beams(self) -> int:
        """Number of beams."""
        return len(self.beam_elevations_deg)

    def ring_of(self, points: Float32[Tensor, "num_points fields"]) -> Int64[Tensor, " num_points"]:
        """Find the beam, from the top, nearest in elevation to each point (x, y, z first [m]).

        Elevations refer to the LiDAR's origin: if beams do not start there, near points may be
        assigned to a neighbouring beam.
        """
        places = points[:, :3].numpy()
        elevations = np.degrees(np.arctan2(places[:, 2], np.hypot(places[:, 0], places[:, 1])))
        rising = np.array(self.beam_elevations_deg[::-1])
        below = np.searchsorted((rising[1:] + rising[:-1]) / 2, elevations)
        return torch.from_numpy(self.num_beams - 1 - below)


def evenly_spaced(num_beams: int, top_deg: float, bottom_deg: float) -> SpinningLidar:
    """Make a LiDAR of evenly spaced beams from the top elevation to the lowest."""
    return SpinningLidar(
        beam_elevations_deg=tuple(np.linspace(top_deg, bottom_deg, num_beams).tolist())
    )


HDL_64E: Final = SpinningLidar(
    beam_elevations_deg=(
        *np.linspace(2.0, -8.333, 32).round(3).tolist(),
        *np.linspace(-8.833, -24.333, 32).round(3).tolist(),
    )
)
"""KITTI's LiDAR, by its data sheet: 32 beams a third of a degree apart above 32 half a degree
apart."""

HDL_32E: Final = evenly_spaced(32, 10.67, -30.67)
"""LiDAR of nuScenes."""

VLP_16: Final = evenly_spaced(16, 15.0, -15.0)


_LIMIT_REFLECTANCE = 0.9  # reflectance of a target just detected at the maximum range


def faintest_power(lidar: SpinningLidar) -> float:
    """Compute the minimum detectable power, as reflectance / range^2: Kilic et al. 2021, LISA.

    This is the power of a target of reflectance 0.9 at the maximum range.
    """
    return _LIMIT_REFLECTANCE / lidar.max_range_m**2


def clear_air_reflectances(
    points: Sweep,
    ranges_m: Float64[np.ndarray, " num_points"],
    lidar: SpinningLidar,
    rng: np.random.Generator,
) -> Float64[np.ndarray, " num_points"]:
    """Estimate the reflectances of points in clear air, where their echoes were detected.

    A reading below the minimum power, such as the many readings of 0, is replaced by an echo above
    it. The logarithm of their ratio is drawn from an exponential distribution: each stretch of fog
    then removes the same share of the remaining points.
    """
    read = points[:, 3].double().numpy()
    margins = np.exp(np.minimum(rng.standard_exponential(len(points)), 50))
    reflectances: Float64[np.ndarray, " num_points"] = np.maximum(
        read, faintest_power(lidar) * ranges_m**2 * margins
    )
    return reflectances
