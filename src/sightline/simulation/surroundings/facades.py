"""Walls with openings: windows, doors and shop fronts in reveals."""

from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float, Float64

from sightline.simulation.arrays import Values
from sightline.simulation.scene import Material
from sightline.simulation.shapes.edits import QuadBatch
from sightline.simulation.shapes.primitives import Finish

Facade = Enum("Facade", "STREET SIDE BLIND")  # kind of a building's wall


@dataclass(frozen=True, kw_only=True, slots=True)
class Look:
    """Finishes of a building's walls, and dimensions of its windows [m]."""

    wall: Finish
    base: Finish
    trim: Finish
    door: Finish
    window_width: float
    window_height: float
    window_pitch: float  # distance between the middles of neighbouring windows
    recess: float  # depth of windows in the wall
    shutter_share: float  # share of windows with lowered roller blinds
    has_folding_shutters: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Front:
    """Wall that runs to the right from its start, viewed from outside."""

    start: tuple[float, float]  # world x, y
    yaw: float
    ground: float  # world z of the street in front
    length: float
    plinth: float
    storeys: int
    storey_height: float
    facade: Facade
    has_shop: bool
    is_glazed: bool = False
    foundation: float
    is_far: bool


class _Openings(NamedTuple):
    """Holes in one storey: edges along the wall, and their common bottom and top."""

    starts: Float64[np.ndarray, " num_openings"]
    stops: Float64[np.ndarray, " num_openings"]
    low: float
    high: float


_ALONG: Final = np.array([0, 1, 1, 0])
_UP: Final = np.array([0, 0, 1, 1])  # index of the span's end for each corner of a rectangle
_SHOP_HEIGHT: Final = 2.5
_DOOR_WIDTH: Final = 1.1
_FRAME: Final = 0.07
_MULLION: Final = 0.02
_COATED_TONES: Final = ((0.02, 0.03, 0.035), (0.02, 0.035, 0.03), (0.05, 0.045, 0.035))
_GLASS_TONES: Final = ((0.03, 0.035, 0.04), (0.06, 0.065, 0.07), (0.30, 0.29, 0.27))


def build_front(rng: np.random.Generator, batch: QuadBatch, front: Front, look: Look) -> None:
    """Add one wall with all its openings to a batch, in a frame of its own.

    In this frame x runs along the wall, y into it, and z up from the ground in front.
    """
    batch.use_frame(front.start[0], front.start[1], front.ground, front.yaw)
    if front.facade is Facade.BLIND:
        top = front.plinth + front.storeys * front.storey_height
        _wall(batch, look.wall, np.array([[0.0, front.length]]), -front.foundation, top)
        return
    bottom = -front.foundation
    for storey in range(front.storeys):
        floor = front.plinth + storey * front.storey_height
        is_shop = storey == 0 and front.has_shop
        if front.is_glazed:
            openings = _glass_front(front, look, floor)
        else:
            openings = _shop_windows(front) if is_shop else _windows(front, look, floor)
        door = None
        is_plain = not is_shop and not front.is_glazed
        if storey == 0 and front.facade is Facade.STREET and is_plain:
            openings, door = _with_door(rng, openings)
        ceiling = floor + front.storey_height
        _pierced_storey(batch, front, look, openings, bottom, ceiling)
        if door is not None:
            _door(batch, front, look, door, ceiling)
        _panes(rng, batch, front, look, openings, is_shop=is_shop)
        if is_plain and not front.is_far and look.has_folding_shutters:
            _folding_shutters(batch, look, openings)
        if is_shop and not front.is_glazed:
            _shop_sign(rng, batch, front, openings.high)
        bottom = ceiling


