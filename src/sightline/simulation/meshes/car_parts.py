"""What is mounted on the body of a car or a van: wheels, plates, mirrors, lamps, seats."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from sightline.simulation.materials import Material
from sightline.simulation.meshes.body import BLACK_PLASTIC, GAP, HEADLIGHT, Body
from sightline.simulation.meshes.edits import mirrored, painted
from sightline.simulation.meshes.primitives import (
    Finish,
    box,
    boxes,
    disc,
    lathe,
    moved,
    quads,
    superellipsoid,
    tube,
)
from sightline.simulation.scene import Mesh

TYRE = Finish(Material.RUBBER, (0.018, 0.018, 0.019))
ALLOY = Finish(Material.METAL, (0.27, 0.275, 0.285))
CHROME = Finish(Material.METAL, (0.55, 0.56, 0.58))
LAMP_GLASS = Finish(Material.HEADLIGHT, (0.85, 0.87, 0.90))
ORANGE_LAMP = Finish(Material.TAIL_LIGHT, (0.60, 0.20, 0.01))
_WHEEL_GAP = Finish(Material.METAL, (0.015, 0.015, 0.016))
_PLATE = Finish(Material.RETRO_REFLECTOR, (0.80, 0.80, 0.78))
_PLATE_BLUE = Finish(Material.RETRO_REFLECTOR, (0.02, 0.06, 0.40))
_PLATE_LETTERS = Finish(Material.PLASTIC, (0.02, 0.02, 0.02))
_REAR_REFLECTOR = Finish(Material.RETRO_REFLECTOR, (0.45, 0.01, 0.01))
_SEAT = Finish(Material.CLOTH, (0.030, 0.030, 0.033))
_WHEEL_SIDES = 20
_SPOKES = ((1, 1, 0, 0), (1, 0), (1, 1, 1, 0), (1,))  # repeated around the rim


def wheel(
    rng: np.random.Generator, radius: float, width: float, *, rim: Finish = ALLOY, spokes: int = -1
) -> Mesh:
    """A wheel about the y axis at the origin, its outside towards +y.

    Args:
        rng: Chooses the spokes.
        radius: Of the tyre [m].
        width: Of the tyre [m].
        rim: Metal of the spokes.
        spokes: Index of the pattern of spokes; -1 draws one.
    """
    half = width / 2
    profile = np.array(
        [
            (0.45 * radius, -half),
            (0.92 * radius, -half),
            (radius, -0.7 * half),
            (radius, 0.7 * half),
            (0.93 * radius, half),
            (0.70 * radius, half),
            (0.65 * radius, half - 0.005),
            (0.62 * radius, half - 0.030),
            (0.50 * radius, half - 0.024),
            (0.20 * radius, half - 0.012),
            (0.16 * radius, half),
            (0.02 * radius, half),
        ]
    )
    pattern = _SPOKES[int(rng.integers(len(_SPOKES))) if spokes < 0 else spokes]
    cells = np.zeros((len(profile) - 1, _WHEEL_SIDES), dtype=np.int64)
    cells[5:7] = 1
    spoked = np.where(np.resize(pattern, _WHEEL_SIDES) > 0, 1, 2)
    if min(pattern):  # a wheel cover has only slots near its edge
        cells[7], cells[8:] = np.where(np.arange(_WHEEL_SIDES) % 2, 1, 2), 1
    else:
        cells[7:9], cells[9:] = spoked, 1
    turned = lathe(profile, TYRE, num_sides=_WHEEL_SIDES)
    return painted(turned, cells, (TYRE, rim, _WHEEL_GAP))


def wheels(one: Mesh, axles: Sequence[float], track_half_width: float, radius: float) -> list[Mesh]:
    """The wheel at both ends of each axle at x [m]; the track is measured between middles."""
    placed = []
    for axle in axles:
        left = moved(one, (axle, track_half_width, radius))
        placed += [left, mirrored(left)]
    return placed


def plate(rng: np.random.Generator, x: float, z: float, facing: int) -> list[Mesh]:
    """A number plate in the middle of the front (`facing` 1) or rear (-1) with its letters."""
    outside = x + 0.012 * facing
    parts = [box((x, 0, z), (0.012, 0.26, 0.056), _PLATE)]
    starts = np.array([-0.19, -0.14, -0.06, -0.01, 0.07, 0.12, 0.17, 0.215])
    shown = starts[np.arange(8) < rng.integers(6, 9)]
    widths = rng.uniform(0.026, 0.038, len(shown))
    parts.append(_plate_marks(shown, widths, 0.036, outside + 0.002 * facing, z, facing))
    blue = _plate_marks(np.array([-0.25]), np.array([0.04]), 0.05, outside, z, facing)
    blue = painted(blue, np.zeros((1, 1), dtype=np.int64), (_PLATE_BLUE,))
    return [*parts, moved(blue, (0.002 * facing, 0, 0))]


def _plate_marks(
    starts: Float64[np.ndarray, " marks"],
    widths: Float64[np.ndarray, " marks"],
    half_height: float,
    x: float,
    z: float,
    facing: int,
) -> Mesh:
    """Upright rectangles on a plate; `starts` run from the reader's left."""
    left, right = starts * facing, (starts + widths) * facing
    y = np.stack((left, right, right, left), axis=1)
    low, high = np.full_like(left, z - half_height), np.full_like(left, z + half_height)
    heights = np.stack((low, low, high, high), axis=1)
    return quads(np.stack((np.full_like(y, x), y, heights), axis=-1), _PLATE_LETTERS)


