"""Placement of cyclists, pedestrians and sitting people."""

from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.simulation.bodies.models import ActorModel
from sightline.simulation.scene import Pose
from sightline.simulation.streets.ground import surface_height
from sightline.simulation.streets.layout import Ground, Plots, Side, StreetKind
from sightline.simulation.traffic.crowd import Crowd
from sightline.simulation.traffic.motion import AcrossRoad, Still, Travel

_PAIRS: Final = 0.08  # share of cyclists who ride with another
_ON_PAVEMENT: Final = 0.5  # share of cyclists on the pavement if there is no path
_ELBOW_M: Final = 0.04  # minimum distance between people
_HARD_FACTOR: Final = 1.5


def cycle(crowd: Crowd) -> None:
    """Place cyclists on cycle paths, at the edge of the lanes, or anywhere on squares."""
    rng, main = crowd.rng, crowd.layout.main
    rate = crowd.rates.cyclists / (1 + _PAIRS) * (_HARD_FACTOR if crowd.hard else 1.0)
    for _ in range(int(rng.poisson(rate * rng.gamma(0.6) / 0.6))):
        side = main.left if rng.random() < 0.5 else main.right
        path = side.band(Ground.CYCLE_PATH) or (
            side.band(Ground.PAVEMENT) if rng.random() < _ON_PAVEMENT else None
        )
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
        station = 3.0 + float(rng.gamma(2.0, 13.0))
        for rider in range(2 if rng.random() < _PAIRS else 1):
            behind = station - rider * direction * float(rng.uniform(2.0, 2.8))
            _move_along(crowd, "Cyclist", side, behind, distance, direction, speed)


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
    turn = float(crowd.rng.normal(0, 0.03) if speed > 0 else crowd.rng.uniform(-np.pi, np.pi))
    track = crowd.along(main, station, offset, direction, Travel(speed_mps=speed), turn)
    reach = station + direction * track.travel.distance(crowd.times[-1:])[0]
    if any(start - 1.0 < reach < stop + 1.0 for start, stop in side.gaps):
        return False  # the pavement ends at the junction
    return crowd.add(crowd.models.draw(crowd.rng, name, speed), track, _ELBOW_M)


def walk(crowd: Crowd) -> None:
    """Place pedestrians, alone and in groups: on pavements, at the kerb, crossing the road."""
    rng = crowd.rng
    chance, mean = crowd.rates.walkers
    if rng.random() > chance * (_HARD_FACTOR if crowd.hard else 1.0):
        return
    left = 1 + int(rng.poisson(max(mean - 1.0, 0.0) * rng.gamma(0.7) / 0.7))
    while left > 0:
        station = 3.5 + float(rng.gamma(1.4, 9.5))
        group = min(left, int(rng.choice((1, 2, 3, 4, 6), p=(0.48, 0.3, 0.11, 0.06, 0.05))))
        left -= group
        chance = rng.random()
        if chance < 0.2:
            _cross(crowd, station, group)
        elif chance < 0.32:
            _wait(crowd, station, group)
        else:
            _walk_group(crowd, station, group)


def _abreast(rng: np.random.Generator, count: int) -> Float64[np.ndarray, "count 2"]:
    """Draw positions of group members, ahead [m] and aside: side by side or in file."""
    files = min(count, 1 if rng.random() < 0.5 else 3 if count == 3 else 2)
    rank, file = np.divmod(np.arange(count), files)
    places = np.stack((-0.95 * rank, rng.uniform(0.58, 0.8) * file), axis=1)
    return np.asarray(places + rng.uniform(-0.2, 0.2, (count, 2)) * [1, 0])


def _walk_group(crowd: Crowd, station: float, count: int) -> None:
    """Place people side by side, all walking alike or standing together."""
    rng, main = crowd.rng, crowd.layout.main
    side = main.left if rng.random() < 0.5 else main.right
    band = side.band(Ground.PAVEMENT) or side.bands[-1]
    low, high = band.inner + 0.6, band.outer - 0.45
    if crowd.layout.kind is StreetKind.SQUARE:
        low = 0.6
    direction = 1 if rng.random() < 0.5 else -1
    speed = 0.0 if rng.random() < 0.25 else float(rng.uniform(0.9, 1.7))
    first = float(rng.uniform(low, max(low + 0.01, high)))
    for ahead, aside in _abreast(rng, count):
        distance = min(first + aside, max(low, high))
        own = direction if speed > 0 or rng.random() < 0.5 else -direction
        _move_along(crowd, "Pedestrian", side, station + ahead, distance, own, speed)


def _wait(crowd: Crowd, station: float, count: int) -> None:
    """Place a group that waits to cross at the kerb, at the junction if there is one."""
    rng, main = crowd.rng, crowd.layout.main
    side = main.left if rng.random() < 0.5 else main.right
    for start, stop in side.gaps:
        station = start - 1.6 if rng.random() < 0.5 else stop + 1.6
    heading = float(main.line.yaw(np.array(station))) - side.sign * np.pi / 2
    for behind, along in _abreast(rng, count):
        distance = min(side.edge + 0.45 - behind, side.outer - 0.3)
        yaw = heading + rng.normal(0, 0.3)
        person = crowd.models.draw(rng, "Pedestrian", 0.0)
        stand(crowd, person, side, station + along, distance, yaw)


def stand(
    crowd: Crowd, model: ActorModel, side: Side, station: float, distance: float, yaw: float
) -> None:
    """Place a road user at rest beside the main road."""
    main, spot = crowd.layout.main, (np.array(station), np.array(side.sign * distance))
    x, y = main.line.place(*spot).tolist()
    z = float(surface_height(crowd.layout.terrain, main, *spot))
    crowd.add(model, Still(pose=Pose(x=x, y=y, z=z, yaw=float(yaw))), _ELBOW_M)


def _cross(crowd: Crowd, station: float, count: int) -> None:
    """Place a group that crosses the road, far enough ahead of the traffic."""
    rng, main = crowd.rng, crowd.layout.main
    travel = Travel(speed_mps=float(rng.uniform(0.9, 1.6)))
    if any(start < station < stop for side in main.sides for start, stop in side.gaps):
        return
    offset = float(rng.uniform(-main.right.edge, main.left.edge))
    direction = 1 if rng.random() < 0.5 else -1
    for ahead, aside in _abreast(rng, count):
        track = AcrossRoad(
            terrain=crowd.layout.terrain,
            road=main,
            station=station + aside,
            offset=offset + direction * ahead,
            direction=direction,
            travel=travel,
        )
        model = crowd.models.draw(rng, "Pedestrian", travel.speed_mps)
        crowd.add(model, track, 0.4 if aside == 0.0 else _ELBOW_M)


def sit(crowd: Crowd) -> None:
    """Place people on the chairs of a café."""
    rng, main = crowd.rng, crowd.layout.main
    shares = {StreetKind.SQUARE: 0.2, StreetKind.CITY: 0.07}
    if rng.random() > shares.get(crowd.layout.kind, 0.0):
        return
    side = main.left if rng.random() < 0.5 else main.right
    if side.plots is not Plots.BLOCKS:
        return
    middle = 4.5 + float(rng.gamma(2.0, 3.0))
    for _ in range(int(rng.integers(1, 6))):
        station = middle + float(rng.normal(0, 1.8))
        distance = min(side.outer, side.edge + 5.0) - float(rng.uniform(0.9, 2.2))
        yaw = float(rng.uniform(-np.pi, np.pi))
        person = crowd.models.draw(rng, "Person_sitting", 0.0)
        stand(crowd, person, side, station, distance, yaw)
