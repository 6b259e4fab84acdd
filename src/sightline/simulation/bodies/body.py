"""Body shape of cars and vans, and the skin below the windows, with wheel arches.

The skin is a grid of rings around the vehicle. The grid has lines at the edges of lamps and gaps,
so that they are sharp. Vehicle frame: origin on the ground below the middle, x ahead, y left, z up;
metres. "Place" means x as a share of half the length: 1 at the front bumper, -1 at the rear one.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int

from sightline.simulation.arrays import Columns, Shaped
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import painted
from sightline.simulation.shapes.primitives import Finish, grid, kept, without_slivers

BLACK_PLASTIC = Finish(Material.PLASTIC, (0.022, 0.022, 0.024))
GAP = Finish(Material.PLASTIC, (0.006, 0.006, 0.006))
TINTED_GLASS = Finish(Material.GLASS, (0.016, 0.019, 0.021))
HEADLIGHT = Finish(Material.HEADLIGHT, (0.17, 0.18, 0.20))
TAIL_LIGHT = Finish(Material.TAIL_LIGHT, (0.42, 0.012, 0.012))
REVERSING_LIGHT = Finish(Material.TAIL_LIGHT, (0.50, 0.46, 0.44))

# Levels of the lower body as shares of the height from lower edge to shoulder, and insets of
# the skin: at the sides as a share of half the width, at the ends in metres.
LEVELS = np.array([0.0, 0.13, 0.32, 0.46, 0.475, 0.58, 0.69, 0.78, 0.82, 0.95, 1.0])
_SIDE_INSETS = np.array([0.06, 0.022, 0.004, 0.0, 0.0, 0.002, 0.006, 0.011, 0.024, 0.040, 0.072])
_ARCH_ANGLES = 9
_GAP_HALF_WIDTH = 0.005  # half width of gaps [m]
_ROUND_ROWS = np.array([0.965, 0.885, 0.87, 0.55, 0.25, 0.0])  # from the shoulder to the middle
CROWN = 0.05  # additional height [m] of bonnet and boot in the middle
_UNDER_SHARE = 0.68  # share of half the width, between the wheels


@dataclass(frozen=True, kw_only=True, slots=True)
class BodyForm:
    """Proportions of a body. Heights are shares of the vehicle's height unless in metres."""

    front_wheel: float  # place of the front axle; `rear_wheel` is that of the rear one
    rear_wheel: float
    wheel_radius: float
    clearance: float  # height of the lower edge
    shoulder: tuple[tuple[float, float], ...]
    """(place, height) of the line between the sides and bonnet, window sill and boot."""
    front_insets_m: tuple[float, ...] = (
        0.11, 0.05, 0.01, 0.0, 0.0, 0.025, 0.045, 0.065, 0.08, 0.14, 0.23
    )  # fmt: skip
    """Inset of the front at each level of the lower body."""
    rear_insets_m: tuple[float, ...] = (
        0.14, 0.06, 0.01, 0.0, 0.03, 0.04, 0.045, 0.05, 0.055, 0.065, 0.09
    )  # fmt: skip
    front_roundness: float = 5.0
    """Exponent of the outline's superellipse; a higher value is squarer."""
    rear_roundness: float = 7.0
    screen_base: float
    """Place of the windscreen's lower corners; its middle is `screen_bow_m` ahead."""
    screen_top: float
    rear_base: float  # place of the lower corners of the cabin's rear
    rear_top: float
    rear_base_spread: float = 0.01  # variation of `rear_base` between makes
    screen_bow_m: float = 0.16
    rear_bow_m: float = 0.07
    base_width: float = 0.925  # width of the cabin's base, as a share of the vehicle's width
    roof_width: float = 0.74
    roof_crown_m: float = 0.05
    roof_fall_front_m: float = 0.05
    roof_fall_rear_m: float = 0.06
    pillars: tuple[float, float]
    """Places of the upright pillars behind the front and the rear side window."""
    glazed: tuple[bool, bool, bool] = (True, True, False)
    """Whether the front, rear and last side windows are glass."""
    rear_glazed: bool = True
    window_top: float = 0.85  # upper end of the windows, between the cabin's base 0 and its roof 1
    last_window_end: float = 0.55
    """End of the last side window, between its pillar and the cabin's rear corner."""
    door_gaps: tuple[float, ...]  # places of the gaps between doors and wings
    lamp_end: float = 0.80  # place of the headlights' end at the side
    lamp_inner: float = 0.55  # start of the headlights, as a share of half the width
    lamp_levels: tuple[float, float] = (0.58, 0.82)
    grille_half_width: float = 0.40
    grille_levels: tuple[float, float] = (0.58, 0.78)
    tail_start: float = -0.90
    tail_inner: float = 0.66
    tail_levels: tuple[float, float] = (0.58, 0.82)
    pillar_lamps: bool = False  # whether there are tail lights beside the rear window
    cladding: bool = False  # whether the lower edge is unpainted plastic
    covered_bed: bool = False
    """Whether the part behind the cabin is a loading bed under a dark cover."""
    split_rear: bool = False  # whether the rear has two doors side by side


