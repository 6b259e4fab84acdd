"""Ground and roads: heights, carriageways, kerbs, bands beside them, junctions and open land."""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from sightline.simulation.arrays import Numbers
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.primitives import Color, Finish, grid
from sightline.simulation.streets.layout import (
    Ground,
    Junction,
    Layout,
    Parking,
    Plots,
    Road,
    Side,
    StreetKind,
    Terrain,
)

_CROWN_FADE_M: Final = 10.0
"""Distance before a junction over which the crown flattens out, as two road surfaces meet."""
_RAMP_HALF_M: Final = 1.7
_RAMP_SLOPE_M: Final = 0.8
"""Half width of a lowered kerb, and length of the slope at each of its ends."""
RAMP_DEPTH_M: Final = 1.0
"""Distance from a lowered kerb over which the pavement rises to its full height."""
_STEP_M: Final = 0.3  # distance over which a person who steps onto a kerb rises to its height


def surface_height(
    terrain: Terrain, road: Road, stations: Numbers, offsets: Numbers
) -> Float64[np.ndarray, "..."]:
    """Compute the height [m] of the ground on or beside a road, in the world."""
    heights = terrain.height(road.line.place(stations, offsets))
    return np.asarray(heights + surface_level(road, stations, offsets))


def surface_level(road: Road, stations: Numbers, offsets: Numbers) -> Float64[np.ndarray, "..."]:
    """Compute the height [m] of carriageway or bands above the terrain; kerbs are short ramps."""
    edges = np.where(np.asarray(offsets) >= 0, road.left.edge, road.right.edge)
    share = np.clip((np.abs(offsets) - edges) / _STEP_M + 0.5, 0.0, 1.0)
    bands = band_level(road, stations, offsets)
    return np.asarray(crown_level(road, stations, offsets) + share * bands)


def crown_level(road: Road, stations: Numbers, offsets: Numbers) -> Float64[np.ndarray, "..."]:
    """Compute the carriageway's height [m] above its edges: a parabola across, 0 in junctions."""
    edges = np.where(np.asarray(offsets) >= 0, road.left.edge, road.right.edge)
    across = np.clip(1.0 - (offsets / edges) ** 2, 0.0, 1.0)
    gaps = road.left.gaps + road.right.gaps
    apart = [np.maximum(start - stations, stations - stop) for start, stop in gaps]
    fade = [np.clip(distance / _CROWN_FADE_M, 0.0, 1.0) for distance in apart]
    along = np.minimum.reduce(fade) if fade else 1.0
    return np.asarray(road.crown_m * across * along)


def band_level(road: Road, stations: Numbers, offsets: Numbers) -> Float64[np.ndarray, "..."]:
    """Compute the bands' height [m] above the terrain, less at lowered kerbs, 0 in junctions."""
    is_left = np.asarray(offsets) >= 0
    levels = [_level_of(side, stations, offsets) for side in road.sides]
    return np.where(is_left, *levels)


def _level_of(side: Side, stations: Numbers, offsets: Numbers) -> Float64[np.ndarray, "..."]:
    stations, offsets = np.broadcast_arrays(stations, offsets)
    is_open: Bool[np.ndarray, "..."] = np.zeros(stations.shape, dtype=bool)
    for start, stop in side.gaps:
        is_open |= (stations > start) & (stations < stop)
    shares = np.ones(stations.shape)
    for ramp in side.ramps:
        away = (np.abs(stations - ramp) - _RAMP_HALF_M) / _RAMP_SLOPE_M
        shares = np.minimum(shares, np.clip(away, 0.0, 1.0))
    behind = np.clip((np.abs(offsets) - side.edge) / RAMP_DEPTH_M, 0.0, 1.0)
    return np.where(is_open, 0.0, side.level * (shares + (1.0 - shares) * behind))


def ramp_stations(side: Side) -> Float64[np.ndarray, " num_stations"]:
    """Compute the stations at which the height of a side's kerb changes slope."""
    bends = (
        np.array([-1.0, 1.0]) * _RAMP_HALF_M + np.array([[0.0, 0.0], [-1.0, 1.0]]) * _RAMP_SLOPE_M
    )
    return (np.array(side.ramps)[:, None] + bends.ravel()).ravel()


_NEAR_STEP: Final = 2.0
_FAR_STEP: Final = 4.0
_WIDEST_CELL: Final = 1.6
_KERB_WIDTH: Final = 0.15
_GARDEN_REACH: Final = 14.0
_BEYOND: Final = 160.0
"""Length of the carriageway beyond the street, so that its end is not visible."""
_RIM_DROP: Final = 0.006
"""Offset by which plots along the crossing road are lower, where those of both roads overlap."""
_LAND_DROP: Final = 0.12  # height of the land below the adjoining bands


