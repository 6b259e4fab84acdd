"""Models of road users before they are placed in a street, and the sizes of KITTI's objects."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from sightline.simulation.scene import Mesh, Shape


@dataclass(frozen=True, kw_only=True, slots=True)
class ActorModel:
    """Class, size and shape of a road user; a street adds its motion."""

    class_name: str
    """KITTI class: Car, Van, Truck, Pedestrian, Person_sitting, Cyclist, Tram, Misc."""
    size_lwh: tuple[float, float, float]
    """Length, width, height [m] of the upright box around `shape` at all times.

    A car's roof load, mirrors, aerial and tow bar are excluded, as in KITTI's labels.
    """
    shape: Shape
    labelled_lwh: tuple[float, float, float] | None = None
    """Size [m] in the label, if it differs from `size_lwh`; both have the same middle."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RigidShape:
    """Constant shape."""

    mesh: Mesh

    def at(self, time_s: float) -> Mesh:  # noqa: ARG002 - a `Shape`
        """Return the mesh, which is the same at all times."""
        return self.mesh


@dataclass(frozen=True, kw_only=True)
class LateShape:
    """Constant shape, built when it is first needed: many models are never used."""

    make: Callable[[], Mesh]

    def at(self, time_s: float) -> Mesh:  # noqa: ARG002 - a `Shape`
        """Return the mesh, which is the same at all times."""
        return self._mesh

    @cached_property
    def _mesh(self) -> Mesh:
        return self.make()


class Size(NamedTuple):
    """Length, width and height [m]."""

    length: float
    width: float
    height: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Kind:
    """Kind of a class: its share of the class and its size."""

    share: float
    mean_size: Size


@dataclass(frozen=True, kw_only=True, slots=True)
class SizeStatistics:
    """Moments of the sizes of one class over all its labels."""

    mean: Size
    deviation: Size
    """Standard deviations [m]."""
    correlations: tuple[float, float, float]
    """Correlations of length and width, length and height, width and height."""
    low: Size
    """First percentiles [m], the minimum of drawn sizes."""
    high: Size
    """99th percentiles [m], the maximum of drawn sizes."""

    def draw(self, rng: np.random.Generator, count: int) -> Float64[np.ndarray, "{count} 3"]:
        """Draw sizes (l, w, h) [m] from the normal distribution with these moments, clipped."""
        lw, lh, wh = self.correlations
        factor = np.linalg.cholesky(np.array([[1, lw, lh], [lw, 1, wh], [lh, wh, 1]]))
        normal = rng.standard_normal((count, 3)) @ factor.T
        sizes: np.ndarray = np.clip(
            np.array(self.mean) + normal * self.deviation, self.low, self.high
        )
        return sizes


def draw_kind(
    rng: np.random.Generator,
    statistics: SizeStatistics,
    kinds: Sequence[Kind],
    spread: Size,
    wanted: int | None = None,
) -> tuple[int, Size]:
    """Draw a size from the class, and a kind by its likelihood of that size.

    The class thus keeps its statistics for any kinds (Bayes' rule; within a kind sizes are normal).
    For a `wanted` kind, one of many sizes of the class is drawn by its likelihood.

    Args:
        rng: Source of randomness.
        statistics: Statistics of the class.
        kinds: Shares and sizes of the kinds.
        spread: Standard deviations within a kind [m].
        wanted: Index of the kind; None draws it.
    """
    sizes = statistics.draw(rng, 1 if wanted is None else 64)
    means = np.array([kind.mean_size for kind in kinds])
    misfit = np.square((sizes[:, None] - means) / np.array(spread)).sum(axis=2)
    shares = np.array([kind.share for kind in kinds])
    suits = np.exp(-0.5 * (misfit - misfit.min(axis=1, keepdims=True))) * shares
    suits /= suits.sum(axis=1, keepdims=True)
    if wanted is None:
        return int(rng.choice(len(kinds), p=suits[0])), Size(*sizes[0].tolist())
    chosen = int(rng.choice(len(sizes), p=suits[:, wanted] / suits[:, wanted].sum()))
    return wanted, Size(*sizes[chosen].tolist())


KITTI_SIZES: dict[str, SizeStatistics] = {
    "Car": SizeStatistics(
        mean=Size(3.884, 1.629, 1.526), deviation=Size(0.426, 0.102, 0.137),
        correlations=(0.349, 0.173, 0.305), low=Size(2.94, 1.36, 1.27), high=Size(4.89, 1.88, 1.97),
    ),
    "Van": SizeStatistics(
        mean=Size(5.078, 1.902, 2.207), deviation=Size(0.831, 0.173, 0.325),
        correlations=(0.648, 0.821, 0.667), low=Size(3.72, 1.56, 1.71), high=Size(6.86, 2.46, 2.87),
    ),
    "Truck": SizeStatistics(
        mean=Size(10.109, 2.585, 3.252), deviation=Size(2.858, 0.216, 0.449),
        correlations=(0.405, 0.206, 0.379), low=Size(5.42, 2.06, 2.32),
        high=Size(16.79, 2.97, 4.19),
    ),
    "Tram": SizeStatistics(
        mean=Size(16.094, 2.544, 3.529), deviation=Size(7.852, 0.215, 0.176),
        correlations=(0.023, -0.213, 0.098), low=Size(3.14, 2.17, 3.17),
        high=Size(35.24, 2.81, 3.84),
    ),
    "Misc": SizeStatistics(
        mean=Size(3.576, 1.514, 1.907), deviation=Size(2.858, 0.674, 0.814),
        correlations=(0.739, 0.742, 0.650), low=Size(0.77, 0.40, 0.76),
        high=Size(12.60, 2.68, 3.91),
    ),
    "Pedestrian": SizeStatistics(
        mean=Size(0.842, 0.660, 1.761), deviation=Size(0.235, 0.143, 0.113),
        correlations=(0.196, 0.273, 0.133), low=Size(0.30, 0.38, 1.4986),
        high=Size(1.32, 0.96, 1.97),
    ),
    "Person_sitting": SizeStatistics(
        mean=Size(0.802, 0.595, 1.275), deviation=Size(0.222, 0.079, 0.110),
        correlations=(-0.331, 0.180, 0.328), low=Size(0.50, 0.48, 1.06),
        high=Size(1.33, 0.75, 1.64),
    ),
    "Cyclist": SizeStatistics(
        mean=Size(1.764, 0.597, 1.737), deviation=Size(0.177, 0.124, 0.095),
        correlations=(0.321, 0.369, 0.130), low=Size(1.19, 0.34, 1.44), high=Size(2.12, 0.88, 1.97),
    ),
}  # fmt: skip
"""Statistics by class name."""