@dataclass(frozen=True, kw_only=True, slots=True)
class Body:
    """Vehicle body with a form and a size."""

    form: BodyForm
    length: float
    width: float
    height: float
    paint: Finish
    roof: Finish  # finish of the cabin: paint, or the cloth of a soft top

    def shoulder_height(self, x: Shaped) -> Shaped:
        """Compute the shoulder's height [m] at x [m]; corners of the form's line are rounded."""
        places, heights = np.array(self.form.shoulder).T
        place = x / (self.length / 2)
        nearby = [np.interp(place + step, places, heights) for step in (-0.07, -0.03, 0.03, 0.07)]
        return np.asarray(sum(nearby) / len(nearby) * self.height)

    @property
    def wheel_radius(self) -> float:
        """Radius of the tyre [m]."""
        return self.form.wheel_radius * self.height

    @property
    def clearance(self) -> float:
        """Height [m] of the lower edge."""
        return self.form.clearance * self.height

    @property
    def wheel_places(self) -> tuple[float, float]:
        """Positions of the front and the rear axle along x [m]."""
        half = self.length / 2
        return self.form.front_wheel * half, self.form.rear_wheel * half

    def level_height(self, x: float, level: float) -> float:
        """Compute the height [m] of a level of the lower body at x [m]."""
        at = min(max(x, self.rear_x(1.0)), self.front_x(1.0))
        shoulder = float(self.shoulder_height(np.array([at]))[0])
        return self.clearance + level * (shoulder - self.clearance)

    def front_x(self, level: float) -> float:
        """Compute the foremost x [m] of a level."""
        return self.length / 2 - float(np.interp(level, LEVELS, self.form.front_insets_m))

    def rear_x(self, level: float) -> float:
        """Compute the rearmost x [m] of a level."""
        return -self.length / 2 + float(np.interp(level, LEVELS, self.form.rear_insets_m))

    def side_y(self, x: float, level: float) -> float:
        """Compute the distance [m] of the skin from the middle plane at x [m]."""
        form = self.form
        roundness = form.front_roundness if x > 0 else form.rear_roundness
        outline = (1 - abs(x / (self.length / 2)) ** roundness) ** (1 / roundness)
        inset = float(np.interp(level, LEVELS, _SIDE_INSETS))
        return float(self.width / 2 * outline * (1 - inset))

    def screen_x(self, level: float | Shaped) -> float | Shaped:
        """Compute x [m] of the windscreen's corners, from the cabin's base 0 to its roof 1."""
        form = self.form
        return (form.screen_base + level * (form.screen_top - form.screen_base)) * self.length / 2

    def cabin_half_width(self, level: float | Shaped) -> float | Shaped:
        """Compute half the width [m] of the cabin at a height from its base 0 to its roof 1."""
        form = self.form
        share = form.base_width + level * (form.roof_width - form.base_width)
        return np.asarray(self.width / 2 * (share + 0.018 * np.sin(np.pi * level)))


