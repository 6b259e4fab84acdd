"""Models of the road users in a street."""

from typing import Final, Protocol, runtime_checkable

import numpy as np

from sightline.simulation.meshes.cars import CARS, VANS, VehicleDesign
from sightline.simulation.meshes.cyclists import make_cyclist
from sightline.simulation.meshes.models import ActorModel
from sightline.simulation.meshes.people import make_pedestrian, make_sitting_person
from sightline.simulation.meshes.trailers import make_misc
from sightline.simulation.meshes.trams import make_tram
from sightline.simulation.meshes.trucks import make_truck

_MAKERS: Final = {
    "Truck": make_truck,
    "Tram": make_tram,
    "Misc": make_misc,
    "Person_sitting": make_sitting_person,
}
_MOST_MODELS: Final = 4
"""Maximum models of a class such as Truck or Tram; making one takes longer than copying one."""
_FAMILIES: Final = {family.class_name: family for family in (CARS, VANS)}
_MOST_DESIGNS: Final = 16
"""Maximum designs of a street's cars or vans."""


@runtime_checkable
class ModelSource(Protocol):
    """Source of road user models."""

    def draw(self, rng: np.random.Generator, class_name: str, speed_mps: float) -> ActorModel:
        """Draw a road user of a KITTI class; people walk or pedal at that speed."""


class Fleet:
    """Factory of models on demand; those beyond the first few share designs or shapes."""

    def __init__(self) -> None:
        self._designs: dict[str, list[VehicleDesign]] = {}
        self._made: dict[str, list[ActorModel]] = {}

    def draw(self, rng: np.random.Generator, class_name: str, speed_mps: float) -> ActorModel:
        """Draw a road user of a KITTI class; people walk or pedal at that speed."""
        if class_name == "Pedestrian":
            return make_pedestrian(rng, speed_mps)
        if class_name == "Cyclist":
            return make_cyclist(rng, speed_mps)
        if class_name in _FAMILIES:
            designs = self._designs.setdefault(class_name, [])
            if len(designs) < _MOST_DESIGNS:
                designs.append(VehicleDesign(rng, _FAMILIES[class_name]))
                return designs[-1].model(rng)
            return designs[int(rng.integers(len(designs)))].model(rng)
        made = self._made.setdefault(class_name, [])
        if len(made) < _MOST_MODELS:
            made.append(_MAKERS[class_name](rng))
            return made[-1]
        return made[int(rng.integers(len(made)))]