def _windows(front: Front, look: Look, floor: float) -> _Openings:
    """Compute evenly spread windows of one storey."""
    pitch = look.window_pitch * (1.0 if front.facade is Facade.STREET else 1.5)
    count = max(1, int((front.length - 0.8) // pitch))
    middles = (np.arange(count) + 0.5) * front.length / count
    low = floor + 0.9
    high = min(low + look.window_height, floor + front.storey_height - 0.3)
    half = min(look.window_width, 0.8 * front.length / count) / 2
    return _Openings(middles - half, middles + half, low, high)


def _shop_windows(front: Front) -> _Openings:
    """Compute wide panes from knee height up; one of them is the entrance."""
    count = max(1, int(front.length // 3.6))
    middles = (np.arange(count) + 0.5) * front.length / count
    half = front.length / count / 2 - 0.25
    high = front.plinth + min(_SHOP_HEIGHT, front.storey_height - 0.7)
    return _Openings(middles - half, middles + half, front.plinth + 0.25, high)


def _glass_front(front: Front, look: Look, floor: float) -> _Openings:
    """Compute panes from floor to ceiling with thin frames between."""
    count = max(1, round(front.length / look.window_pitch))
    edges = np.linspace(0.0, front.length, count + 1)
    starts, stops = edges[:-1] + _MULLION, edges[1:] - _MULLION
    return _Openings(starts, stops, floor + 0.08, floor + front.storey_height - 0.12)


def _with_door(
    rng: np.random.Generator, openings: _Openings
) -> tuple[_Openings, tuple[float, float]]:
    """Replace one window by a door; return the others and the door's edges."""
    row = int(rng.integers(len(openings.starts)))
    middle = (openings.starts[row] + openings.stops[row]) / 2
    others = _Openings(
        np.delete(openings.starts, row), np.delete(openings.stops, row), openings.low, openings.high
    )
    return others, (float(middle - _DOOR_WIDTH / 2), float(middle + _DOOR_WIDTH / 2))


def _wall(
    batch: QuadBatch,
    finish: Finish,
    spans: Float[np.ndarray, "num_pieces 2"],
    low: float | Float[np.ndarray, " num_pieces"],
    high: float | Float[np.ndarray, " num_pieces"],
) -> None:
    """Add pieces of wall between two heights, flush with its surface."""
    corners = np.zeros((len(spans), 4, 3))
    corners[:, :, 0] = spans[:, _ALONG]
    corners[:, :2, 2], corners[:, 2:, 2] = np.reshape(low, (-1, 1)), np.reshape(high, (-1, 1))
    batch.add(corners, finish, uvs=corners[..., ::2])


def _pierced_storey(
    batch: QuadBatch, front: Front, look: Look, openings: _Openings, bottom: float, ceiling: float
) -> None:
    """Add the wall of a storey around its openings, and the plinth in front of its foot."""
    whole = np.array([[0.0, front.length]])
    _wall(batch, look.wall, whole, bottom, openings.low)
    _wall(batch, look.wall, whole, openings.high, ceiling)
    edges = np.concatenate(
        ([0.0], np.stack((openings.starts, openings.stops), axis=1).ravel(), [front.length])
    )
    _wall(batch, look.wall, edges.reshape(-1, 2), openings.low, openings.high)
    if bottom < 0 and look.base != look.wall:
        top = min(front.plinth, openings.low) - 0.02
        corners = np.array(
            [[0, -0.03, bottom], [front.length, -0.03, bottom], [front.length, -0.03, top],
             [0, -0.03, top]]
        )  # fmt: skip
        ledge = np.array(
            [[0, -0.03, top], [front.length, -0.03, top], [front.length, 0, top], [0, 0, top]]
        )
        batch.add(np.stack((corners, ledge)), look.base)


def _door(
    batch: QuadBatch, front: Front, look: Look, door: tuple[float, float], ceiling: float
) -> None:
    """Add a door in front of the wall with a frame, a pane above and a step."""
    start, stop = door
    floor = front.plinth
    top = min(floor + 2.25, ceiling - 0.2)
    glass = Finish(Material.WINDOW, (0.05, 0.055, 0.06))
    sheets = (
        (start - 0.12, stop + 0.12, floor - 0.02, top + 0.10, -0.035, look.trim),
        (start, stop, floor, top - 0.35, -0.05, look.door),
        (start, stop, top - 0.30, top, -0.05, glass),
        (start + 0.35, stop - 0.35, floor + 1.1, top - 0.55, -0.06, glass),
    )
    for left, right, low, high, out, finish in sheets:
        corners = np.array(
            [[left, out, low], [right, out, low], [right, out, high], [left, out, high]]
        )
        batch.add(corners[None], finish)
    stone = Finish(Material.CONCRETE, (0.42, 0.41, 0.39))
    steps = max(1, round(floor / 0.18))
    for step in range(steps):
        high, out = floor * (steps - step) / steps, 0.5 + 0.28 * step
        _slab(batch, (start - 0.3, stop + 0.3), (-out, 0.0), (-0.3, high), stone)


def _slab(
    batch: QuadBatch,
    along: tuple[float, float],
    into: tuple[float, float],
    up: tuple[float, float],
    finish: Finish,
) -> None:
    """Add a block in front of the wall: front, top and both ends."""
    (a, b), (c, d), (e, f) = along, into, up
    corners = np.array(
        [
            [[a, c, e], [b, c, e], [b, c, f], [a, c, f]],
            [[a, c, f], [b, c, f], [b, d, f], [a, d, f]],
            [[a, d, e], [a, c, e], [a, c, f], [a, d, f]],
            [[b, c, e], [b, d, e], [b, d, f], [b, c, f]],
        ],
        dtype=np.float64,
    )
    batch.add(corners, finish)


def _panes(
    rng: np.random.Generator,
    batch: QuadBatch,
    front: Front,
    look: Look,
    openings: _Openings,
    *,
    is_shop: bool,
) -> None:
    """Add reveals, frames, sills and glass of all openings of a storey; some blinds are down."""
    count = len(openings.starts)
    if count == 0:
        return
    low, high = np.full(count, openings.low), np.full(count, openings.high)
    starts, stops = openings.starts, openings.stops
    # Without reveals, recessed panes would leave a gap with a view into an empty house.
    deep = 0.0 if front.is_far else look.recess
    if not front.is_far:
        reveals = np.concatenate(
            (
                _rectangles((starts, starts), (low, high), (0.0, deep), upright=True),
                _rectangles((stops, stops), (low, high), (deep, 0.0), upright=True),
                _rectangles((starts, stops), (low, low), (0.0, deep), upright=False),
                _rectangles((starts, stops), (high, high), (deep, 0.0), upright=False),
            )
        )
        batch.add(reveals, look.wall)
    if front.is_glazed:  # nothing behind a pane stops a beam
        tint = _COATED_TONES[count % len(_COATED_TONES)]
        batch.add(_sheets(starts, stops, low, high, deep), Finish(Material.COATED_GLASS, tint))
        return
    batch.add(_sheets(starts, stops, low, high, deep), look.trim)
    tones = rng.choice(3, count, p=(0.45, 0.35, 0.2)) if not is_shop else np.ones(count, int)
    colors = np.array(_GLASS_TONES)[tones]
    halves = 1 if is_shop or front.is_far else 2
    width = (stops - starts - _FRAME * (halves + 1)) / halves
    for half in range(halves):
        left = starts + _FRAME + half * (width + _FRAME)
        glass = _sheets(left, left + width, low + _FRAME, high - _FRAME, deep - 0.015)
        batch.add(glass, Finish(Material.WINDOW, _GLASS_TONES[0]), colors=colors)
    if is_shop:
        return
    drawn = np.where(rng.random(count) < look.shutter_share, rng.uniform(0.3, 1.0, count), 0.0)
    down = drawn > 0
    blinds = _sheets(
        starts[down] + 0.02,
        stops[down] - 0.02,
        (high - drawn * (high - low))[down],
        high[down],
        deep - 0.04,
    )
    batch.add(blinds, Finish(Material.PLASTIC, (0.55, 0.54, 0.51)))
    if not front.is_far:
        sills = _rectangles((starts - 0.06, stops + 0.06), (low, low), (-0.07, deep), upright=False)
        edges = _sheets(starts - 0.06, stops + 0.06, low - 0.05, low, -0.07)
        batch.add(np.concatenate((sills, edges)), look.trim)


def _sheets(
    starts: Values, stops: Values, low: Values, high: Values, deep: float
) -> Float64[np.ndarray, "count 4 3"]:
    """Compute rectangles parallel to the wall, at a depth behind its surface."""
    corners = np.empty((len(starts), 4, 3))
    corners[:, :, 0] = np.stack((starts, stops), axis=1)[:, _ALONG]
    corners[:, :, 1] = deep
    corners[:, :2, 2], corners[:, 2:, 2] = low[:, None], high[:, None]
    return corners


def _rectangles(
    along: tuple[Values, Values],
    up: tuple[Values, Values],
    into: tuple[float, float],
    *,
    upright: bool,
) -> Float64[np.ndarray, "count 4 3"]:
    """Compute rectangles perpendicular to the wall: sides of openings, or sills and lintels."""
    corners = np.empty((len(along[0]), 4, 3))
    corners[:, :, 0] = np.stack(along, axis=1)[:, _ALONG]
    corners[:, :, 1] = np.array(into)[_ALONG if upright else _UP]
    corners[:, :, 2] = np.stack(up, axis=1)[:, _UP]
    return corners


def _folding_shutters(batch: QuadBatch, look: Look, openings: _Openings) -> None:
    """Add wooden shutters folded back on both sides of each window."""
    count = len(openings.starts)
    low, high = np.full(count, openings.low), np.full(count, openings.high)
    wide = 0.32
    wood = Finish(Material.WOOD, look.door.color)
    for start in (openings.starts - wide - 0.03, openings.stops + 0.03):
        batch.add(_sheets(start, start + wide, low, high, -0.03), wood)


def _shop_sign(rng: np.random.Generator, batch: QuadBatch, front: Front, high: float) -> None:
    """Add a coloured board over the shop windows, sometimes an awning."""
    tone = rng.uniform(0.03, 0.6, 3)
    red, green, blue = tone.tolist()
    finish = Finish(Material.PLASTIC, (red, green, blue))
    ends = (0.4, front.length - 0.4)
    _slab(batch, ends, (-0.10, 0.0), (high + 0.08, high + 0.5), finish)
    if rng.random() < 0.35:
        out, drop = 1.3, 0.45
        awning = np.array(
            [[ends[0], -out, high - drop], [ends[1], -out, high - drop], [ends[1], 0, high + 0.05],
             [ends[0], 0, high + 0.05]]
        )  # fmt: skip
        batch.add(awning[None], Finish(Material.CLOTH, (red, green, blue)))