def lower_body(body: Body) -> Mesh:
    """Build the body below the windows: wheel arches, and painted lamps, grille and gaps."""
    outline = _lower_outline(body)
    skin = grid(_lower_points(body, outline), body.paint, closed=True)
    rows = np.concatenate(([-1.0, -1.0, -1.0, -1.0], LEVELS, 2 - _ROUND_ROWS))
    level = (rows[1:] + rows[:-1])[:, None] / 2
    following = np.roll(outline, -1, axis=0)
    place, across = (outline + following).T / 2
    cells = _lower_cells(body, level, place, np.abs(across))
    palette = (body.paint, BLACK_PLASTIC, GAP, HEADLIGHT, TAIL_LIGHT, REVERSING_LIGHT)
    form = body.form
    inside = (level > 1.04) & (place < form.screen_base - 0.02) & (place > form.rear_base + 0.02)
    skin = kept(painted(skin, cells, palette), ~np.repeat(inside.ravel(), 2))
    return without_slivers(skin)


def _lower_outline(body: Body) -> Float64[np.ndarray, "columns 2"]:
    """Compute (place, share of half width) of columns, from the front's middle over the left."""
    form, half = body.form, body.length / 2
    front_q = _sorted(0.0, 0.2, form.grille_half_width, form.lamp_inner, 0.68, 0.78, 0.85)
    rear_q = _sorted(0.0, 0.22, 0.45, form.tail_inner, form.tail_inner + 0.1, 0.86)
    gaps = [gap + side * _GAP_HALF_WIDTH / half for gap in form.door_gaps for side in (-1, 1)]
    arches = _arch_places(body)
    sides = _sorted(*gaps, *arches.ravel(), form.lamp_end, form.tail_start, -0.955)
    front = np.stack((_superellipse(front_q, form.front_roundness), front_q), axis=1)
    rear = np.stack((-_superellipse(rear_q, form.rear_roundness), rear_q), axis=1)[::-1]
    roundness = np.where(sides > 0, form.front_roundness, form.rear_roundness)
    side = np.stack((sides, _superellipse(np.abs(sides), roundness)), axis=1)[::-1]
    side = side[(side[:, 0] < front[-1, 0] - 0.01) & (side[:, 0] > rear[0, 0] + 0.01)]
    left = np.concatenate((front, side, rear))
    return np.concatenate((left, left[-2:0:-1] * (1, -1)))


def _arch_places(body: Body) -> Float64[np.ndarray, "2 angles"]:
    """Compute the places of the columns around the front and the rear wheel arch."""
    reach = _arch_radius(body) * np.cos(np.linspace(0, np.pi, _ARCH_ANGLES)) / (body.length / 2)
    return np.array([[body.form.front_wheel], [body.form.rear_wheel]]) + reach


def _arch_radius(body: Body) -> float:
    return 1.10 * body.wheel_radius + 0.025


def _lower_edge(body: Body, x: Columns) -> Columns:
    """Compute the height [m] of the skin's lower edge, which rises over the wheels."""
    edge = np.full_like(x, body.clearance)
    for wheel in body.wheel_places:
        rise = np.sqrt(np.maximum(_arch_radius(body) ** 2 - (x - wheel) ** 2, 0.0))
        # The arch's outermost columns stand on the edge; the next ones are well above the axle.
        edge = np.where(rise > 0.1 * body.wheel_radius, body.wheel_radius + rise, edge)
    return edge


