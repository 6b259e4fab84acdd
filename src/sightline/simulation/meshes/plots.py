"""Contents of the plots beside a street: buildings, gardens, parks, woods and fields."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float, Float64

from sightline.simulation.layout import Layout, Plots, ground_places
from sightline.simulation.lots import (
    CAR_ROWS_M,
    Lot,
    car_park_rows,
    footprint_corners,
    footprint_of,
)
from sightline.simulation.materials import Material
from sightline.simulation.meshes.batches import QuadBatch
from sightline.simulation.meshes.boundaries import close_gap, enclose
from sightline.simulation.meshes.building_forms import (
    BuildingForm,
    draw_apartments,
    draw_hall,
    draw_house,
    draw_look,
    draw_terrace,
    draw_town_house,
)
from sightline.simulation.meshes.buildings import BuildingSite, build
from sightline.simulation.meshes.primitives import Finish
from sightline.simulation.meshes.trees import Plants, Species, set_out
from sightline.simulation.scene import Mesh

_FAR_M: Final = 48.0
_FORMS: Final = {
    Plots.HOUSES: draw_house,
    Plots.TERRACES: draw_terrace,
    Plots.APARTMENTS: draw_apartments,
    Plots.BLOCKS: draw_town_house,
    Plots.HALLS: draw_hall,
}
DECIDUOUS: Final = (Species.LIME, Species.BIRCH, Species.PLANE, Species.CHERRY)
_GARDEN_TREES: Final = (Species.CHERRY, Species.SPRUCE, Species.BIRCH, Species.LIME)


def make_plots(rng: np.random.Generator, layout: Layout, lots: Sequence[Lot]) -> list[Mesh]:
    """Build everything beyond the pavements."""
    batch = QuadBatch()
    parts: list[Mesh] = []
    shared: BuildingForm | None = None
    for row, lot in enumerate(lots):
        if lot.plots in _FORMS:
            if lot.plots is not Plots.TERRACES or shared is None or rng.random() < 0.15:
                shared = _FORMS[lot.plots](rng)
            shared = _form_of(rng, lot, shared)
            _place_building(rng, batch, layout, lot, shared, _free_sides(lots, row))
            parts += _garden(rng, batch, layout, lot)
            if row + 1 < len(lots):
                parts += close_gap(rng, batch, layout, lot, lots[row + 1])
        elif lot.plots is Plots.FOREST:
            parts += _forest(rng, layout, lot)
        elif lot.plots is Plots.CAR_PARK:
            parts += _car_park(rng, batch, layout, lot)
        else:
            parts += _open_land(rng, layout, lot)
        parts += enclose(rng, batch, layout, lot)
    return [batch.mesh(), *parts]


def _form_of(rng: np.random.Generator, lot: Lot, form: BuildingForm) -> BuildingForm:
    """Draw a new look for a terrace: its houses share their form but not their colours."""
    if lot.plots is not Plots.TERRACES:
        return form
    return replace(form, look=draw_look(rng, 0.15))


def _free_sides(lots: Sequence[Lot], row: int) -> tuple[bool, bool]:
    """Test whether a lot's building has no neighbour on its right and left, from the street."""
    lot = lots[row]
    before, after = (
        any(
            other.side is lot.side and other.building is not None and abs(gap) < 0.1
            for other, gap in neighbours
        )
        for neighbours in (
            [(other, lot.start - other.stop) for other in lots[max(row - 1, 0) : row]],
            [(other, other.start - lot.stop) for other in lots[row + 1 : row + 2]],
        )
    )
    touches = lot.width - (lot.building[1] if lot.building is not None else 0.0) < 0.1
    free_before, free_after = not (before and touches), not (after and touches)
    return (free_after, free_before) if lot.side.sign > 0 else (free_before, free_after)


def _place_building(
    rng: np.random.Generator,
    batch: QuadBatch,
    layout: Layout,
    lot: Lot,
    form: BuildingForm,
    is_free: tuple[bool, bool],
) -> None:
    footprint = footprint_of(lot)
    if footprint is None:
        return
    corners = footprint_corners(footprint)
    ground = float(layout.terrain.height(corners[:2].mean(axis=0))) + lot.side.level
    nearest = float(np.hypot(corners[:, 0], corners[:, 1]).min())
    site = BuildingSite(
        corner=footprint.corner,
        yaw=footprint.yaw,
        ground=ground,
        width=footprint.width,
        depth=footprint.depth,
        is_far=nearest > _FAR_M or bool(corners[:, 0].max() < -12.0),
        is_free=is_free,
    )
    build(rng, batch, site, form)


