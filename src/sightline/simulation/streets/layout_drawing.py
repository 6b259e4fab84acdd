"""Random street layouts: straight, curved and crossing roads of several kinds."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from sightline.simulation.streets.layout import (
    KERB_HEIGHT_M,
    PARKING_DEPTH_M,
    Band,
    CenterLine,
    Ground,
    Junction,
    Lane,
    Layout,
    Parking,
    Plots,
    Road,
    Side,
    StreetKind,
    curved_line,
    draw_terrain,
    station_grid,
    straight_line,
)
from sightline.simulation.tables import read_table

BEHIND_M: Final = 60.0
AHEAD_M: Final = 130.0  # built length of the street behind and ahead of the ego
_CROSS_REACH_M: Final = 90.0
_RADII_M: Final = (4.0, 8.0)
_WIDE_RADII_M: Final = (8.0, 15.0)
"""Ranges of the radius of the kerbs at a junction's corners."""
_WIDE_STATIONS: Final = (26.0, 55.0)
_TABLES: Final = read_table(__file__, "street_kinds")
_KINDS: Final = _TABLES["kinds"]  # probabilities and lane widths by kind; shares sum to 1


def draw_layout(
    rng: np.random.Generator,
    kind: StreetKind | None = None,
    extra_length_m: float = 0.0,
    *,
    hard: bool = False,
    wide: bool = False,
) -> Layout:
    """Draw a street of a kind, or of a kind drawn as often as in KITTI's drives.

    `extra_length_m` is the length of the ego's drive, by which the street is extended; `hard` gives
    parked cars and junctions wherever possible, `wide` a junction of several lanes each way.
    """
    if kind is None:
        shares = {name: row["share"] for name, row in _KINDS.items()}
        kind = StreetKind[_draw_name(rng, shares)]
    road = _draw_section(rng, kind, hard=hard, is_wide=wide)
    last = AHEAD_M + extra_length_m
    crossing = kind is not StreetKind.SQUARE and rng.random() < _KINDS[kind.name]["junctions"] * (
        1.4 if hard else 1.0
    )
    station = float(rng.uniform(14.0, 75.0)) if crossing else None
    if wide:
        station = float(rng.uniform(*_WIDE_STATIONS))
    ego_lane = _draw_ego_lane(rng, road)
    line = _draw_line(rng, kind, last, station, ego_lane.offset)
    road = replace(road, line=line, first=-BEHIND_M, last=last)
    junction = None
    if station is not None:
        road, junction = _with_junction(rng, kind, road, station, is_wide=wide)
    waits = junction is not None and junction.station > 22.0 and rng.random() < 0.25
    return Layout(
        kind=kind,
        terrain=draw_terrain(rng, hard=hard),
        main=road,
        junction=junction,
        ego_lane=ego_lane,
        main_waits=waits,
        wooded_horizon=kind is not StreetKind.CITY or bool(rng.random() < 0.3),
    )


def _draw_name(rng: np.random.Generator, shares: Mapping[str, float]) -> str:
    return list(shares)[int(rng.choice(len(shares), p=list(shares.values())))]


def _draw_line(
    rng: np.random.Generator,
    kind: StreetKind,
    last: float,
    junction: float | None,
    origin_offset: float,
) -> CenterLine:
    """Draw a straight, curved or winding line; it is straight at a junction."""
    stations = station_grid(-BEHIND_M - 30.0, last + 30.0)
    sharpest = 0.012 if kind in (StreetKind.RESIDENTIAL, StreetKind.COUNTRY) else 0.007
    if junction is not None:
        sharpest *= 0.5
    curvature = float(rng.uniform(-sharpest, sharpest))
    form = rng.choice(3, p=(0.3, 0.4, 0.3))
    if form == 0:
        curvatures = np.zeros(len(stations))
    elif form == 1:
        curvatures = np.full(len(stations), curvature)
    else:
        length, phase = rng.uniform(110.0, 200.0), rng.uniform(0, 2 * np.pi)
        curvatures = curvature * np.sin(2 * np.pi * stations / length + phase)
    if junction is not None:
        away = np.clip((np.abs(stations - junction) - 28.0) / 20.0, 0.0, 1.0)
        curvatures = curvatures * away * away * (3 - 2 * away)
    return curved_line(stations, curvatures, origin_offset)