def mirrors(body: Body, shell: Finish) -> list[Mesh]:
    """The door mirrors; they stay within the width of the body, which the labels leave out."""
    x = float(body.screen_x(0.10)) - 0.10
    z = float(body.shoulder_height(np.array([x]))[0]) + 0.075
    inner, outer = float(body.cabin_half_width(0.2)) * 0.96, body.width / 2
    y, half = (inner + outer) / 2 + 0.005, (outer - inner) / 2
    housing = superellipsoid(
        (x, y, z), (0.055, half, 0.065), shell, exponents=(0.6, 0.6), num_rings=7, num_sides=10
    )
    glass = box((x - 0.050, y, z), (0.008, 0.7 * half, 0.040), CHROME)
    return [housing, mirrored(housing), glass, mirrored(glass)]


def handles(body: Body, finish: Finish) -> list[Mesh]:
    """A handle ahead of the rear gap of each door."""
    level = 0.84
    places = [gap * body.length / 2 + 0.13 for gap in body.form.door_gaps[1:]]
    centers = [
        (x, side * (body.side_y(x, level) + 0.004), body.level_height(x, level))
        for x in places
        for side in (1, -1)
    ]
    if not centers:
        return []
    halves = np.tile((0.085, 0.014, 0.013), (len(centers), 1))
    return [boxes(np.array(centers), halves, finish)]


def front_trim(rng: np.random.Generator, body: Body) -> list[Mesh]:
    """Reflectors in the headlights, fog lamps, emblem and bars of the grille."""
    form, half_width = body.form, body.width / 2
    middle = (form.lamp_levels[0] + form.lamp_levels[1]) / 2
    parts = []
    for across in (0.70, 0.80) if rng.random() < 0.6 else (0.74,):
        bulb = superellipsoid(
            _end_point(body, 1, across, middle, 0.028),
            (0.035, 0.050, 0.045),
            LAMP_GLASS,
            num_rings=5,
            num_sides=8,
        )
        parts += [bulb, mirrored(bulb)]
    if rng.random() < 0.6:
        place = _end_point(body, 1, 0.66, 0.22, 0.024)
        fog = superellipsoid(place, (0.03, 0.05, 0.035), HEADLIGHT, num_rings=5, num_sides=8)
        parts += [fog, mirrored(fog)]
    bars = np.linspace(*form.grille_levels, int(rng.integers(3, 5)))[1:-1]
    wide = form.grille_half_width * half_width * 0.97
    bar_finish = CHROME if rng.random() < 0.6 else BLACK_PLASTIC
    for level in bars:
        x, z = body.front_x(level) + 0.002, body.level_height(body.length / 2, level)
        parts.append(box((x, 0, z), (0.012, wide, 0.009), bar_finish))
    emblem = float(form.grille_levels[1]) - 0.03
    x, z = body.front_x(emblem) + 0.018, body.level_height(body.length / 2, emblem)
    parts.append(disc((x, 0, z), (1, 0, 0.25), 0.05, CHROME, num_sides=12))
    return parts


