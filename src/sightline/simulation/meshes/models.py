"""A road user before it is placed in a street."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from sightline.simulation.scene import Mesh, Shape


@dataclass(frozen=True, kw_only=True, slots=True)
class ActorModel:
    """What a road user is and looks like; a street adds where it goes."""

    class_name: str
    """KITTI's: Car, Van, Truck, Pedestrian, Person_sitting, Cyclist, Tram, Misc."""
    size_lwh: tuple[float, float, float]
    """Length, width, height [m] of the upright box that holds `shape` at all times.

    What a car has on its roof, its mirrors, aerial and tow bar are left out, as in KITTI's labels.
    """
    shape: Shape
    labelled_lwh: tuple[float, float, float] | None = None
    """Size [m] that annotators give it, where that is not `size_lwh`; about the same middle."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RigidShape:
    """A shape that does not change."""

    mesh: Mesh

    def at(self, time_s: float) -> Mesh:  # noqa: ARG002 - a `Shape`
        """The mesh, which is the same at all times."""
        return self.mesh


@dataclass(frozen=True, kw_only=True)
class LateShape:
    """A shape that does not change, made when it is first needed: many models are never used."""

    make: Callable[[], Mesh]

    def at(self, time_s: float) -> Mesh:  # noqa: ARG002 - a `Shape`
        """The mesh, which is the same at all times."""
        return self._mesh

    @cached_property
    def _mesh(self) -> Mesh:
        return self.make()