def _lower_points(
    body: Body, outline: Float64[np.ndarray, "columns 2"]
) -> Float64[np.ndarray, "rows columns 3"]:
    """Compute the rings from the floor's middle, out, up the sides and in over bonnet and boot."""
    form = body.form
    place, across = outline.T
    at_front, at_rear = _smooth_step((place - 0.76) / 0.2), _smooth_step((-place - 0.78) / 0.18)
    edge = _lower_edge(body, place * body.length / 2)
    inset = np.outer(form.rear_insets_m, at_rear) - np.outer(form.front_insets_m, at_front)
    x = place * body.length / 2 + inset
    line = body.shoulder_height(x[-1])
    shoulder = line + CROWN * (1 - across**2)
    y = np.outer(1 - _SIDE_INSETS, across) * body.width / 2
    z = body.clearance + np.outer(LEVELS, shoulder - body.clearance)
    z = np.maximum(z, edge + 0.012 * np.arange(len(LEVELS))[:, None])
    sides = np.stack((x, y, z), axis=-1)
    under_x, under_y = x[0] - 0.1 * at_front + 0.1 * at_rear, y[0] * _UNDER_SHARE
    floor = np.full_like(place, body.clearance)
    below = [
        np.stack((under_x, 0 * under_y, floor), axis=-1),
        np.stack((under_x, under_y, floor), axis=-1),
        np.stack((under_x, under_y, edge), axis=-1),
        np.stack((x[0], 0.965 * y[0], edge), axis=-1),
    ]
    crown = CROWN * (1 - np.outer(_ROUND_ROWS, across) ** 2)
    above = np.stack(
        (
            np.broadcast_to(x[-1], (len(_ROUND_ROWS), len(place))),
            np.outer(_ROUND_ROWS, y[-1]),
            line + crown,
        ),
        axis=-1,
    )
    return np.concatenate((np.stack(below), sides, above))


def _lower_cells(
    body: Body, level: Float64[np.ndarray, "cell_rows 1"], place: Columns, across: Columns
) -> Int[np.ndarray, "cell_rows columns"]:
    """Choose the palette index of each cell: paint, plastic, gap, lamps."""
    form = body.form
    cells = np.zeros((len(level), len(place)), dtype=np.int64)
    front, rear = (place > 0.8) & (across < 0.9), (place < -0.8) & (across < 0.9)
    cells[np.broadcast_to(level < 0, cells.shape)] = 1
    cells[within(level, 0.0, 0.13) & (form.cladding | (front | rear))] = 1
    cells[within(level, 0.13, 0.32) & front & (across < form.lamp_inner)] = 1
    cells[within(level, 0.13, 0.32) & form.cladding & ~(front | rear)] = 1
    cells[within(level, *form.grille_levels) & front & (across < form.grille_half_width)] = 1
    doors = np.zeros(len(place), dtype=bool)
    for gap in form.door_gaps:
        doors |= np.abs(place - gap) < 0.2 * _GAP_HALF_WIDTH / body.length
    cells[within(level, 0.13, 1.0) & doors] = 2
    cells[within(level, 0.46, 0.475) & rear & (across < 0.8)] = 2
    bonnet = (place > form.screen_base) & (place < 0.9)
    cells[within(level, 2 - 0.885, 2 - 0.87) & bonnet] = 2
    lamps = (place > form.lamp_end) & (across > form.lamp_inner)
    cells[within(level, *form.lamp_levels) & lamps] = 3
    lamps = (place < form.tail_start) & (across > form.tail_inner)
    cells[within(level, *form.tail_levels) & lamps] = 4
    low = form.tail_levels[0]
    inner = rear & within(across, form.tail_inner, form.tail_inner + 0.1)
    cells[within(level, low, low + 0.11) & inner] = 5
    if form.covered_bed:
        cells[(level > 1.04) & (place < form.rear_base - 0.02)] = 1
    return cells


def within(values: Shaped, low: float, high: float) -> Bool[np.ndarray, "*shape"]:
    """Test which values lie between the limits."""
    return np.asarray((values > low) & (values < high))


def _sorted(*values: float) -> Float64[np.ndarray, " num_values"]:
    """Sort the values; of two values closer than 2e-4, one is kept."""
    ordered = np.sort(np.array(values, dtype=np.float64))
    apart = np.concatenate(([True], np.diff(ordered) > 2e-4))
    return ordered[apart]


