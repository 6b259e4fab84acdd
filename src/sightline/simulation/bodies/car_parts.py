"""Parts mounted on the body of a car or a van: wheels, plates, mirrors, lamps, seats."""

from collections.abc import Sequence

import numpy as np

from sightline.simulation.bodies.body import BLACK_PLASTIC, GAP, HEADLIGHT, Body
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import both_sides, painted, turned
from sightline.simulation.shapes.primitives import (
    Finish,
    box,
    boxes,
    disc,
    lathe,
    moved,
    superellipsoid,
    tube,
)

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
_RIM_PROFILE = (0.45, 0.92, 1.0, 1.0, 0.93, 0.70, 0.65, 0.62, 0.50, 0.20, 0.16, 0.02)  # of radius
_MIRROR_REACH = (0.08, 0.24)  # [m] beyond the body
_SPOKES = ((1, 1, 0, 0), (1, 0), (1, 1, 1, 0), (1,))  # repeated around the rim


def wheel(
    rng: np.random.Generator, radius: float, width: float, *, rim: Finish = ALLOY, spokes: int = -1
) -> Mesh:
    """Build a wheel about the y axis at the origin, with its outside towards +y.

    `radius` and `width` [m] are those of the tyre, `rim` is the metal of the spokes; `spokes` is
    the index of their pattern, and -1 draws one.
    """
    half = width / 2
    across = np.array((-1.0, -1.0, -0.7, 0.7, *np.ones(8))) * half
    across[6:10] -= (0.005, 0.030, 0.024, 0.012)
    profile = np.stack((np.array(_RIM_PROFILE) * radius, across), axis=1)
    pattern = _SPOKES[int(rng.integers(len(_SPOKES))) if spokes < 0 else spokes]
    cells = np.zeros((len(profile) - 1, _WHEEL_SIDES), dtype=np.int64)
    cells[5:7] = 1
    spoked = np.where(np.resize(pattern, _WHEEL_SIDES) > 0, 1, 2)
    if min(pattern):  # a wheel cover only has slots near its edge
        cells[7], cells[8:] = np.where(np.arange(_WHEEL_SIDES) % 2, 1, 2), 1
    else:
        cells[7:9], cells[9:] = spoked, 1
    turned = lathe(profile, TYRE, num_sides=_WHEEL_SIDES)
    return painted(turned, cells, (TYRE, rim, _WHEEL_GAP))


def wheels(one: Mesh, axles: Sequence[float], track_half_width: float, radius: float) -> Mesh:
    """Place the wheel at both ends of each axle at x [m]; the track is measured between middles."""
    return both_sides(*(moved(one, (axle, track_half_width, radius)) for axle in axles))


def plate(rng: np.random.Generator, x: float, z: float, facing: int) -> list[Mesh]:
    """Build a number plate with letters in the middle of the front (`facing` 1) or rear (-1)."""
    outside = x + 0.012 * facing
    starts = np.array([-0.19, -0.14, -0.06, -0.01, 0.07, 0.12, 0.17, 0.215])
    letter_starts = starts[np.arange(8) < rng.integers(6, 9)]
    half_widths = rng.uniform(0.013, 0.019, len(letter_starts))
    centers = [(outside, (start + 0.016) * facing, z) for start in letter_starts]
    halves = [(0.002, half_width, 0.036) for half_width in half_widths]
    return [
        box((x, 0, z), (0.012, 0.26, 0.056), _PLATE),
        box((outside, -0.23 * facing, z), (0.002, 0.02, 0.05), _PLATE_BLUE),
        boxes(np.array(centers), np.array(halves), _PLATE_LETTERS),
    ]


def mirrors(rng: np.random.Generator, body: Body) -> Mesh:
    """Build the door mirrors, which extend beyond the body."""
    shell = body.paint if rng.random() < 0.75 else BLACK_PLASTIC
    x = float(body.screen_x(0.10)) - 0.10
    z = float(body.shoulder_height(np.array([x]))[0]) + 0.075
    inner = float(body.cabin_half_width(0.2)) * 0.96
    outer = body.width / 2 + float(rng.uniform(*_MIRROR_REACH))
    y, half = (inner + outer) / 2, (outer - inner) / 2
    housing = superellipsoid(
        (x, y, z), (0.055, half, 0.065), shell, exponents=(0.6, 0.6), num_rings=7, num_sides=10
    )
    glass = box((x - 0.050, y, z), (0.008, 0.7 * half, 0.040), CHROME)
    return both_sides(housing, glass)


def handles(body: Body, finish: Finish) -> list[Mesh]:
    """Build a handle ahead of the rear gap of each door."""
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
    """Build reflectors in the headlights, fog lamps, emblem and bars of the grille."""
    form, half_width = body.form, body.width / 2
    middle = (form.lamp_levels[0] + form.lamp_levels[1]) / 2
    across = (0.70, 0.80) if rng.random() < 0.6 else (0.74,)
    places = [(_end_point(body, 1, each, middle, 0.028), LAMP_GLASS) for each in across]
    if rng.random() < 0.6:
        places.append((_end_point(body, 1, 0.66, 0.22, 0.024), HEADLIGHT))
    lamps = [
        superellipsoid(place, (0.034, 0.05, 0.042), finish, num_rings=5, num_sides=8)
        for place, finish in places
    ]
    parts = [both_sides(*lamps)]
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
    """Compute a point `depth` [m] below the skin of the front (`facing` 1) or the rear (-1)."""
    roundness = body.form.front_roundness if facing > 0 else body.form.rear_roundness
    place = (1 - across**roundness) ** (1 / roundness)
    middle = body.front_x(level) if facing > 0 else body.rear_x(level)
    x = middle - facing * ((1 - place) * body.length / 2 + depth)
    return x, across * body.width / 2, body.level_height(x, level)