def _garden(rng: np.random.Generator, batch: QuadBatch, layout: Layout, lot: Lot) -> list[Mesh]:
    """Build the driveway, the path to the door, and plants in front of and beside a building."""
    side, room = lot.side, lot.front - lot.side.outer
    if lot.driveway is not None:
        half = 1.5 if lot.plots is not Plots.HALLS else 3.0
        paved = Finish(Material.PAVEMENT, (0.30, 0.28, 0.26))
        # It leads to the garage or the yard, over the grass.
        stations = np.linspace(lot.driveway - half, lot.driveway + half, 3)
        _paving(batch, layout, lot, stations, (side.outer, lot.front + 3.0), paved)
    if lot.plots is Plots.HALLS and room > 8.0 and lot.building is not None:
        start, width, _ = lot.building
        asphalt = Finish(Material.ASPHALT, (0.12, 0.12, 0.122))
        stations = np.linspace(start - 1.0, start + width + 1.0, 2 + int(width / 4.0))
        _paving(batch, layout, lot, stations, (side.outer + 0.8, lot.front), asphalt)
        return []
    if room < 2.0 or lot.plots is Plots.BLOCKS:
        return []
    count = int(rng.poisson(0.07 * lot.width * min(room, 8.0)))
    stations = rng.uniform(lot.start, lot.stop, count)
    if lot.driveway is not None:
        stations = stations[np.abs(stations - lot.driveway) > 2.4]
    distances = side.outer + rng.uniform(0.8, max(room - 0.8, 0.9), len(stations))
    places = ground_places(layout, lot.road, stations, side.sign * distances, side.level)
    is_tree = (rng.random(len(places)) < 0.3) & (room > 3.5)
    parts = planted(rng, Species.BUSH, places[~is_tree], (0.5, 1.9))
    kind = _GARDEN_TREES[int(rng.integers(len(_GARDEN_TREES)))]
    parts += planted(rng, kind, places[is_tree], (3.5, 9.0))
    if lot.building is not None and rng.random() < 0.8:
        behind = lot.front + lot.building[2] + rng.uniform(4.0, 10.0, 3)
        tall = ground_places(
            layout, lot.road, rng.uniform(lot.start, lot.stop, 3), side.sign * behind, 0.0
        )
        parts += planted(rng, DECIDUOUS[int(rng.integers(3))], tall, (9.0, 16.0), coarseness=2.0)
    return parts


def _paving(
    batch: QuadBatch,
    layout: Layout,
    lot: Lot,
    stations: Float[np.ndarray, " count"],
    distances: tuple[float, float],
    finish: Finish,
    lift: float = 0.008,
) -> None:
    """Pave the ground between two distances, just above its surface."""
    steps = np.linspace(*distances, 2 + int((distances[1] - distances[0]) / 3.0))
    s, d = np.meshgrid(stations, steps, indexing="ij")
    points = ground_places(layout, lot.road, s, lot.side.sign * d, lot.side.level + lift)
    corners = np.stack((points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]), axis=2)
    places = np.stack((s, d), axis=-1)
    uvs = np.stack((places[:-1, :-1], places[1:, :-1], places[1:, 1:], places[:-1, 1:]), axis=2)
    if lot.side.sign < 0:
        corners, uvs = corners[:, :, ::-1], uvs[:, :, ::-1]
    batch.add(corners.reshape(-1, 4, 3), finish, uvs=uvs.reshape(-1, 4, 2))


def planted(
    rng: np.random.Generator,
    species: Species,
    places: Float64[np.ndarray, "count 3"],
    heights: tuple[float, float],
    *,
    spread: float = 1.0,
    coarseness: float = 1.0,
) -> list[Mesh]:
    """Place plants of one species, with heights between two limits [m]."""
    tall = rng.uniform(*heights, len(places))
    plants = Plants(places=places, heights=tall, spread=spread, coarseness=coarseness)
    return set_out(rng, species, plants)


