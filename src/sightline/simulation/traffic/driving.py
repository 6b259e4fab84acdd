"""Vehicles on the lanes, in rows at the kerb and off the road."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.simulation.scene import Pose
from sightline.simulation.streets.layout import (
    PARKING_DEPTH_M,
    CenterLine,
    Lane,
    Layout,
    Parking,
    Road,
    Side,
    curved_line,
    station_grid,
)
from sightline.simulation.streets.lots import Bay
from sightline.simulation.streets.markings import (
    bay_lean,
    bay_pitch,
    open_stretches,
    parking_stretches,
)
from sightline.simulation.traffic.crowd import (
    AHEAD_M,
    BACK_M,
    EGO_SIZE_LW,
    Crowd,
    stopping_distance_m,
)
from sightline.simulation.traffic.motion import STANDING, Still, Travel

_TURNING_SHARE = 0.18
_REACH_M = 40.0
"""Length of a turning vehicle's line before and after the bend; beyond, it continues straight."""


def turn(crowd: Crowd) -> None:
    """Place vehicles that turn at a junction."""
    layout, rng = crowd.layout, crowd.rng
    junction = layout.junction
    if junction is None:
        return
    pairs = [
        (lanes, is_from_main)
        for lanes in product(layout.main.lanes, junction.cross.lanes)
        for is_from_main in (True, False)
        if not lanes[0].for_trams
        # The arm of the crossing road at the start or end of the turn must be built.
        and ((lanes[1].direction > 0) == is_from_main or junction.opens_right)
        and ((lanes[1].direction > 0) != is_from_main or junction.opens_left)
    ]
    for row in rng.permutation(len(pairs))[:3].tolist():
        if rng.random() > _TURNING_SHARE:
            continue
        (main_lane, cross_lane), is_from_main = pairs[row]
        is_left = (main_lane.direction == cross_lane.direction) == is_from_main
        radius = junction.radius + 1.7 if not is_left else float(rng.uniform(8.0, 12.0))
        line = turning_line(layout, main_lane, cross_lane, radius, is_from_main=is_from_main)
        speed = float(rng.uniform(2.5, 6.0))
        road = replace(layout.main, line=line, lanes=(), crown_m=0.0)
        station = float(rng.uniform(-8.0, 8.0))
        travel = STANDING if rng.random() < 0.2 else Travel(speed_mps=speed)
        track = crowd.along(road, station, 0.0, 1, travel)
        crowd.add(crowd.draw_vehicle(crowd.rates.heavy_share, 0.07), track, 0.3)


def turning_line(
    layout: Layout, main_lane: Lane, cross_lane: Lane, radius_m: float, *, is_from_main: bool
) -> CenterLine:
    """Build the line from one lane along an arc to another; station 0 is half-way round."""
    junction = layout.junction
    assert junction is not None, "one turns at junctions only"
    main, cross = layout.main.line, junction.cross.line
    station = np.array(junction.station - cross_lane.offset)
    headings = [
        _heading(float(line.yaw(at)), lane.direction)
        for line, at, lane in ((main, station, main_lane), (cross, np.zeros(()), cross_lane))
    ]
    entry, leave = headings if is_from_main else headings[::-1]
    side = 1.0 if entry[0] * leave[1] - entry[1] * leave[0] > 0 else -1.0
    corner = main.place(station, np.array(main_lane.offset))
    middle = corner + radius_m * (1 - np.sqrt(0.5)) * (leave - entry)
    half = radius_m * np.pi / 4
    stations = station_grid(-half - _REACH_M, half + _REACH_M)
    # A quarter turn in total, although the arc's ends lie between two stations.
    share = np.clip((half - np.abs(stations)) / 0.5 + 0.5, 0.0, 1.0)
    bend = curved_line(stations, side * np.pi / 2 * share / (0.5 * share.sum()), 0.0)
    yaw = float(np.arctan2(*(entry + leave)[::-1]))
    along = _heading(yaw, 1)
    turned = bend.points @ np.stack((along, [-along[1], along[0]]))
    return CenterLine(
        first_station=bend.first_station, points=turned + middle, yaws=bend.yaws + yaw
    )