def rear_trim(rng: np.random.Generator, body: Body) -> list[Mesh]:
    """Build exhaust and reflectors."""
    place = _end_point(body, -1, 0.60, 0.40, 0.004)
    reflector = box(place, (0.012, 0.06, 0.016), _REAR_REFLECTOR)
    exhaust_y = float(rng.choice([-1, 1])) * 0.55 * body.width / 2
    low = body.clearance + 0.02
    path = [(-body.length / 2 + 0.30, exhaust_y, low), (-body.length / 2 + 0.07, exhaust_y, low)]
    return [both_sides(reflector), tube(path, 0.03, CHROME)]


def seats(body: Body, rows: Sequence[float]) -> Mesh:
    """Build backs and head rests at x [m] of each row; they reflect beams behind the glass."""
    sill = float(body.shoulder_height(np.zeros(1))[0])
    low, top, y, left = body.clearance + 0.12, sill + 0.12, 0.22 * body.width, []
    for x in rows:
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
        left += [back, rest]
    dashboard = float(body.screen_x(0.0)) - 0.12
    board = box((dashboard, 0, sill - 0.10), (0.15, 0.42 * body.width, 0.12), _SEAT)
    return Mesh.joined((both_sides(*left), board))


def roof_rails(body: Body, finish: Finish) -> Mesh:
    """Build a rail along each edge of the roof."""
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
    return both_sides(tube(path, 0.016, finish, num_sides=6))


def rear_door_gap(body: Body) -> Mesh:
    """Build the line between two rear doors."""
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


def spoiler(rng: np.random.Generator, body: Body) -> Mesh:
    """Build a blade that extends the roof's end."""
    form = body.form
    x = form.rear_top * body.length / 2 - form.rear_bow_m
    z = body.height - form.roof_fall_rear_m - 0.4 * form.roof_crown_m
    reach = float(rng.uniform(0.06, 0.14))
    half_width = 0.75 * float(body.cabin_half_width(1.0))
    return box((x - reach + 0.06, 0, z), (reach, half_width, 0.016), body.paint)


def spare_wheel(one: Mesh, body: Body) -> Mesh:
    """Build a wheel on the rear door, with its outside to the rear."""
    to_rear = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    place = (body.rear_x(0.9) - 0.07, -0.08, body.level_height(-body.length / 2, 0.8))
    return moved(turned(one, to_rear), place)


def extras(rng: np.random.Generator, body: Body, roof_load: float) -> list[Mesh]:
    """Build parts excluded from labels: aerial, tow bar and, with a probability, a roof load."""
    form, half, parts = body.form, body.length / 2, []
    front, rear = form.screen_top * half - 0.15, form.rear_top * half + 0.15
    roof = body.height - form.roof_fall_rear_m
    if rng.random() < 0.5:
        tip = (rear - float(rng.uniform(0.05, 0.3)), 0.0, roof + float(rng.uniform(0.08, 0.25)))
        parts.append(tube([(rear, 0.0, roof - 0.03), tip], 0.005, BLACK_PLASTIC, num_sides=4))
    if rng.random() < 0.15:
        bar = [(-half + 0.15, 0.0, 0.34), (-half - 0.06, 0.0, 0.34), (-half - 0.10, 0.0, 0.42)]
        parts.append(tube(bar, (0.025, 0.025, 0.03), CHROME, num_sides=6))
    if rng.random() > roof_load:
        return parts
    middle, reach = (front + rear) / 2, (front - rear) / 2
    bars = [(middle + side * 0.6 * reach, 0.0, body.height + 0.03) for side in (-1, 1)]
    half_width = 0.9 * float(body.cabin_half_width(1.0))
    parts.append(boxes(np.array(bars), np.tile((0.02, half_width, 0.05), (2, 1)), BLACK_PLASTIC))
    if body.height < 1.78:
        place, radii = (middle, 0.35 * half_width, body.height + 0.23), (0.95, 0.36, 0.19)
        case = BLACK_PLASTIC if rng.random() < 0.6 else Finish(Material.PLASTIC, (0.4, 0.4, 0.4))
        return [*parts, superellipsoid(place, radii, case, exponents=(0.35, 0.35), num_rings=11)]
    rungs = np.arange(rear, front, 0.28)
    centers = [(x, 0.4 * half_width, body.height + 0.10) for x in rungs]
    parts.append(boxes(np.array(centers), np.tile((0.015, 0.19, 0.015), (len(rungs), 1)), ALLOY))
    beams = [(middle, 0.4 * half_width + side * 0.2, body.height + 0.10) for side in (-1, 1)]
    return [*parts, boxes(np.array(beams), np.tile((reach, 0.015, 0.035), (2, 1)), ALLOY)]
