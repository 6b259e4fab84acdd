"""Models of road users, before they are placed in a street."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

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