def _heading(yaw: float, direction: int) -> Float64[np.ndarray, "2"]:
    return direction * np.array([np.cos(yaw), np.sin(yaw)])


_ONCOMING_FACTOR: Final = 1.4
"""Density of oncoming traffic relative to that ahead of the ego, which keeps its distance."""
_PARKED_VANS: Final = 0.042
_PARKED_MISC: Final = 0.05
_QUEUE_FACTOR: Final = 0.8
"""Factor on the probability of closing up on the crossing road: its queues are shorter."""
_JAMMED_LANES: Final = 0.6  # probability of a queue on a lane in a traffic jam


def drive_lanes(crowd: Crowd) -> None:
    """Fill all lanes with traffic: it waits at the junction or drives through it."""
    for road in crowd.layout.roads:
        is_main = road is crowd.layout.main
        gaps = road.left.gaps
        is_through = is_main or (road.first + 5 < gaps[0][0] and gaps[0][1] < road.last - 5)
        goes = crowd.layout.main_waits != is_main and is_through
        for lane in road.lanes:
            stretches = ((road.first, road.last),) if goes else open_stretches(crowd.layout, road)
            for first, last in stretches:
                _fill_lane(crowd, road, lane, first, last, goes=goes)


def _fill_lane(
    crowd: Crowd, road: Road, lane: Lane, first: float, last: float, *, goes: bool
) -> None:
    """Place vehicles one after the other, from the front of a lane to its rear."""
    rng = crowd.rng
    junction_ahead = last < road.last if lane.direction > 0 else first > road.first
    waits = not goes and junction_ahead
    is_ego_lane = road is crowd.layout.main and lane is crowd.layout.ego_lane
    if lane is crowd.layout.ego_lane and not waits:
        travel = crowd.ego_travel if goes or first <= 0 else crowd.draw_travel(0.0)
    else:
        travel = STANDING if waits else crowd.draw_travel(0.1 if goes else 0.0)
    if lane.for_trams:
        _drive_tram(crowd, road, lane, first, last)
        return
    gap = 2.0 if travel is STANDING else stopping_distance_m(travel.speed_mps)
    density = crowd.rates.vehicles_per_km / 1000 * crowd.busyness * float(rng.gamma(2.0) / 2)
    density *= 3.0 if waits else _ONCOMING_FACTOR if lane.direction < 0 else 1.0
    queues = waits or (crowd.is_jammed and goes and rng.random() < _JAMMED_LANES)
    closed_up = float(rng.uniform(0.35, 0.97)) if queues else 0.0
    closed_up *= 1.0 if road is crowd.layout.main else _QUEUE_FACTOR
    rarity = crowd.draw_rarity()
    first, last = max(first, BACK_M), min(last, AHEAD_M + 20.0)
    position = last if lane.direction > 0 else first
    position -= lane.direction * (2.0 if waits else float(rng.exponential(1 / density)))
    while first < position < last:
        model = crowd.draw_vehicle(crowd.rates.heavy_share, crowd.rates.van_share)
        length = model.size_lwh[0]
        station = position - lane.direction * length / 2
        offset = lane.offset + float(rng.normal(0, 0.12))
        track = crowd.along(road, station, offset, lane.direction, travel)
        is_beside_ego = is_ego_lane and abs(station) <= gap + length / 2 + EGO_SIZE_LW[0] / 2
        if first < station - length / 2 and station + length / 2 < last and not is_beside_ego:
            crowd.add(model, track, 0.2, rarity)
        # The gap between two cars is the drivers' safe distance and, mostly, some more.
        more = float(rng.exponential(1.0 if rng.random() < closed_up else 1 / density))
        position = station - lane.direction * (length / 2 + gap + more)


def _drive_tram(crowd: Crowd, road: Road, lane: Lane, first: float, last: float) -> None:
    if crowd.rng.random() > 0.46:
        return
    model = crowd.models.draw(crowd.rng, "Tram", 0.0)
    station = float(crowd.rng.uniform(max(first, 5.0), min(last, 105.0)))
    track = crowd.along(road, station, lane.offset, lane.direction, crowd.draw_travel(0.3))
    crowd.add(model, track, 0.3)


