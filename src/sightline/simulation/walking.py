"""Cyclists, people on foot and people who sit."""

import numpy as np

from sightline.simulation.crowd import Crowd
from sightline.simulation.layout import Ground, Plots, Side, StreetKind, surface_level
from sightline.simulation.motion import AcrossRoad, AlongRoad, Still, Travel
from sightline.simulation.scene import Pose


def cycle(crowd: Crowd) -> None:
    """Cyclists on cycle paths, at the edge of the lanes, or anywhere on squares."""
    rng, main = crowd.rng, crowd.layout.main
    for _ in range(int(rng.poisson(crowd.customs.cyclists * rng.gamma(0.6) / 0.6))):
        side = main.left if rng.random() < 0.5 else main.right
        path = side.band(Ground.CYCLE_PATH)
        direction = -side.sign if rng.random() < 0.85 else side.sign
        if path is not None and rng.random() < 0.8:
            distance = (path.inner + path.outer) / 2 + float(rng.normal(0, 0.15))
        elif crowd.layout.kind is StreetKind.SQUARE:
            distance = float(rng.uniform(0.2, side.outer - 1.5))
        else:
            distance, direction = side.lane_edge - 0.55, -side.sign
            if direction not in {lane.direction for lane in main.lanes}:
                direction = 1
        speed = float(rng.uniform(2.5, 6.5))
        _move_along(
            crowd, "Cyclist", side, 3.0 + float(rng.gamma(2.0, 13.0)), distance, direction, speed
        )


def _move_along(
    crowd: Crowd,
    name: str,
    side: Side,
    station: float,
    distance: float,
    direction: int,
    speed: float,
) -> bool:
    main = crowd.layout.main
    offset = side.sign * distance
    if any(start - 1.0 < station < stop + 1.0 for start, stop in side.gaps):
        return False
    track = AlongRoad(
        terrain=crowd.layout.terrain,
        road=main,
        station=station,
        offset=offset,
        direction=direction,
        travel=Travel(speed_mps=speed),
        level=surface_level(main, station, offset),
        turn=float(crowd.rng.normal(0, 0.03) if speed > 0 else crowd.rng.uniform(-np.pi, np.pi)),
    )
    reach = station + direction * track.travel.distance(crowd.times[-1:])[0]
    if any(start - 1.0 < reach < stop + 1.0 for start, stop in side.gaps):
        return False  # the pavement ends at the junction
    return crowd.add(crowd.models.draw(crowd.rng, name, speed), track, 0.15)


def walk(crowd: Crowd) -> None:
    """Pedestrians on the pavements, alone and in pairs, and some who cross the road."""
    rng = crowd.rng
    chance, mean = crowd.customs.walkers
    if rng.random() > chance:
        return
    left = 1 + int(rng.poisson(max(mean - 1.0, 0.0) * rng.gamma(0.7) / 0.7))
    while left > 0:
        station = 4.0 + float(rng.gamma(1.5, 9.0))
        if rng.random() < 0.22:
            _cross(crowd, station)
            left -= 1
            continue
        group = min(left, int(rng.choice([1, 1, 2, 3])))
        _walk_group(crowd, station, group)
        left -= group


def _walk_group(crowd: Crowd, station: float, count: int) -> None:
    """People side by side, all walking alike or standing together."""
    rng, main = crowd.rng, crowd.layout.main
    side = main.left if rng.random() < 0.5 else main.right
    band = side.band(Ground.PAVEMENT) or side.bands[-1]
    low, high = band.inner + 0.75, band.outer - 0.45
    if crowd.layout.kind is StreetKind.SQUARE:
        low = 0.6
    direction = 1 if rng.random() < 0.5 else -1
    speed = 0.0 if rng.random() < 0.25 else float(rng.uniform(0.9, 1.7))
    first = float(rng.uniform(low, max(low + 0.01, high)))
    for member in range(count):
        distance = min(max(first + 0.8 * member, low), max(low, high))
        place = station + float(rng.uniform(-0.35, 0.35)) + 1.1 * (member // 2)
        own = direction if speed > 0 or rng.random() < 0.5 else -direction
        _move_along(crowd, "Pedestrian", side, place, distance, own, speed)


def _cross(crowd: Crowd, station: float) -> None:
    """Someone on the way over the road, far enough ahead of the traffic."""
    rng, main = crowd.rng, crowd.layout.main
    speed = float(rng.uniform(0.9, 1.6))
    if any(start < station < stop for side in main.sides for start, stop in side.gaps):
        return
    track = AcrossRoad(
        terrain=crowd.layout.terrain,
        road=main,
        station=station,
        offset=float(rng.uniform(-main.right.edge, main.left.edge)),
        direction=1 if rng.random() < 0.5 else -1,
        travel=Travel(speed_mps=speed),
    )
    crowd.add(crowd.models.draw(rng, "Pedestrian", speed), track, 0.4)


def sit(crowd: Crowd) -> None:
    """People on the chairs of a café."""
    rng, main = crowd.rng, crowd.layout.main
    shares = {StreetKind.SQUARE: 0.25, StreetKind.CITY: 0.09}
    if rng.random() > shares.get(crowd.layout.kind, 0.0):
        return
    side = main.left if rng.random() < 0.5 else main.right
    if side.plots is not Plots.BLOCKS:
        return
    middle = 4.5 + float(rng.gamma(2.0, 3.0))
    for _ in range(int(rng.integers(1, 6))):
        station = middle + float(rng.normal(0, 1.8))
        distance = min(side.outer, side.edge + 5.0) - float(rng.uniform(0.9, 2.2))
        place = main.line.place(np.array(station), np.array(side.sign * distance))
        level = surface_level(main, station, side.sign * distance)
        pose = Pose(
            x=float(place[0]),
            y=float(place[1]),
            z=float(crowd.layout.terrain.height(place)) + level,
            yaw=float(rng.uniform(-np.pi, np.pi)),
        )
        crowd.add(crowd.models.draw(rng, "Person_sitting", 0.0), Still(pose=pose), 0.2)
