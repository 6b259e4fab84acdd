"""Vehicles that turn from one road into another at a junction."""

from dataclasses import replace
from itertools import product

import numpy as np
from jaxtyping import Float64

from sightline.simulation.crowd import Crowd
from sightline.simulation.layout import Junction, Lane, Layout
from sightline.simulation.layout_line import CenterLine, curved_line, station_grid
from sightline.simulation.motion import STANDING, AlongRoad, Travel

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
        if not lanes[0].for_trams and _is_open(junction, lanes[1].direction, is_from_main)
    ]
    for row in rng.permutation(len(pairs))[:3].tolist():
        if rng.random() > _TURNING_SHARE:
            continue
        (main_lane, cross_lane), is_from_main = pairs[row]
        is_left = (main_lane.direction == cross_lane.direction) == is_from_main
        radius = junction.radius + 1.7 if not is_left else float(rng.uniform(8.0, 12.0))
        line = turning_line(layout, main_lane, cross_lane, radius, is_from_main=is_from_main)
        speed = float(rng.uniform(2.5, 6.0))
        track = AlongRoad(
            terrain=layout.terrain,
            road=replace(layout.main, line=line, lanes=(), crown_m=0.0),
            station=float(rng.uniform(-8.0, 8.0)),
            offset=0.0,
            direction=1,
            travel=STANDING if rng.random() < 0.2 else Travel(speed_mps=speed),
        )
        crowd.add(crowd.draw_vehicle(crowd.customs.heavy_share, 0.07), track, 0.3)


def _is_open(junction: Junction, cross_direction: int, is_from_main: bool) -> bool:  # noqa: FBT001
    """Test whether the arm of the crossing road at the start or end of a turn is built."""
    return junction.opens_left if (cross_direction > 0) == is_from_main else junction.opens_right


def turning_line(
    layout: Layout, main_lane: Lane, cross_lane: Lane, radius_m: float, *, is_from_main: bool
) -> CenterLine:
    """Build the line from one lane along an arc to another; station 0 is half-way round."""
    junction = layout.junction
    assert junction is not None, "one turns at junctions only"
    main, cross = layout.main.line, junction.cross.line
    station = np.array(junction.station - cross_lane.offset)
    ways = [
        _heading(float(line.yaw(at)), lane.direction)
        for line, at, lane in ((main, station, main_lane), (cross, np.zeros(()), cross_lane))
    ]
    entry, leave = ways if is_from_main else ways[::-1]
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