def _scattered(
    rng: np.random.Generator,
    layout: Layout,
    lot: Lot,
    count: int,
    distances: tuple[float, float],
) -> Float64[np.ndarray, "count 3"]:
    stations = rng.uniform(lot.start, lot.stop, count)
    offsets = lot.side.sign * rng.uniform(*distances, count)
    return ground_places(layout, lot.road, stations, offsets, -0.05)


def _forest(rng: np.random.Generator, layout: Layout, lot: Lot) -> list[Mesh]:
    """Build a wood: an edge of bushes, with trees behind."""
    front = lot.front
    mix = rng.choice(4, 2, replace=False)
    kinds = [(Species.LIME, Species.PLANE, Species.SPRUCE, Species.PINE)[row] for row in mix]
    parts = []
    for kind, share in zip(kinds, (0.6, 0.4), strict=True):
        places = _scattered(
            rng, layout, lot, int(share * 0.42 * lot.width), (front + 1.0, front + 16.0)
        )
        parts += planted(rng, kind, places, (10.0, 18.0), coarseness=1.3)
        behind = _scattered(
            rng, layout, lot, int(share * 0.30 * lot.width), (front + 16.0, front + 34.0)
        )
        parts += planted(rng, kind, behind, (12.0, 18.0), coarseness=3.0)
    bushes = _scattered(rng, layout, lot, int(0.45 * lot.width), (front - 0.5, front + 5.0))
    return parts + planted(rng, Species.BUSH, bushes, (0.7, 2.6), coarseness=1.3)


def _open_land(rng: np.random.Generator, layout: Layout, lot: Lot) -> list[Mesh]:
    """Build a park with trees and shrubs, or fields with a few trees."""
    front = lot.front
    if lot.plots is Plots.PARK:
        trees = _scattered(rng, layout, lot, int(0.2 * lot.width), (front, front + 35.0))
        bushes = _scattered(rng, layout, lot, int(0.35 * lot.width), (front, front + 20.0))
        kind = DECIDUOUS[int(rng.integers(len(DECIDUOUS)))]
        parts = planted(rng, kind, trees, (8.0, 15.0))
        return parts + planted(rng, Species.BUSH, bushes, (0.8, 2.2))
    trees = _scattered(rng, layout, lot, int(rng.gamma(1.0, 12.0)), (front, front + 60.0))
    bushes = _scattered(rng, layout, lot, int(rng.gamma(1.0, 12.0)), (front - 5.0, front + 40.0))
    kind = DECIDUOUS[int(rng.integers(len(DECIDUOUS)))]
    return planted(rng, kind, trees, (7.0, 14.0)) + planted(rng, Species.BUSH, bushes, (0.6, 2.4))


def _car_park(rng: np.random.Generator, batch: QuadBatch, layout: Layout, lot: Lot) -> list[Mesh]:
    """Build asphalt with two rows of places, and trees behind them."""
    lines = car_park_rows(lot)
    tone = float(rng.uniform(0.12, 0.22))
    asphalt = Finish(Material.ASPHALT, (tone, tone, tone))
    paint = Finish(Material.ASPHALT, (0.6, 0.6, 0.58))
    start, outer = lot.side.outer, lot.front - 1.2
    stations = np.linspace(lot.start + 1.0, lot.stop - 1.0, 2 + int(lot.width / 4.0))
    _paving(batch, layout, lot, stations, (start + 0.6, outer), asphalt)
    for middle in CAR_ROWS_M:
        for line in lines[lines > -10.0]:
            pair, reach = line + np.array([-0.05, 0.05]), start + middle + np.array([-2.5, 2.5])
            _paving(batch, layout, lot, pair, (reach[0], reach[1]), paint, lift=0.012)
    trees = _scattered(rng, layout, lot, int(0.16 * lot.width), (lot.front + 1.0, lot.front + 14.0))
    bushes = _scattered(rng, layout, lot, int(0.4 * lot.width), (lot.front + 0.5, lot.front + 5.0))
    kind = DECIDUOUS[int(rng.integers(len(DECIDUOUS)))]
    parts = planted(rng, kind, trees, (7.0, 13.0))
    return parts + planted(rng, Species.BUSH, bushes, (0.8, 2.4))