def _superellipse(coordinate: Shaped, exponent: float | Shaped) -> Shaped:
    """Compute the other coordinate of a point on the unit superellipse."""
    return np.asarray((1 - coordinate**exponent) ** (1 / exponent))


def _smooth_step(values: Shaped) -> Shaped:
    clipped = np.clip(values, 0.0, 1.0)
    return np.asarray(clipped * clipped * (3 - 2 * clipped))


_ROOF_ROWS = np.array([0.965, 0.86, 0.6, 0.3, 0.0])  # from the roof's edge to its middle
_COLUMN_POSITIONS = (0.0, 0.3, 0.6, 0.94, 1.03, 1.5, 2.5, 3.05, 3.85, 3.96, 4.07, 4.4, 4.7, 5.0)
_FRONT_PILLAR = (1.925, 2.06)  # positions of the black pillar between the doors
_LAMP = (3.96, 4.12)  # positions of a tail light beside the rear window
_SILL_LEVEL, _FRAME_LEVEL = 0.115, 0.075
_HEADER = 0.045  # height of the black frame above the windows, as a share of the cabin's height


class _Window(NamedTuple):
    start: float  # position of the start
    end: float
    frame: float  # width of the black frame on either side, in the same units
    is_glazed: bool


def cabin(body: Body) -> Mesh:
    """Build windows, pillars and roof."""
    positions, sides = _columns(body.form)
    walls = _wall_points(body, positions, sides)
    points = np.concatenate((walls, _roof_points(body, walls[-1])))
    skin = grid(points, body.roof, closed=True)
    rows = np.concatenate((_levels(body.form), 2 - _ROOF_ROWS))
    level = (rows[1:] + rows[:-1])[:, None] / 2
    cells = _cells(body.form, level, (positions + np.roll(positions, -1)) / 2)
    palette = (body.roof, TINTED_GLASS, BLACK_PLASTIC, TAIL_LIGHT)
    return without_slivers(painted(skin, cells, palette))


def _windows(form: BodyForm) -> tuple[_Window, ...]:
    last_end = 2.95 + form.last_window_end
    return (
        _Window(-1.0, 0.84, 0.035, is_glazed=True),
        _Window(1.11, _FRONT_PILLAR[0], 0.03, form.glazed[0]),
        _Window(_FRONT_PILLAR[1], 2.93, 0.03, form.glazed[1]),
        _Window(3.10, last_end, 0.05, form.glazed[2]),
        _Window(4.17, 6.0, 0.035, form.rear_glazed),
    )


def _levels(form: BodyForm) -> Float64[np.ndarray, " rows"]:
    """Compute the heights of the walls' rows, from the cabin's base 0 to its roof 1."""
    top = form.window_top
    return np.array([0.0, _FRAME_LEVEL, _SILL_LEVEL, 0.45, top, top + _HEADER, 1.0])


def _columns(form: BodyForm) -> tuple[Columns, Columns]:
    """Compute each column's position and side (1 left, -1 right): from the front, left first."""
    edges = [
        edge
        for window in _windows(form)
        for edge in (
            window.start - window.frame,
            window.start,
            window.end,
            window.end + window.frame,
        )
        if 0 < edge < 5
    ]
    left = np.unique(np.array([*edges, *_COLUMN_POSITIONS]))
    right = left[-2:0:-1]
    sides = np.repeat((1.0, -1.0), (len(left), len(right)))
    return np.concatenate((left, right)), sides


