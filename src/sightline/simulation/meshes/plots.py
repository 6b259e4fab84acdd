"""What stands on the plots beside a street: buildings, gardens, parks, woods and fields."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float, Float64

from sightline.simulation.layout import Layout, Plots, Road, Side
from sightline.simulation.lots import (
    CAR_ROWS_M,
    Boundary,
    Lot,
    car_park_rows,
    footprint_corners,
    footprint_of,
)
from sightline.simulation.materials import Material
from sightline.simulation.meshes.batches import QuadBatch
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
from sightline.simulation.meshes.furniture import add_boxes_along, add_posts
from sightline.simulation.meshes.primitives import Finish
from sightline.simulation.meshes.trees import Plants, Species, make_hedge, set_out
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


def ground_places(
    layout: Layout,
    road: Road,
    stations: Float[np.ndarray, "..."],
    offsets: Float[np.ndarray, "..."] | float,
    level: float,
) -> Float64[np.ndarray, "... 3"]:
    """World points at stations and offsets of a road, at a level above the terrain."""
    places = road.line.place(np.asarray(stations, np.float64), np.asarray(offsets, np.float64))
    heights = layout.terrain.height(places) + level
    return np.concatenate((places, heights[..., None]), axis=-1)


def make_plots(rng: np.random.Generator, layout: Layout, lots: Sequence[Lot]) -> list[Mesh]:
    """Everything beyond the pavements."""
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
                parts += _between(rng, batch, layout, lot, lots[row + 1])
        elif lot.plots is Plots.FOREST:
            parts += _forest(rng, layout, lot)
        elif lot.plots is Plots.CAR_PARK:
            parts += _car_park(rng, batch, layout, lot)
        else:
            parts += _open_land(rng, layout, lot)
        parts += _boundary(rng, batch, layout, lot)
    return [batch.mesh(), *parts]


def _form_of(rng: np.random.Generator, lot: Lot, form: BuildingForm) -> BuildingForm:
    """Houses of a terrace share their form but not their colours."""
    if lot.plots is not Plots.TERRACES:
        return form
    return replace(form, look=draw_look(rng, 0.15))


def _free_sides(lots: Sequence[Lot], row: int) -> tuple[bool, bool]:
    """Whether no building touches the one of a lot on its right and left, seen from the street."""
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
    """The driveway, the path to the door, and plants in front of and beside a building."""
    side, room = lot.side, lot.front - lot.side.outer
    if lot.driveway is not None:
        half = 1.5 if lot.plots is not Plots.HALLS else 3.0
        paved = Finish(Material.PAVEMENT, (0.30, 0.28, 0.26))
        # Up to the garage or the yard, over the grass.
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


def _between(
    rng: np.random.Generator, batch: QuadBatch, layout: Layout, lot: Lot, after: Lot
) -> list[Mesh]:
    """What closes the gap to the next building: a garage, a hedge, a wall or boards.

    Without it one sees far between houses, which real streets seldom allow.
    """
    if after.side is not lot.side or lot.building is None or after.building is None:
        return []
    start, stop = lot.building[0] + lot.building[1], after.building[0]
    chance, kind = rng.random(2)
    if not 0.8 < stop - start < _WIDEST_GAP_M or chance > _CLOSED_SHARE:
        return []
    stations = np.linspace(start - 0.2, stop + 0.2, 3)
    distance = lot.front + float(rng.uniform(0.5, 2.0))
    is_garage = lot.driveway is not None and lot.plots is not Plots.HALLS
    if is_garage:
        distance += _GARAGE_DEPTH_M / 2
    line = ground_places(layout, lot.road, stations, lot.side.sign * distance, lot.side.level)
    if is_garage:
        _garage(rng, batch, layout, lot, line, distance - _GARAGE_DEPTH_M / 2)
    elif kind < 0.5:
        return make_hedge(rng, line[:-1], line[1:], float(rng.uniform(2.1, 2.8)))
    elif kind < 0.75:
        _wall(rng, batch, line, (2.1, 2.6))
    else:
        boards = Finish(Material.WOOD, (0.24, 0.16, 0.1))
        height = float(rng.uniform(2.0, 2.4))
        add_boxes_along(batch, line, boards, half_width=0.02, heights=(-0.2, height))
    return []


_WIDEST_GAP_M: Final = 26.0
_CLOSED_SHARE: Final = 0.9
_GARAGE_DEPTH_M: Final = 5.4


def _garage(
    rng: np.random.Generator,
    batch: QuadBatch,
    layout: Layout,
    lot: Lot,
    middle: Float64[np.ndarray, "n 3"],
    front: float,
) -> None:
    """A flat-roofed garage along a line through its middle, with its door to the street."""
    tone = float(rng.uniform(0.3, 0.6))
    plaster = Finish(Material.PLASTER, (tone, tone * 0.98, tone * 0.93))
    height = float(rng.uniform(2.4, 2.9))
    half = _GARAGE_DEPTH_M / 2
    add_boxes_along(batch, middle, plaster, half_width=half, heights=(-0.3, height))
    felt = Finish(Material.CONCRETE, (0.13, 0.13, 0.13))
    add_boxes_along(batch, middle, felt, half_width=half + 0.12, heights=(height, height + 0.12))
    assert lot.driveway is not None, "garages stand at driveways"
    stations = np.array([lot.driveway - 1.25, lot.driveway + 1.25])
    door = ground_places(layout, lot.road, stations, lot.side.sign * front, lot.side.level)
    tone = float(rng.uniform(0.1, 0.6))
    leaf = Finish(Material.PLASTIC, (tone, tone, tone * 0.95))
    add_boxes_along(batch, door, leaf, half_width=0.04, heights=(0.0, 2.1))


def _paving(
    batch: QuadBatch,
    layout: Layout,
    lot: Lot,
    stations: Float[np.ndarray, " count"],
    distances: tuple[float, float],
    finish: Finish,
    lift: float = 0.008,
) -> None:
    """A paved piece of ground from one distance to another, just above what is there."""
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
    """Plants of one species, of heights between two [m]."""
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
    """A wood: an edge of bushes, trees in depth behind."""
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
    """A park with trees and shrubs, or fields with a few trees."""
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
    """Asphalt with two rows of places, and trees behind them."""
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


def _boundary(rng: np.random.Generator, batch: QuadBatch, layout: Layout, lot: Lot) -> list[Mesh]:
    """Hedge, fence or wall at the pavement, open at the driveway and the door."""
    if lot.boundary is Boundary.OPEN or lot.front - lot.side.outer < 1.2:
        return []
    inset = lot.side.outer + 0.35
    gaps = [] if lot.driveway is None else [(lot.driveway - 1.7, lot.driveway + 1.7)]
    if lot.building is not None:
        middle = lot.building[0] + lot.building[1] / 2
        gaps.append((middle - 0.7, middle + 0.7))
    stretches = _without(lot.start, min(lot.stop, lot.road.last), sorted(gaps))
    lines = []
    for start, stop in stretches:
        stations = np.linspace(start, stop, 2 + int((stop - start) / 4.0))
        lines.append(
            ground_places(layout, lot.road, stations, lot.side.sign * inset, lot.side.level)
        )
    if lot.boundary is Boundary.HEDGE:
        height = float(rng.uniform(0.8, 1.6))
        starts = [line[:-1] for line in lines]
        stops = [line[1:] for line in lines]
        if not starts:
            return []
        return make_hedge(rng, np.concatenate(starts), np.concatenate(stops), height)
    for line in lines:
        if lot.boundary is Boundary.WALL:
            _wall(rng, batch, line, (0.5, 1.4))
        else:
            _fence(rng, batch, line, lot.side)
    return []


def _without(
    start: float, stop: float, gaps: Sequence[tuple[float, float]]
) -> list[tuple[float, float]]:
    stretches = []
    for low, high in gaps:
        if low - start > 0.8:
            stretches.append((start, min(low, stop)))
        start = max(start, high)
    if stop - start > 0.8:
        stretches.append((start, stop))
    return stretches


def _wall(
    rng: np.random.Generator,
    batch: QuadBatch,
    line: Float64[np.ndarray, "n 3"],
    heights: tuple[float, float],
) -> None:
    height = float(rng.uniform(*heights))
    tone = float(rng.uniform(0.3, 0.6))
    choices = (
        Finish(Material.BRICK, (0.36, 0.18, 0.12)),
        Finish(Material.CONCRETE, (tone * 0.8, tone * 0.79, tone * 0.76)),
        Finish(Material.PLASTER, (tone, tone * 0.97, tone * 0.9)),
    )
    finish = choices[int(rng.integers(3))]
    add_boxes_along(batch, line, finish, half_width=0.11, heights=(-0.3, height))
    cap = Finish(Material.CONCRETE, (0.4, 0.39, 0.37))
    add_boxes_along(batch, line, cap, half_width=0.15, heights=(height, height + 0.06))


def _fence(
    rng: np.random.Generator, batch: QuadBatch, line: Float64[np.ndarray, "n 3"], side: Side
) -> None:
    """Pickets of wood or bars of metal on two rails; coarse ones where it is far away."""
    height = float(rng.uniform(0.8, 1.3))
    brown = Finish(Material.WOOD, (0.26, 0.15, 0.08))
    finish = brown if rng.random() < 0.6 else Finish(Material.METAL, (0.12, 0.15, 0.12))
    for level in (0.25, 0.8):
        rail = (level * height, level * height + 0.06)
        add_boxes_along(batch, line, finish, half_width=0.02, heights=rail)
    nearest = float(np.hypot(line[:, 0], line[:, 1]).min())
    pitch = 0.16 if nearest < 25.0 else 0.4 if nearest < 50.0 else 2.0
    lengths = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(line[:, :2], axis=0).T))))
    along = np.arange(0.0, lengths[-1], pitch)
    places = np.stack([np.interp(along, lengths, line[:, axis]) for axis in range(3)], axis=1)
    steps = np.diff(line, axis=0)
    yaws = np.interp(along, lengths[:-1], np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
    outwards = 0.035 * side.sign
    places[:, 0] += outwards * np.sin(yaws)
    places[:, 1] -= outwards * np.cos(yaws)
    add_posts(batch, places, yaws, (0.035, 0.012, height / 2), finish)