class RoadFinishes(NamedTuple):
    """Finishes of the ground of one street."""

    carriageway: Finish
    parking: Finish
    pavement: Finish
    cycle_path: Finish
    verge: Finish
    kerb: Finish
    land: Finish


_ASPHALT_TONES: Final = (0.13, 0.25)


def draw_road_finishes(rng: np.random.Generator, kind: StreetKind) -> RoadFinishes:
    """Draw surfaces of a street; asphalt of any age, slabs, setts and grass."""
    tone = float(rng.uniform(*_ASPHALT_TONES))
    asphalt = Finish(Material.ASPHALT, (tone, tone * 0.99, tone * 0.97))
    stone = float(rng.uniform(0.22, 0.40))
    slabs = Finish(
        Material.PAVEMENT, (stone, stone * rng.uniform(0.92, 0.98), stone * rng.uniform(0.82, 0.95))
    )
    setts = Finish(Material.COBBLES, (stone * 0.75, stone * 0.73, stone * 0.70))
    green = float(rng.uniform(0.10, 0.14))
    grass = Finish(
        Material.GRASS, (green * rng.uniform(0.65, 0.9), green, green * rng.uniform(0.25, 0.38))
    )
    red_path = Finish(Material.PAVEMENT, (0.32, 0.13, 0.09))
    grey_path = Finish(Material.ASPHALT, (tone * 1.15, tone * 1.13, tone * 1.10))
    carriageway = asphalt
    if kind is StreetKind.SQUARE:
        carriageway = setts if rng.random() < 0.5 else slabs
    elif kind is StreetKind.RESIDENTIAL and rng.random() < 0.1:
        carriageway = setts
    grey = float(rng.uniform(0.30, 0.45))
    return RoadFinishes(
        carriageway=carriageway,
        parking=setts if rng.random() < 0.35 else carriageway,
        pavement=slabs if rng.random() < 0.8 else grey_path,
        cycle_path=red_path if rng.random() < 0.65 else grey_path,
        verge=grass,
        kerb=Finish(Material.KERB, (grey, grey * 0.98, grey * 0.94)),
        land=Finish(Material.GRASS, grass.color),
    )


def make_ground(rng: np.random.Generator, layout: Layout) -> Mesh:
    """Build all ground for walking and driving, out to the horizon."""
    finishes = draw_road_finishes(rng, layout.kind)
    parts = [_land(rng, layout, finishes.land)]
    for road in layout.roads:
        parts += _road(layout, road, finishes)
    if layout.junction is not None:
        parts += _junction(layout, layout.junction, finishes)
    return Mesh.joined(parts)


def stations_between(first: float, last: float) -> Float64[np.ndarray, " num_stations"]:
    """Compute the stations of surface vertices: dense near the ego, shared by all surfaces."""
    near = np.arange(-30, 36) * _NEAR_STEP
    far = np.arange(18, 201) * _FAR_STEP
    shared = np.concatenate((-far[::-1], near, far))
    inside = shared[(shared > first + 0.05) & (shared < last - 0.05)]
    return np.concatenate(([first], inside, [last]))


def surface(
    layout: Layout,
    road: Road,
    stations: Float64[np.ndarray, " num_stations"],
    offsets: Float64[np.ndarray, " num_offsets"],
    levels: Float64[np.ndarray, "num_offsets #num_stations"],
    finish: Finish,
    *,
    smooth: bool = True,
) -> Mesh:
    """Build a surface along a road, at levels [m] above the terrain.

    Offsets run from right to left, or upwards if they are equal.
    """
    places = road.line.place(stations[None], offsets[:, None])
    heights = layout.terrain.height(places) + levels
    points = np.concatenate((places, heights[..., None]), axis=-1)
    return grid(points, finish, smooth=smooth)


def _across(first: float, second: float) -> Float64[np.ndarray, " num_offsets"]:
    """Compute offsets of a surface's vertices between two offsets, from right to left."""
    low, high = min(first, second), max(first, second)
    return np.linspace(low, high, 2 + int((high - low) / _WIDEST_CELL))


def _carriageway(
    layout: Layout,
    road: Road,
    span: tuple[float, float],
    stretch: tuple[float, float],
    finish: Finish,
    lift: float = 0.0,
) -> Mesh:
    """Build the carriageway between two offsets and two stations."""
    stations, offsets = stations_between(*stretch), _across(*span)
    levels = crown_level(road, stations[None], offsets[:, None]) + lift
    return surface(layout, road, stations, offsets, levels, finish)


