"""Boundaries of the plots beside a street: hedges, walls, fences, and garages between houses."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float, Float64

from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import QuadBatch, box_corners
from sightline.simulation.shapes.primitives import Finish
from sightline.simulation.streets.layout import Layout, Plots, Side, ground_places
from sightline.simulation.streets.lots import Boundary, Lot
from sightline.simulation.surroundings.trees import make_hedge

_WIDEST_GAP_M: Final = 26.0
_CLOSED_SHARE: Final = 0.9
_GARAGE_DEPTH_M: Final = 5.4


def add_boxes_along(
    batch: QuadBatch,
    line: Float[np.ndarray, "num_points 3"],
    finish: Finish,
    *,
    half_width: float,
    heights: tuple[float, float],
) -> None:
    """Add a wall or rail along a line of world points, between two heights above it."""
    steps = np.diff(line, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    low, high = heights
    # Pieces overlap a little; otherwise bends would have gaps.
    halves = np.stack(
        (lengths / 2 + half_width * 0.5, np.full(len(steps), half_width),
         np.full(len(steps), (high - low) / 2)),
        axis=1,
    )  # fmt: skip
    centers = (line[1:] + line[:-1]) / 2 + [0, 0, (high + low) / 2]
    batch.add(box_corners(centers, halves, np.arctan2(steps[:, 1], steps[:, 0])), finish)


def add_posts(
    batch: QuadBatch,
    places: Float[np.ndarray, "count 3"],
    yaws: Float[np.ndarray, " count"],
    half_size: tuple[float, float, float],
    finish: Finish,
) -> None:
    """Add upright posts or pickets with their feet at places on the ground."""
    halves = np.tile(half_size, (len(places), 1))
    batch.add(box_corners(places + np.array([0, 0, half_size[2]]), halves, yaws), finish)


def enclose(rng: np.random.Generator, batch: QuadBatch, layout: Layout, lot: Lot) -> list[Mesh]:
    """Build a hedge, fence or wall at the pavement, open at the driveway and the door."""
    if lot.boundary is Boundary.OPEN or lot.front - lot.side.outer < 1.2:
        return []
    inset = lot.side.outer + 0.35
    gaps = [] if lot.driveway is None else [(lot.driveway - 1.7, lot.driveway + 1.7)]
    if lot.building is not None:
        middle = lot.building[0] + lot.building[1] / 2
        gaps.append((middle - 0.7, middle + 0.7))
    stretches = _subtract_gaps(lot.start, min(lot.stop, lot.road.last), sorted(gaps))
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


def close_gap(
    rng: np.random.Generator, batch: QuadBatch, layout: Layout, lot: Lot, after: Lot
) -> list[Mesh]:
    """Close the gap to the next building by a garage, a hedge, a wall or boards.

    Without it, there would be distant views between houses, which are rare in real streets.
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


def _garage(
    rng: np.random.Generator,
    batch: QuadBatch,
    layout: Layout,
    lot: Lot,
    middle: Float64[np.ndarray, "n 3"],
    front: float,
) -> None:
    """Build a flat-roofed garage along its middle line, with its door to the street."""
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


def _subtract_gaps(
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
    """Build pickets of wood or bars of metal on two rails; coarse ones at a distance."""
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
