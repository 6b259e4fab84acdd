"""Kinds of buildings: shapes and colours."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from sightline.simulation.materials import Material
from sightline.simulation.meshes.facades import Look
from sightline.simulation.meshes.primitives import Color, Finish


@dataclass(frozen=True, kw_only=True, slots=True)
class BuildingForm:
    """Shape and finishes of a building."""

    look: Look
    storeys: int
    storey_height: float
    plinth: float
    """Height of the ground floor's level above the street [m]."""
    roof: str
    """flat, gable (ridge along the front) or cross (ridge across)."""
    roof_pitch: float
    """Rise per metre."""
    roof_finish: Finish
    has_shop: bool
    has_balconies: bool
    has_windows_on_sides: bool
    has_chimney: bool
    has_dormers: bool


_PLASTERS: Final[tuple[Color, ...]] = (
    (0.72, 0.68, 0.58),
    (0.76, 0.74, 0.70),
    (0.66, 0.55, 0.38),
    (0.70, 0.60, 0.44),
    (0.60, 0.42, 0.30),
    (0.56, 0.58, 0.60),
    (0.74, 0.69, 0.50),
    (0.58, 0.36, 0.28),
    (0.50, 0.56, 0.48),
    (0.47, 0.52, 0.60),
    (0.80, 0.79, 0.76),
)
_BRICKS: Final[tuple[Color, ...]] = ((0.36, 0.15, 0.10), (0.42, 0.22, 0.14), (0.45, 0.36, 0.25))
_ROOFS: Final[tuple[Color, ...]] = (
    (0.30, 0.11, 0.07),
    (0.36, 0.15, 0.09),
    (0.22, 0.10, 0.08),
    (0.09, 0.09, 0.10),
    (0.14, 0.11, 0.10),
)
_TRIMS: Final[tuple[Color, ...]] = ((0.78, 0.77, 0.74), (0.62, 0.60, 0.55), (0.30, 0.20, 0.13))
_DOORS: Final[tuple[Color, ...]] = (
    (0.20, 0.10, 0.05),
    (0.10, 0.16, 0.12),
    (0.45, 0.45, 0.46),
    (0.08, 0.10, 0.18),
    (0.28, 0.05, 0.05),
)


def _pick(rng: np.random.Generator, colors: tuple[Color, ...]) -> Color:
    color = np.array(colors[int(rng.integers(len(colors)))]) * rng.uniform(0.88, 1.08, 1)
    red, green, blue = np.clip(color * rng.uniform(0.96, 1.04, 3), 0.01, 0.9).tolist()
    return red, green, blue


def draw_look(rng: np.random.Generator, brick_share: float) -> Look:
    """Draw colours of a building and the size of its windows."""
    if rng.random() < brick_share:
        wall = Finish(Material.BRICK, _pick(rng, _BRICKS))
    else:
        wall = Finish(Material.PLASTER, _pick(rng, _PLASTERS))
    trim = _pick(rng, _TRIMS)
    return Look(
        wall=wall,
        base=Finish(Material.CONCRETE, (0.34, 0.33, 0.31)) if rng.random() < 0.6 else wall,
        trim=Finish(Material.PLASTIC, trim),
        door=Finish(Material.WOOD, _pick(rng, _DOORS)),
        window_width=float(rng.uniform(0.95, 1.5)),
        window_height=float(rng.uniform(1.25, 1.7)),
        window_pitch=float(rng.uniform(2.3, 3.3)),
        recess=float(rng.uniform(0.08, 0.20)),
        shutter_share=float(rng.choice([0.0, 0.1, 0.3])),
        has_folding_shutters=bool(rng.random() < 0.2),
    )


def draw_house(rng: np.random.Generator) -> BuildingForm:
    """Draw a detached house."""
    return BuildingForm(
        look=draw_look(rng, 0.15),
        storeys=int(rng.choice([1, 2, 2, 2])),
        storey_height=float(rng.uniform(2.65, 2.9)),
        plinth=float(rng.uniform(0.25, 0.9)),
        roof=str(rng.choice(["gable", "cross", "gable", "flat"], p=[0.4, 0.3, 0.2, 0.1])),
        roof_pitch=float(rng.uniform(0.55, 1.05)),
        roof_finish=Finish(Material.ROOF_TILE, _pick(rng, _ROOFS)),
        has_shop=False,
        has_balconies=bool(rng.random() < 0.25),
        has_windows_on_sides=True,
        has_chimney=bool(rng.random() < 0.8),
        has_dormers=bool(rng.random() < 0.3),
    )


def draw_terrace(rng: np.random.Generator) -> BuildingForm:
    """Draw a house of a terrace: its neighbours have the same form and other colours."""
    return BuildingForm(
        look=draw_look(rng, 0.2),
        storeys=int(rng.choice([2, 2, 3])),
        storey_height=2.75,
        plinth=0.3,
        roof="gable",
        roof_pitch=float(rng.uniform(0.6, 0.9)),
        roof_finish=Finish(Material.ROOF_TILE, _pick(rng, _ROOFS)),
        has_shop=False,
        has_balconies=False,
        has_windows_on_sides=True,
        has_chimney=True,
        has_dormers=bool(rng.random() < 0.4),
    )


def draw_apartments(rng: np.random.Generator) -> BuildingForm:
    """Draw a free-standing block of flats."""
    has_flat_roof = rng.random() < 0.6
    return BuildingForm(
        look=draw_look(rng, 0.1),
        storeys=int(rng.integers(3, 6)),
        storey_height=2.8,
        plinth=float(rng.uniform(0.4, 1.1)),
        roof="flat" if has_flat_roof else "gable",
        roof_pitch=0.45,
        roof_finish=Finish(Material.ROOF_TILE, _pick(rng, _ROOFS)),
        has_shop=False,
        has_balconies=bool(rng.random() < 0.65),
        has_windows_on_sides=True,
        has_chimney=True,
        has_dormers=False,
    )


def draw_town_house(rng: np.random.Generator) -> BuildingForm:
    """Draw a house of a continuous row in a town, often with a shop."""
    return BuildingForm(
        look=draw_look(rng, 0.18),
        storeys=int(rng.choice([2, 3, 4, 4, 5])),
        storey_height=float(rng.uniform(3.0, 3.5)),
        plinth=float(rng.uniform(0.1, 0.6)),
        roof=str(rng.choice(["gable", "flat"], p=[0.75, 0.25])),
        roof_pitch=float(rng.uniform(0.6, 1.1)),
        roof_finish=Finish(Material.ROOF_TILE, _pick(rng, _ROOFS)),
        has_shop=bool(rng.random() < 0.45),
        has_balconies=bool(rng.random() < 0.15),
        has_windows_on_sides=True,
        has_chimney=bool(rng.random() < 0.7),
        has_dormers=bool(rng.random() < 0.5),
    )


def draw_hall(rng: np.random.Generator) -> BuildingForm:
    """Draw an office, a supermarket or a workshop."""
    look = draw_look(rng, 0.15)
    return BuildingForm(
        look=look,
        storeys=int(rng.choice([1, 1, 2, 4])),
        storey_height=float(rng.uniform(3.4, 5.0)),
        plinth=0.1,
        roof="flat",
        roof_pitch=0.0,
        roof_finish=Finish(Material.GRAVEL, (0.25, 0.25, 0.24)),
        has_shop=bool(rng.random() < 0.6),
        has_balconies=False,
        has_windows_on_sides=True,
        has_chimney=False,
        has_dormers=False,
    )