def _draw_ego_lane(rng: np.random.Generator, road: Road) -> Lane:
    """Draw a lane of the ego's direction, mostly the rightmost."""
    lanes = sorted(
        (lane for lane in road.lanes if lane.direction == 1 and not lane.for_trams),
        key=lambda lane: lane.offset,
    )
    return lanes[min(int(rng.random() * 1.45), len(lanes) - 1)]


def _draw_section(
    rng: np.random.Generator,
    kind: StreetKind,
    *,
    is_plain: bool = False,
    hard: bool = False,
    is_wide: bool = False,
) -> Road:
    """Draw lanes and sides of a road, if plain without trams or one-way lane; its line follows."""
    lanes = _draw_lanes(rng, kind, is_plain=is_plain, is_wide=is_wide)
    left_edge = max(lane.offset + lane.width / 2 for lane in lanes)
    right_edge = -min(lane.offset - lane.width / 2 for lane in lanes)
    left = _draw_side(rng, kind, 1, left_edge, hard=hard)
    right = _draw_side(rng, kind, -1, right_edge, hard=hard)
    fall = 0.0 if kind is StreetKind.SQUARE else float(rng.uniform(*_FALLS))
    return Road(
        line=straight_line(np.zeros(2), 0.0, 0.0, 1.0),
        first=0.0,
        last=1.0,
        lanes=lanes,
        left=left,
        right=right,
        has_kerbs=kind not in (StreetKind.COUNTRY, StreetKind.SQUARE),
        crown_m=fall * min(left.edge, right.edge),
    )


_FALLS: Final = (0.012, 0.03)  # mean slope of carriageways towards their edges


def _draw_lanes(
    rng: np.random.Generator, kind: StreetKind, *, is_plain: bool, is_wide: bool
) -> tuple[Lane, ...]:
    """Draw lanes from right to left; the line runs between the directions."""
    width = float(rng.uniform(*_KINDS[kind.name]["lane_width_m"]))
    is_narrow = kind in (StreetKind.RESIDENTIAL, StreetKind.SQUARE) and rng.random() < 0.3
    if is_narrow and not is_plain:
        return (Lane(offset=0.0, width=width + 0.6, direction=1),)
    ahead, back = 1, 1
    if kind in (StreetKind.AVENUE, StreetKind.CITY):
        wide = 0.6 if kind is StreetKind.AVENUE else 0.25
        ahead, back = (int(count) for count in 1 + (rng.random(2) < wide))
    if is_wide:
        ahead, back = (int(count) for count in rng.integers(2, 4, 2))
    has_trams = kind in (StreetKind.AVENUE, StreetKind.CITY) and rng.random() < 0.22
    trams = has_trams and not is_plain
    median = 3.2 if trams else 0.0
    lanes = [
        Lane(offset=-median - (row + 0.5) * width, width=width, direction=1)
        for row in reversed(range(ahead))
    ]
    if trams:
        lanes += [
            Lane(offset=sign * median / 2, width=median, direction=-sign, for_trams=True)
            for sign in (-1, 1)
        ]
    lanes += [
        Lane(offset=median + (row + 0.5) * width, width=width, direction=-1) for row in range(back)
    ]
    return tuple(lanes)


def _draw_side(
    rng: np.random.Generator, kind: StreetKind, sign: int, lane_edge: float, *, hard: bool
) -> Side:
    plots = Plots[_draw_name(rng, _KINDS[kind.name]["plots"])]
    parking = _draw_parking(rng, kind, hard=hard)
    edge = lane_edge + PARKING_DEPTH_M[parking]
    bands = []
    start = edge
    for ground, width in _draw_bands(rng, kind):
        bands.append(Band(ground=ground, inner=start, outer=start + width))
        start += width
    has_verge = bands[0].ground is Ground.VERGE
    rows = {StreetKind.CITY: 0.3, StreetKind.COUNTRY: 0.3, StreetKind.AVENUE: 0.55}
    return Side(
        sign=sign,
        lane_edge=lane_edge,
        edge=edge,
        level=0.0 if kind in (StreetKind.COUNTRY, StreetKind.SQUARE) else KERB_HEIGHT_M,
        parking=parking,
        bands=tuple(bands),
        plots=plots,
        setback=float(rng.uniform(*_TABLES["setbacks_m"][plots.name])),
        has_tree_row=bool(rng.random() < (0.8 if has_verge else rows.get(kind, 0.35))),
    )


