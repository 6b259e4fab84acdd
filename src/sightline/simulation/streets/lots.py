"""Plots beside a street, with sites of buildings and of cars off the road."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.simulation.arrays import Values
from sightline.simulation.streets.layout import Layout, Plots, Road, Side

_BUILT_FROM_M: Final = -50.0
_CROSS_CLEARANCE_M: Final = 26.0
"""Distance of the crossing road's plots from the junction, beyond the main road's plots."""


Boundary = Enum("Boundary", "OPEN HEDGE FENCE WALL")  # boundary between a plot and the pavement


@dataclass(frozen=True, kw_only=True, slots=True)
class Lot:
    """Piece of land along a side of a road, with or without a building."""

    road: Road
    side: Side
    plots: Plots
    start: float  # station of its start
    width: float
    front: float  # distance of the building's front from the centre line
    building: tuple[float, float, float] | None  # start station, width and depth of the building
    driveway: float | None  # station of the middle of a driveway or of the entrance to a forecourt
    boundary: Boundary

    @property
    def stop(self) -> float:
        """Station of its end."""
        return self.start + self.width


@dataclass(frozen=True, kw_only=True, slots=True)
class Footprint:
    """Rectangle covered by a building."""

    corner: tuple[float, float]  # world x, y of the left end of its front, viewed from the street
    yaw: float  # heading of the front to the right; the building is to the left of it
    width: float
    depth: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Bay:
    """Parking place off the road: world x, y and heading."""

    x: float
    y: float
    yaw: float
    level: float  # height above the terrain [m]
    taken: float  # probability of a parked car


def draw_lots(rng: np.random.Generator, layout: Layout) -> tuple[Lot, ...]:
    """Divide the land along all roads into lots."""
    lots: list[Lot] = []
    for road in layout.roads:
        is_main = road is layout.main
        margin = 2.0 if is_main else _CROSS_CLEARANCE_M
        first = max(road.first, _BUILT_FROM_M) if is_main else road.first
        for side in road.sides:
            for start, stop in side.stretches(first, road.last, margin):
                lots += _lots_along(rng, road, side, start, stop)
    return tuple(lots)


def footprint_of(lot: Lot) -> Footprint | None:
    """Compute the footprint of a lot's building."""
    if lot.building is None:
        return None
    start, width, depth = lot.building
    sign = lot.side.sign
    middle = np.array(start + width / 2)
    yaw = float(lot.road.line.yaw(middle)) + (0.0 if sign > 0 else np.pi)
    place = lot.road.line.place(middle, np.array(sign * lot.front))
    corner = place - width / 2 * np.array([np.cos(yaw), np.sin(yaw)])
    return Footprint(corner=(float(corner[0]), float(corner[1])), yaw=yaw, width=width, depth=depth)


def with_lowered_kerbs(layout: Layout, lots: Sequence[Lot]) -> Layout:
    """Add ramps to the kerbs at the driveways of lots."""

    def lowered(road: Road) -> Road:
        left, right = (
            replace(
                side,
                ramps=tuple(
                    lot.driveway
                    for lot in lots
                    if lot.side is side and lot.driveway is not None and road.has_kerbs
                ),
            )
            for side in road.sides
        )
        return replace(road, left=left, right=right)

    junction = layout.junction
    if junction is not None:
        junction = replace(junction, cross=lowered(junction.cross))
    return replace(layout, main=lowered(layout.main), junction=junction)


def bays_of(rng: np.random.Generator, lots: tuple[Lot, ...]) -> tuple[Bay, ...]:
    """Draw parking places in driveways, forecourts and car parks."""
    bays = []
    for lot in lots:
        stations, distances = _bay_grid(rng, lot)
        # Yards are nearly full or empty, driveways mostly empty.
        taken = float(rng.uniform(0.05, 0.25) if len(stations) < 2 else rng.beta(0.5, 1.6))
        places = lot.road.line.place(stations, lot.side.sign * distances)
        headings = lot.road.line.yaw(stations) + lot.side.sign * np.pi / 2
        for place, inwards in zip(places, headings.tolist(), strict=True):
            yaw = inwards if rng.random() < 0.6 else inwards + np.pi
            x, y = place.tolist()
            bays.append(Bay(x=x, y=y, yaw=yaw, level=lot.side.level, taken=taken))
    return tuple(bays)


def _bay_grid(rng: np.random.Generator, lot: Lot) -> tuple[Values, Values]:
    """Compute the station and the distance from the centre line of each parking place on a lot."""
    room = lot.front - lot.side.outer
    distances: tuple[float, ...] = ()
    stations = np.zeros(0)
    if lot.plots is Plots.CAR_PARK:
        stations, distances = car_park_rows(lot), tuple(lot.side.outer + np.array(CAR_ROWS_M))
        stations = (stations[1:] + stations[:-1]) / 2
    elif lot.driveway is None or lot.building is None:
        pass
    elif lot.plots is Plots.HALLS and room > 8.0:
        stations = np.arange(lot.building[0] + 1.5, lot.building[0] + lot.building[1], 2.7)
        stations = stations[np.abs(stations - lot.driveway) > 3.5]
        distances = (lot.front - 3.6,)
    elif lot.plots is not Plots.HALLS and room > 5.4:
        # Some cars stand across the pavement, about to leave.
        out = float(rng.uniform(0.8, 2.2)) if rng.random() < 0.15 else 0.0
        stations, distances = np.array([lot.driveway]), (lot.side.outer + 2.9 - out,)
    grid = np.meshgrid(stations, np.array(distances))
    return grid[0].ravel(), grid[1].ravel()