def _road(layout: Layout, road: Road, finishes: RoadFinishes) -> list[Mesh]:
    span = (-road.right.edge, road.left.edge)
    stretches: tuple[tuple[float, float], ...] = ((road.first, road.last + _BEYOND),)
    if road is not layout.main:
        stretches = road.left.stretches(road.first, road.last)
    parts = [
        _carriageway(layout, road, span, stretch, finishes.carriageway) for stretch in stretches
    ]
    rim_drop = 0.0 if road is layout.main else _RIM_DROP
    for side in road.sides:
        for start, stop in side.stretches(road.first, road.last):
            bends = ramp_stations(side)
            bends = bends[(bends > start) & (bends < stop)]
            along = np.union1d(stations_between(start, stop), bends)
            parts += _bands(layout, road, side, along, finishes)
            parts += _rim(layout, road, side, along, finishes, rim_drop)
    return parts + _parking_surfaces(layout, road, finishes)


def _bands(
    layout: Layout,
    road: Road,
    side: Side,
    stations: Float64[np.ndarray, " num_stations"],
    finishes: RoadFinishes,
) -> list[Mesh]:
    """Build kerb and bands on one side of a road."""
    parts = []
    start = side.edge
    if road.has_kerbs:
        start += _KERB_WIDTH
        offsets = side.sign * np.array([side.edge, side.edge, start])
        levels = band_level(road, stations[None], offsets[:, None])
        levels[0] = -0.05
        order = slice(None, None, side.sign)
        kerb = surface(
            layout, road, stations, offsets[order], levels[order], finishes.kerb, smooth=False
        )
        parts.append(kerb)
    surfaces = {
        Ground.VERGE: finishes.verge,
        Ground.CYCLE_PATH: finishes.cycle_path,
        Ground.PAVEMENT: finishes.pavement,
        Ground.SHOULDER: finishes.verge,
    }
    for band in side.bands:
        offsets = _across(side.sign * max(band.inner, start), side.sign * band.outer)
        bend = side.sign * (side.edge + RAMP_DEPTH_M)
        if side.ramps and offsets[0] < bend < offsets[-1]:
            offsets = np.union1d(offsets, bend)
        levels = band_level(road, stations[None], offsets[:, None])
        parts.append(surface(layout, road, stations, offsets, levels, surfaces[band.ground]))
    return parts


def _rim(
    layout: Layout,
    road: Road,
    side: Side,
    stations: Float64[np.ndarray, " num_stations"],
    finishes: RoadFinishes,
    drop: float,
) -> list[Mesh]:
    """Build the ground of the plots, which ends below the surrounding land to avoid a gap."""
    paved = side.plots in (Plots.BLOCKS, Plots.HALLS)
    ground = finishes.pavement if paved else finishes.verge
    distances = side.outer + np.array([0.0, _GARDEN_REACH, _GARDEN_REACH + 2.0])
    levels = side.level - drop - np.array([0.0, 0.02, 2 * _LAND_DROP + 0.1])
    order = slice(None, None, side.sign)
    offsets = side.sign * distances[order]
    return [surface(layout, road, stations, offsets, levels[order, None], ground)]


def _parking_surfaces(layout: Layout, road: Road, finishes: RoadFinishes) -> list[Mesh]:
    """Build setts under parked cars if the street has them."""
    if finishes.parking == finishes.carriageway:
        return []
    parts = []
    for side in road.sides:
        if side.parking is Parking.NONE:
            continue
        span = (side.sign * side.lane_edge, side.sign * side.edge)
        parts += [
            _carriageway(layout, road, span, stretch, finishes.parking, 0.004)
            for stretch in side.stretches(road.first, road.last)
        ]
    return parts


def _junction(layout: Layout, junction: Junction, finishes: RoadFinishes) -> list[Mesh]:
    """Build asphalt between the carriageways, and the four corners with their kerbs."""
    main, cross = layout.main, junction.cross
    parts = []
    for side in main.sides:
        opens = junction.opens_left if side.sign > 0 else junction.opens_right
        if not opens:
            continue
        first = junction.station - cross.left.edge - junction.corner
        last = junction.station + cross.right.edge + junction.corner
        span = (side.sign * side.edge, side.sign * (side.edge + junction.corner))
        parts.append(_carriageway(layout, main, span, (first, last), finishes.carriageway))
        for ahead in (-1, 1):
            edge = cross.left.edge if ahead < 0 else cross.right.edge
            square_u = junction.station + ahead * (edge + junction.corner)
            square_v = side.sign * (side.edge + junction.corner)
            parts += _corner(layout, junction, (square_u, square_v), (-ahead, -side.sign), finishes)
    return parts