def _end_point(
    body: Body, facing: int, across: float, level: float, depth: float
) -> tuple[float, float, float]:
    """A point `depth` [m] below the skin of the front (`facing` 1) or the rear (-1)."""
    roundness = body.form.front_roundness if facing > 0 else body.form.rear_roundness
    place = (1 - across**roundness) ** (1 / roundness)
    middle = body.front_x(level) if facing > 0 else body.rear_x(level)
    x = middle - facing * ((1 - place) * body.length / 2 + depth)
    return x, across * body.width / 2, body.level_height(x, level)


def rear_trim(rng: np.random.Generator, body: Body) -> list[Mesh]:
    """Exhaust and reflectors."""
    parts = []
    place = _end_point(body, -1, 0.60, 0.40, 0.004)
    reflector = box(place, (0.012, 0.06, 0.016), _REAR_REFLECTOR)
    parts += [reflector, mirrored(reflector)]
    exhaust_y = float(rng.choice([-1, 1])) * 0.55 * body.width / 2
    low = body.clearance + 0.02
    path = [(-body.length / 2 + 0.30, exhaust_y, low), (-body.length / 2 + 0.07, exhaust_y, low)]
    parts.append(tube(path, 0.03, CHROME))
    return parts


def seats(body: Body, rows: Sequence[float]) -> list[Mesh]:
    """Backs and head rests at x [m] of each row; they are what a beam meets behind the glass."""
    sill = float(body.shoulder_height(np.zeros(1))[0])
    low, parts = body.clearance + 0.12, []
    for x in rows:
        y = 0.22 * body.width
        top = sill + 0.12
        back = superellipsoid(
            (x, y, (low + top) / 2),
            (0.09, 0.23, (top - low) / 2),
            _SEAT,
            exponents=(0.4, 0.4),
            num_rings=5,
            num_sides=8,
        )
        rest = superellipsoid(
            (x - 0.03, y, top + 0.08), (0.05, 0.13, 0.09), _SEAT, num_rings=5, num_sides=6
        )
        parts += [back, rest, mirrored(back), mirrored(rest)]
    dashboard = float(body.screen_x(0.0)) - 0.12
    parts.append(box((dashboard, 0, sill - 0.10), (0.15, 0.42 * body.width, 0.12), _SEAT))
    return parts


def roof_rails(body: Body, finish: Finish) -> list[Mesh]:
    """A rail along each edge of the roof."""
    form, half = body.form, body.length / 2
    ahead, behind = form.screen_top * half - 0.12, form.rear_top * half + 0.08
    y = 0.90 * float(body.cabin_half_width(1.0))
    base = body.height - form.roof_crown_m
    top = base + 0.045
    path = [
        (behind, y, base - form.roof_fall_rear_m),
        (behind + 0.12, y, top - 0.6 * form.roof_fall_rear_m),
        ((ahead + behind) / 2, y, top),
        (ahead - 0.12, y, top - 0.6 * form.roof_fall_front_m),
        (ahead, y, base - form.roof_fall_front_m),
    ]
    rail = tube(path, 0.016, finish, num_sides=6)
    return [rail, mirrored(rail)]


def rear_door_gap(body: Body) -> Mesh:
    """The line between two rear doors."""
    form, half = body.form, body.length / 2
    low, sill = body.level_height(-half, 0.48), body.level_height(-half, 0.95)
    roof = body.height - form.roof_crown_m - form.roof_fall_rear_m
    path = [
        (body.rear_x(0.48), 0.0, low),
        (body.rear_x(0.95), 0.0, sill),
        (form.rear_base * half - form.rear_bow_m, 0.0, sill + 0.08),
        (form.rear_top * half - form.rear_bow_m, 0.0, roof - 0.04),
    ]
    return tube(path, 0.008, GAP, num_sides=4)