CAR_ROWS_M: Final = (4.0, 14.6)
"""Middles of the two rows of a car park, measured beyond the pavement; cars drive between them."""


def car_park_rows(lot: Lot) -> Values:
    """Compute the stations of the lines between the places of a car park."""
    return np.arange(lot.start + 3.0, min(lot.stop - 3.0, 80.0), 2.6)


def _lots_along(
    rng: np.random.Generator, road: Road, side: Side, first: float, last: float
) -> list[Lot]:
    if side.plots in (Plots.PARK, Plots.FOREST, Plots.FIELD, Plots.CAR_PARK):
        boundary = _draw_boundary(rng, side.plots)
        return [
            Lot(
                road=road, side=side, plots=side.plots, start=first, width=last - first,
                front=side.outer + side.setback, building=None, driveway=None, boundary=boundary,
            )
        ]  # fmt: skip
    lots = []
    station = first + float(rng.uniform(0.0, 4.0))
    boundary = _draw_boundary(rng, side.plots)
    while station < last - 6.0:
        width, depth, gap = _draw_building(rng, side.plots)
        width = min(width, last - station)
        if width < 5.0:
            break
        front = side.outer + side.setback
        if side.plots in (Plots.HOUSES, Plots.APARTMENTS):
            front += float(rng.uniform(0.0, 1.5))
            if rng.random() < 0.25:
                boundary = _draw_boundary(rng, side.plots)
        ahead = gap * float(rng.uniform(0.3, 0.7))
        has_driveway = rng.random() < _DRIVEWAY_SHARES.get(side.plots, 0.0)
        room = min(gap + 1.0, last - station - width)
        driveway = station + width + room / 2 if gap > 2.2 else station + width / 2
        lots.append(
            Lot(
                road=road,
                side=side,
                plots=side.plots,
                start=station - ahead,
                width=width + gap,
                front=front,
                building=(station, width, depth),
                driveway=float(driveway) if has_driveway and driveway < last - 2.0 else None,
                boundary=boundary,
            )
        )
        station += width + gap
    return lots


_DRIVEWAY_SHARES: Final = {
    Plots.HOUSES: 0.75,
    Plots.TERRACES: 0.2,
    Plots.APARTMENTS: 0.3,
    Plots.HALLS: 0.8,
}


def _draw_building(rng: np.random.Generator, plots: Plots) -> tuple[float, float, float]:
    """Draw width and depth of a building, and the distance to the next [m]."""
    if plots is Plots.HOUSES:
        low, high = (8.0, 8.0, 3.2), (13.5, 11.0, 9.0)
    elif plots is Plots.TERRACES:
        low, high = (6.0, 9.0, 0.0), (8.0, 10.0, 0.0)
    elif plots is Plots.APARTMENTS:
        low, high = (16.0, 10.0, 6.0), (34.0, 13.0, 16.0)
    elif plots is Plots.HALLS:
        low, high = (18.0, 14.0, 6.0), (42.0, 24.0, 25.0)
    else:
        low, high = (9.0, 10.0, 0.0), (20.0, 13.0, 0.0)
    width, depth, gap = rng.uniform(low, high).tolist()
    if plots is Plots.BLOCKS and rng.random() < 0.08:
        gap = 4.0
    return width, depth, gap


def _draw_boundary(rng: np.random.Generator, plots: Plots) -> Boundary:
    if plots is Plots.FIELD:
        return Boundary.FENCE if rng.random() < 0.2 else Boundary.OPEN
    if plots in (Plots.BLOCKS, Plots.HALLS, Plots.FOREST, Plots.CAR_PARK):
        return Boundary.OPEN
    shares = {Plots.HOUSES: (0.2, 0.42, 0.14, 0.24), Plots.PARK: (0.25, 0.5, 0.05, 0.2)}
    return list(Boundary)[int(rng.choice(4, p=shares.get(plots, (0.35, 0.42, 0.08, 0.15))))]


def footprint_corners(footprint: Footprint) -> Float64[np.ndarray, "4 2"]:
    """Compute world x, y of the corners, counter-clockwise from the front's start."""
    along = np.array([np.cos(footprint.yaw), np.sin(footprint.yaw)])
    inwards = np.array([-along[1], along[0]])
    start = np.array(footprint.corner)
    width, depth = along * footprint.width, inwards * footprint.depth
    return np.stack((start, start + width, start + width + depth, start + depth))