def _draw_parking(rng: np.random.Generator, kind: StreetKind, *, hard: bool) -> Parking:
    parallel, angled = _KINDS[kind.name]["parallel"], _KINDS[kind.name]["angled"]
    chance = float(rng.random()) * (0.7 if hard else 1.0)
    if chance < parallel:
        return Parking.PARALLEL
    if chance < parallel + angled:
        return Parking.ANGLED if rng.random() < 0.75 else Parking.PERPENDICULAR
    return Parking.NONE


def _draw_bands(rng: np.random.Generator, kind: StreetKind) -> list[tuple[Ground, float]]:
    """Draw kinds and widths [m] of the bands from the carriageway outwards."""
    if kind is StreetKind.COUNTRY:
        return [(Ground.SHOULDER, float(rng.uniform(0.8, 2.0)))]
    if kind is StreetKind.SQUARE:
        return [(Ground.PAVEMENT, float(rng.uniform(3.0, 11.0)))]
    bands: list[tuple[Ground, float]] = []
    if rng.random() < {StreetKind.AVENUE: 0.75, StreetKind.RESIDENTIAL: 0.12}.get(kind, 0.1):
        bands.append((Ground.VERGE, float(rng.uniform(1.6, 3.5))))
    if rng.random() < {StreetKind.AVENUE: 0.5, StreetKind.CITY: 0.3}.get(kind, 0.0):
        bands.append((Ground.CYCLE_PATH, float(rng.uniform(1.4, 1.9))))
    low, high = (2.4, 4.5) if kind is StreetKind.CITY else (1.5, 2.7)
    bands.append((Ground.PAVEMENT, float(rng.uniform(low, high))))
    return bands


def _with_junction(
    rng: np.random.Generator, kind: StreetKind, main: Road, station: float, *, is_wide: bool
) -> tuple[Road, Junction]:
    """Add a junction: the main road with gaps, and the crossing road."""
    cross_kind = StreetKind.RESIDENTIAL if kind is StreetKind.AVENUE else kind
    cross = _draw_section(
        rng, StreetKind.AVENUE if is_wide else cross_kind, is_plain=True, is_wide=is_wide
    )
    opens_left, opens_right = ((True, True), (True, False), (False, True))[int(rng.choice(3))]
    if is_wide:
        opens_left = opens_right = True
    radius = float(rng.uniform(*(_WIDE_RADII_M if is_wide else _RADII_M)))
    sides = (*main.sides, *cross.sides)
    corner = max(radius, *(side.outer - side.edge for side in sides))
    line = straight_line(
        main.line.place(np.array(station), np.array(0.0)),
        float(main.line.yaw(np.array(station))) + np.pi / 2,
        -_CROSS_REACH_M,
        _CROSS_REACH_M,
    )
    own_gap = (-main.right.edge - corner, main.left.edge + corner)
    cross = replace(
        cross,
        line=line,
        first=-_CROSS_REACH_M if opens_right else main.left.edge,
        last=_CROSS_REACH_M if opens_left else -main.right.edge,
        left=replace(cross.left, gaps=(own_gap,)),
        right=replace(cross.right, gaps=(own_gap,)),
    )
    # The crossing road's left side faces the start of the main road.
    gap = (station - cross.left.edge - corner, station + cross.right.edge + corner)
    main = replace(
        main,
        left=replace(main.left, gaps=(gap,) if opens_left else ()),
        right=replace(main.right, gaps=(gap,) if opens_right else ()),
    )
    return main, Junction(
        station=station,
        radius=radius,
        corner=corner,
        cross=cross,
        opens_left=opens_left,
        opens_right=opens_right,
        has_lights=kind in (StreetKind.CITY, StreetKind.AVENUE) and bool(rng.random() < 0.7),
    )
