"""The models of road users that a street is peopled with."""

from dataclasses import replace
from typing import Final, Protocol, runtime_checkable

import numpy as np

from sightline.simulation.materials import Material
from sightline.simulation.meshes.cars import draw_paint, make_car
from sightline.simulation.meshes.cyclists import make_cyclist
from sightline.simulation.meshes.models import ActorModel, RigidShape
from sightline.simulation.meshes.people import make_pedestrian, make_sitting_person
from sightline.simulation.meshes.trams import make_tram
from sightline.simulation.meshes.trucks import make_truck
from sightline.simulation.meshes.vans import make_van
from sightline.simulation.scene import Mesh

_MAKERS: Final = {
    "Car": make_car,
    "Van": make_van,
    "Truck": make_truck,
    "Tram": make_tram,
    "Person_sitting": make_sitting_person,
}
_MOST_MODELS: Final = {"Car": 6, "Van": 2, "Truck": 2, "Tram": 1}
"""Of how many models a street's vehicles are, at most; making one takes longer than copying it."""
_PAINT_SHARE: Final = 0.05
"""A vehicle's paint is the colour of at least this share of its faces."""


@runtime_checkable
class ModelSource(Protocol):
    """Where models of road users come from."""

    def draw(self, rng: np.random.Generator, class_name: str, speed_mps: float) -> ActorModel:
        """A road user of a KITTI class, whose shape moves as at a speed if it depends on it."""


class Fleet:
    """Makes models as they are needed; cars beyond the first few are those again in other paint."""

    def __init__(self) -> None:
        self._made: dict[str, list[ActorModel]] = {}

    def draw(self, rng: np.random.Generator, class_name: str, speed_mps: float) -> ActorModel:
        """A road user of a KITTI class, whose shape moves as at a speed if it depends on it."""
        if class_name == "Pedestrian":
            return make_pedestrian(rng, speed_mps)
        if class_name == "Cyclist":
            return make_cyclist(rng, speed_mps)
        made = self._made.setdefault(class_name, [])
        if len(made) < _MOST_MODELS.get(class_name, 4):
            model = _MAKERS[class_name](rng)
            made.append(model)
            return model
        model = made[int(rng.integers(len(made)))]
        return _repainted(rng, model) if class_name in ("Car", "Van") else model


def _repainted(rng: np.random.Generator, model: ActorModel) -> ActorModel:
    """The same vehicle in another colour."""
    mesh = model.shape.at(0.0)
    colors = _other_paint(rng, mesh)
    return replace(model, shape=RigidShape(mesh=replace(mesh, colors=colors)))


def _other_paint(rng: np.random.Generator, mesh: Mesh) -> np.ndarray:
    is_paint = mesh.materials == Material.CAR_PAINT
    if not is_paint.any():
        return mesh.colors
    keys = mesh.colors @ np.array([1.0, 3.1, 7.3], np.float32)
    found, counts = np.unique(keys[is_paint], return_counts=True)
    is_shell = is_paint & (keys == found[counts.argmax()])
    if is_shell.mean() < _PAINT_SHARE:
        return mesh.colors
    paint = np.array(draw_paint(rng).color, np.float32)
    return np.where(is_shell[:, None], paint, mesh.colors)