def park(crowd: Crowd, road: Road, side: Side) -> None:
    """Place a row of parked cars along a kerb at random."""
    if side.parking is Parking.NONE:
        return
    share = float(np.clip(crowd.fullness + crowd.rng.normal(0, 0.12), 0.02, 1.0))
    if road is not crowd.layout.main:
        share *= 0.6
    rarity = crowd.draw_rarity()
    for start, stop in parking_stretches(crowd.layout, road, side):
        first, last = max(start, BACK_M), min(stop, AHEAD_M)
        if side.parking is Parking.PARALLEL:
            _park_parallel(crowd, road, side, (first, last), share, rarity)
        else:
            _park_across(crowd, road, side, (first, last), share, rarity)


def _park_parallel(
    crowd: Crowd, road: Road, side: Side, stretch: tuple[float, float], share: float, rarity: float
) -> None:
    rng = crowd.rng
    first, last = stretch
    usual = 1 if side.sign < 0 or len({lane.direction for lane in road.lanes}) == 1 else -1
    middle = side.edge - PARKING_DEPTH_M[Parking.PARALLEL] / 2
    position = first + float(rng.uniform(0.0, 5.0))
    while position < last - 4.0:
        if rng.random() > share:
            position += bay_pitch(Parking.PARALLEL)
            continue
        model = crowd.draw_vehicle(0.006, _PARKED_VANS, _PARKED_MISC)
        direction = usual if rng.random() < (0.96 if side.sign < 0 else 0.8) else -usual
        offset = side.sign * (middle + float(rng.normal(0, 0.08)))
        station = position + model.size_lwh[0] / 2
        track = crowd.along(road, station, offset, direction, STANDING, _askew(rng))
        if position + model.size_lwh[0] < last:
            crowd.add(model, track, 0.15, rarity)
        position += model.size_lwh[0] + float(rng.uniform(0.4, 1.3))


def _park_across(
    crowd: Crowd, road: Road, side: Side, stretch: tuple[float, float], share: float, rarity: float
) -> None:
    """Place cars in marked places, with the nose to the kerb or to the lane."""
    rng = crowd.rng
    first, last = stretch
    depth = side.edge - side.lane_edge
    drift = -side.sign * bay_lean(side.parking) * depth
    pitch = bay_pitch(side.parking)
    heading = float(np.arctan2(side.sign * depth, drift))
    for start in np.arange(first, last - pitch, pitch):
        if rng.random() > share:
            continue
        model = crowd.draw_vehicle(0.0, _PARKED_VANS, _PARKED_MISC)
        backwards = side.parking is Parking.PERPENDICULAR and rng.random() < 0.3
        station = float(start) + (pitch + drift) / 2
        offset = side.sign * ((side.edge + side.lane_edge) / 2 + float(rng.normal(0, 0.12)))
        turned = heading + (np.pi if backwards else 0.0) + _askew(rng)
        track = crowd.along(road, station, offset, 1, STANDING, turned)
        crowd.add(model, track, 0.1, rarity)


def fill_bays(crowd: Crowd, bays: Sequence[Bay]) -> None:
    """Place cars in driveways and forecourts."""
    rng = crowd.rng
    rarity = crowd.draw_rarity()
    for bay in bays:
        share = bay.taken**0.5 if crowd.hard else bay.taken
        if rng.random() > share or np.hypot(bay.x, bay.y) > AHEAD_M:
            continue
        model = crowd.draw_vehicle(0.0, _PARKED_VANS, _PARKED_MISC)
        height = float(crowd.layout.terrain.height(np.array([bay.x, bay.y]))) + bay.level
        yaw = bay.yaw + _askew(rng)
        crowd.add(model, Still(pose=Pose(x=bay.x, y=bay.y, z=height, yaw=yaw)), 0.2, rarity)


def _askew(rng: np.random.Generator) -> float:
    """Draw the misalignment of a parked car in its row [rad]: mostly small."""
    return float(rng.normal(0, 0.09 if rng.random() < 0.15 else 0.02))