def _wall_points(
    body: Body, position: Columns, side: Columns
) -> Float64[np.ndarray, "rows columns 3"]:
    """Compute the rings from the sill to the edge of the roof."""
    form, half = body.form, body.length / 2
    level = _levels(form)[:, None]
    bulge = 0.02 * np.sin(np.pi * level)
    corner = body.screen_x(level) + bulge
    end = (form.rear_base + level * (form.rear_top - form.rear_base)) * half - bulge
    first, second = form.pillars[0] * half, form.pillars[1] * half
    knots = np.broadcast_arrays(corner, first, np.maximum(second, end + 0.02), end)
    x = _along_side(np.concatenate(knots, axis=1), position)
    to_middle = np.where(position < 1, position, np.where(position > 4, 5 - position, 1.0))
    x += np.where(position < 1, form.screen_bow_m * (1 - 0.35 * level) * (1 - to_middle**2), 0)
    x -= np.where(position > 4, form.rear_bow_m * (1 - to_middle**3), 0)
    ahead = np.clip((x - first) / (corner - first), 0, 1.2)
    behind = np.clip((first - x) / (first - end), 0, 1.2)
    narrowing = 1 - 0.05 * ahead**2 - 0.07 * behind**2.5
    y = body.cabin_half_width(level) * to_middle * narrowing * side
    sill = body.shoulder_height(x[0]) + CROWN * (1 - np.square(y[0] / (body.width / 2))) - 0.03
    z = sill + level * (_roof_height(body, x[-1], y[-1], y[-1]) - sill)
    return np.stack((x, y, z), axis=-1)


def _along_side(
    knots: Float64[np.ndarray, "rows 4"], position: Columns
) -> Float64[np.ndarray, "rows columns"]:
    """Compute x of each column: `knots` are the places at positions 1, 2, 3 and 4."""
    along = np.clip(position - 1, 0, 3)
    index = np.minimum(along.astype(np.int64), 2)
    return np.asarray(knots[:, index] + (along - index) * (knots[:, index + 1] - knots[:, index]))


def _roof_points(
    body: Body, edge: Float64[np.ndarray, "columns 3"]
) -> Float64[np.ndarray, "rows columns 3"]:
    """Compute the rings from the edge of the roof to its middle line."""
    y = np.outer(_ROOF_ROWS, edge[:, 1])
    x = np.broadcast_to(edge[:, 0], y.shape)
    return np.stack((x, y, _roof_height(body, x, y, edge[:, 1])), axis=-1)


def _roof_height(
    body: Body,
    x: Float64[np.ndarray, "*rows columns"],
    y: Float64[np.ndarray, "*rows columns"],
    edge_y: Columns,
) -> Float64[np.ndarray, "*rows columns"]:
    """Compute the height [m] of the roof, which falls to both ends and to the sides."""
    form, half = body.form, body.length / 2
    middle = (form.screen_top + form.rear_top) / 2 * half
    reach = (form.screen_top - form.rear_top) / 2 * half
    fall = np.where(x > middle, form.roof_fall_front_m, form.roof_fall_rear_m)
    across = np.abs(y) / np.abs(edge_y).max()
    return np.asarray(
        body.height - form.roof_crown_m * across**2.5 - fall * np.square((x - middle) / reach)
    )


def _cells(
    form: BodyForm, level: Float64[np.ndarray, "cell_rows 1"], position: Columns
) -> Int[np.ndarray, "cell_rows columns"]:
    """Choose the finish of each cell: paint, glass or plastic."""
    cells = np.zeros((len(level), len(position)), dtype=np.int64)
    glass_rows = within(level, _SILL_LEVEL, form.window_top)
    frame_rows = within(level, _FRAME_LEVEL, form.window_top + _HEADER)
    for window in _windows(form):
        if window.is_glazed:
            framed = within(position, window.start - window.frame, window.end + window.frame)
            cells[frame_rows & framed] = 2
            cells[glass_rows & within(position, window.start, window.end)] = 1
    if form.glazed[0]:
        cells[frame_rows & within(position, *_FRONT_PILLAR)] = 2
    if form.pillar_lamps:
        cells[within(level, _SILL_LEVEL, form.window_top) & within(position, *_LAMP)] = 3
    below_screen = (level < _SILL_LEVEL) & (position < 0.875)
    cells[below_screen] = 2
    return cells