def _corner(
    layout: Layout,
    junction: Junction,
    inner: tuple[float, float],
    towards: tuple[int, int],
    finishes: RoadFinishes,
) -> list[Mesh]:
    """Build the pavement of a corner as a fan from its inner point, with a round kerb.

    `inner` is the station and offset of the point farthest from both carriageways, `towards` are
    the signs of the directions from there to the crossing and to the main carriageway.
    """
    # Without kerbs the ground is still a little above the asphalt below it.
    level = max(layout.main.left.level, 0.012)
    size, radius = junction.corner, junction.radius
    angles = np.linspace(0.0, np.pi / 2, 9)
    arc = np.stack(
        (size - radius + radius * np.sin(angles), size - radius + radius * np.cos(angles)), axis=1
    )
    rim = np.concatenate(([[0.0, size]], arc, [[size, 0.0]]))
    if towards[0] * towards[1] > 0:  # so that the fan winds counter-clockwise from above
        rim = rim[::-1]
    shares = np.linspace(0.0, 1.0, 4)
    fan = np.array(inner) + shares[:, None, None] * rim * np.array(towards)
    places = layout.main.line.place(fan[..., 0], fan[..., 1])
    heights = layout.terrain.height(places)[..., None]
    finish = finishes.pavement if layout.main.has_kerbs else finishes.verge
    top = grid(np.concatenate((places, heights + level), axis=-1)[::-1], finish)
    if not layout.main.has_kerbs:
        return [top]
    edge = np.concatenate((places[-1], heights[-1]), axis=-1)
    drop = np.array([0.0, 0.0, level])
    wall = grid(np.stack((edge - [0, 0, 0.05], edge + drop))[:, ::-1], finishes.kerb, smooth=False)
    back = np.concatenate((places[-2], heights[-2]), axis=-1)
    apart = back - edge
    apart *= _KERB_WIDTH / np.linalg.norm(apart, axis=1, keepdims=True)
    lift = drop + np.array([0.0, 0.0, 0.003])
    stones = grid(np.stack((edge + lift, edge + apart + lift))[:, ::-1], finishes.kerb)
    return [top, wall, stones]


_FIELD_COLORS: Final[tuple[tuple[Material, Color], ...]] = (
    (Material.GRASS, (0.09, 0.13, 0.035)), (Material.GRASS, (0.14, 0.16, 0.045)),
    (Material.GRASS, (0.22, 0.19, 0.075)), (Material.SOIL, (0.16, 0.11, 0.075)),
    (Material.GRASS, (0.07, 0.11, 0.03)),
)  # fmt: skip


def _land(rng: np.random.Generator, layout: Layout, around: Finish) -> Mesh:
    """Build meadows and fields from below the street to the horizon."""
    near = np.arange(-240.0, 241.0, 8.0)
    far = np.array([300.0, 380.0, 500.0, 700.0, 1000.0, 1500.0, 2400.0])
    axis = np.concatenate((-far[::-1], near, far))
    x, y = np.meshgrid(axis + 40.0, axis)
    places = np.stack((x, y), axis=-1)
    heights = layout.terrain.height(places)
    distant = np.clip((np.hypot(x, y) - 300.0) / 300.0, 0.0, 1.0)
    heights = np.clip(heights * (1 - distant), -6.0, 6.0) - _LAND_DROP
    mesh = grid(np.concatenate((places, heights[..., None]), axis=-1), around)
    if layout.kind not in (StreetKind.COUNTRY, StreetKind.AVENUE):
        return mesh
    centers = mesh.vertices[mesh.faces].mean(axis=1)
    turn = rng.uniform(0, np.pi)
    along = centers[:, 0] * np.cos(turn) + centers[:, 1] * np.sin(turn)
    across = centers[:, 1] * np.cos(turn) - centers[:, 0] * np.sin(turn)
    plot = np.floor(along / 70.0).astype(int) * 7 + np.floor(across / 130.0).astype(int) * 3
    kinds = rng.integers(0, len(_FIELD_COLORS), 97)[plot % 97]
    # Both triangles of a cell belong to one field; otherwise borders of fields would be jagged.
    kinds = np.repeat(kinds[::2], 2)
    materials = np.array([material for material, _ in _FIELD_COLORS], np.int32)[kinds]
    colors = np.array([color for _, color in _FIELD_COLORS], np.float32)[kinds]
    return Mesh(
        vertices=mesh.vertices,
        normals=mesh.normals,
        uvs=mesh.uvs,
        faces=mesh.faces,
        materials=materials,
        colors=colors,
    )
