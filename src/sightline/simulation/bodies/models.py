"""Models of road users before they are placed in a street, and the sizes of KITTI's objects."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from sightline.simulation.scene import Mesh, Shape
from sightline.simulation.tables import read_table


@dataclass(frozen=True, kw_only=True, slots=True)
class ActorModel:
    """Class, size and shape of a road user; a street adds its motion."""

    class_name: str  # KITTI class: Car, Van, Truck, Pedestrian, Person_sitting, Cyclist, Tram, Misc
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
class LazyShape:
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
    deviation: Size  # standard deviations [m]
    correlations: tuple[float, float, float]
    """Correlations of length and width, length and height, width and height."""
    low: Size  # first percentiles [m], the minimum of drawn sizes
    high: Size  # 99th percentiles [m], the maximum of drawn sizes

    def draw(self, rng: np.random.Generator, count: int) -> Float64[np.ndarray, "{count} 3"]:
        """Draw sizes (l, w, h) [m] from the normal distribution with these moments, clipped."""
        lw, lh, wh = self.correlations
        factor = np.linalg.cholesky(np.array([[1, lw, lh], [lw, 1, wh], [lh, wh, 1]]))
        normal = rng.standard_normal((count, 3)) @ factor.T
        return np.asarray(
            np.clip(np.array(self.mean) + normal * self.deviation, self.low, self.high)
        )


def draw_kind(
    rng: np.random.Generator,
    statistics: SizeStatistics,
    kinds: Sequence[Kind],
    spread: Size,
    target: int | None = None,
) -> tuple[int, Size]:
    """Draw a size from the class, and a kind by its likelihood of that size.

    The class thus keeps its statistics for any kinds (Bayes' rule; within a kind sizes are normal
    with the standard deviations `spread` [m]). For a `target` kind (an index), one of many sizes of
    the class is drawn by its likelihood.
    """
    sizes = statistics.draw(rng, 1 if target is None else 64)
    means = np.array([kind.mean_size for kind in kinds])
    misfit = np.square((sizes[:, None] - means) / np.array(spread)).sum(axis=2)
    shares = np.array([kind.share for kind in kinds])
    suits = np.exp(-0.5 * (misfit - misfit.min(axis=1, keepdims=True))) * shares
    suits /= suits.sum(axis=1, keepdims=True)
    if target is None:
        return int(rng.choice(len(kinds), p=suits[0])), Size(*sizes[0].tolist())
    chosen = int(rng.choice(len(sizes), p=suits[:, target] / suits[:, target].sum()))
    return target, Size(*sizes[chosen].tolist())


KITTI_SIZES: dict[str, SizeStatistics] = {
    name: SizeStatistics(
        correlations=row.pop("correlations"), **{moment: Size(*row[moment]) for moment in row}
    )
    for name, row in read_table(__file__, "kitti_sizes").items()
}  # by class name
