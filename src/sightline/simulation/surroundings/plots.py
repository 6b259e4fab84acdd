"""Contents of the plots beside a street, and the distant background."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float64

from sightline.simulation.arrays import Points
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import QuadBatch, stamped
from sightline.simulation.shapes.primitives import Finish, grid
from sightline.simulation.streets.layout import Layout, Plots, StreetKind, ground_places
from sightline.simulation.streets.lots import (
    CAR_ROWS_M,
    Lot,
    car_park_rows,
    footprint_corners,
    footprint_of,
)
from sightline.simulation.streets.variety import Variety
from sightline.simulation.surroundings.boundaries import close_gap, enclose
from sightline.simulation.surroundings.buildings import (
    BuildingForm,
    BuildingSite,
    build,
    draw_apartments,
    draw_hall,
    draw_house,
    draw_look,
    draw_terrace,
    draw_town_house,
    glazed,
    heightened,
)
from sightline.simulation.surroundings.trees import Plants, Species, set_out

_FAR_M: Final = 48.0
_FORMS: Final = {
    Plots.HOUSES: draw_house,
    Plots.TERRACES: draw_terrace,
    Plots.APARTMENTS: draw_apartments,
    Plots.BLOCKS: draw_town_house,
    Plots.HALLS: draw_hall,
}
_LARGE: Final = (Plots.BLOCKS, Plots.APARTMENTS, Plots.HALLS)
DECIDUOUS: Final = (Species.LIME, Species.BIRCH, Species.PLANE, Species.CHERRY)
_GARDEN_TREES: Final = (Species.CHERRY, Species.SPRUCE, Species.BIRCH, Species.LIME)


def make_plots(
    rng: np.random.Generator,
    layout: Layout,
    lots: Sequence[Lot],
    variety: Variety | None = None,
) -> list[Mesh]:
    """Build everything beyond the pavements; `variety` makes buildings tall or glazed."""
    batch = QuadBatch()
    parts: list[Mesh] = []
    shared: BuildingForm | None = None
    for row, lot in enumerate(lots):
        if lot.plots in _FORMS:
            if lot.plots is not Plots.TERRACES or shared is None or rng.random() < 0.15:
                shared = _FORMS[lot.plots](rng)
                if variety is not None and lot.plots in _LARGE:
                    shared = _varied(rng, shared, variety)
            if lot.plots is Plots.TERRACES:  # its houses share their form but not their colours
                shared = replace(shared, look=draw_look(rng, 0.15))
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


def _varied(rng: np.random.Generator, form: BuildingForm, variety: Variety) -> BuildingForm:
    if variety.is_tall:
        form = heightened(rng, form)
    return glazed(rng, form) if rng.random() < variety.glazed_share else form


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
    places: Points,
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
    rng: np.random.Generator, layout: Layout, lot: Lot, count: int, distances: tuple[float, float]
) -> Points:
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


def make_horizon(rng: np.random.Generator, layout: Layout) -> list[Mesh]:
    """Build distant woods and roofs all around, so that no street ends at a bare edge."""
    parts = [_distant_woods(rng, layout, distance) for distance in (300.0, 430.0)]
    angles = rng.uniform(0, 2 * np.pi, 110)
    distances = rng.uniform(110.0, 280.0, len(angles))
    places = np.stack((distances * np.cos(angles), distances * np.sin(angles)), axis=1)
    places = places[_clear_of_road(layout, places, 22.0)]
    heights = layout.terrain.height(places)[:, None] - 0.5
    standing = np.concatenate((places, heights), axis=1)
    kind = DECIDUOUS[int(rng.integers(len(DECIDUOUS)))]
    parts += planted(rng, kind, standing, (10.0, 18.0), spread=1.4)
    num_houses = {StreetKind.CITY: 46, StreetKind.SQUARE: 40, StreetKind.COUNTRY: 8}.get(
        layout.kind, 26
    )
    angles = rng.uniform(0, 2 * np.pi, num_houses)
    distances = rng.uniform(130.0, 280.0, num_houses)
    sites = np.stack((distances * np.cos(angles), distances * np.sin(angles)), axis=1)
    sites = sites[_clear_of_road(layout, sites, 40.0)]
    ground = layout.terrain.height(sites)[:, None]
    # Their fronts face the ego.
    yaws = np.arctan2(sites[:, 1], sites[:, 0]) - np.pi / 2 + rng.uniform(-0.6, 0.6, len(sites))
    is_tall = layout.kind in (StreetKind.CITY, StreetKind.SQUARE)
    variant = rng.integers(0, _DISTANT_VARIANTS, len(sites)) + (_DISTANT_VARIANTS if is_tall else 0)
    standing = np.concatenate((sites, ground), axis=1)
    for kind in np.unique(variant):
        rows = variant == kind
        parts.append(stamped(_distant_building(int(kind)), standing[rows], yaws[rows]))
    return parts


_DISTANT_VARIANTS: Final = 6


@cache
def _distant_building(variant: int) -> Mesh:
    """Build a house, or from `_DISTANT_VARIANTS` on a tall building, at the origin; cached."""
    rng = np.random.default_rng([5, variant])
    is_tall = variant >= _DISTANT_VARIANTS
    batch = QuadBatch()
    width, depth = rng.uniform(10.0, 26.0 if is_tall else 14.0), rng.uniform(9.0, 12.0)
    site = BuildingSite(
        corner=(0.0, 0.0), yaw=0.0, ground=0.0, width=float(width), depth=float(depth), is_far=True
    )
    build(rng, batch, site, draw_apartments(rng) if is_tall else draw_house(rng))
    return batch.mesh()


def _distant_woods(rng: np.random.Generator, layout: Layout, distance: float) -> Mesh:
    """Build a ring of lumpy foliage, higher for near woods and absent for open views."""
    count = 260
    angles = np.arange(count) * (2 * np.pi / count)
    phases = rng.uniform(0, 2 * np.pi, 4)
    waves = sum(
        np.sin(turns * angles + phase) / row
        for row, (turns, phase) in enumerate(zip((2, 5, 9, 17), phases, strict=True), start=1)
    )
    cover = 8.0 if layout.wooded_horizon else -2.0
    tops = np.clip(cover + 7.0 * np.asarray(waves), -4.0, 20.0) + rng.uniform(0.0, 3.5, count)
    far = distance * (1.0 + 0.12 * np.sin(3 * angles + phases[0])) + rng.uniform(-4, 4, count)
    rows = []
    for share, back in ((-0.2, 0.0), (0.55, 1.0), (0.9, 4.0), (1.0, 9.0)):
        radius = far + back + rng.uniform(-1.5, 1.5, count)
        lumps = rng.uniform(-0.8, 0.8, count)
        z = share * tops + lumps - 4.0
        rows.append(np.stack((radius * np.cos(angles), radius * np.sin(angles), z), axis=1))
    tone = float(rng.uniform(0.8, 1.2))
    leaf = Finish(Material.LEAF, (0.055 * tone, 0.09 * tone, 0.03 * tone))
    # Viewed from inside, columns run to the right with decreasing angle.
    mesh = grid(np.stack(rows)[:, ::-1], leaf, closed=True)
    tints = np.repeat(rng.uniform(0.75, 1.3, (len(mesh.faces) // 2, 1)), 2, axis=0)
    return replace(mesh, colors=(mesh.colors * tints).astype(np.float32))


def _clear_of_road(
    layout: Layout, places: Float64[np.ndarray, "count 2"], room: float
) -> Bool[np.ndarray, " count"]:
    """Test which places are far from the roads and from the buildings along them."""
    clear = np.ones(len(places), dtype=bool)
    for road in layout.roads:
        stations = np.arange(road.first - 20.0, road.last + 170.0, 8.0)
        line = road.line.place(stations, np.zeros(len(stations)))
        apart = np.linalg.norm(places[:, None] - line[None], axis=-1).min(axis=1)
        clear &= apart > room
    return clear
