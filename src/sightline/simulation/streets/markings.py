"""Road markings, as thin surfaces just above the road, and manhole covers."""

from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import QuadBatch
from sightline.simulation.shapes.primitives import Finish
from sightline.simulation.streets.ground import crown_level
from sightline.simulation.streets.layout import Junction, Layout, Parking, Road, Side, StreetKind

_LIFT: Final = 0.006
_LONGEST_PIECE: Final = 2.5
_PIECES_ACROSS: Final = 4
"""Number of pieces across the road, so that lines between parking places follow its crown."""
_STOP_LINE_GAP: Final = 1.0
_PAINT: Final = Finish(Material.ASPHALT, (0.72, 0.72, 0.70))
_IRON: Final = Finish(Material.CONCRETE, (0.07, 0.065, 0.06))


class RoadPainter:
    """Painter of markings along and across one road."""

    def __init__(self, layout: Layout, road: Road, batch: QuadBatch) -> None:
        self._terrain = layout.terrain
        self._road = road
        self._batch = batch

    def stripes(
        self,
        spans: Float64[np.ndarray, "num_stripes 2"],
        offsets: Float64[np.ndarray, "num_stripes 2"],
        finish: Finish = _PAINT,
    ) -> None:
        """Paint rectangles between two stations and two offsets each, bent with road and ground."""
        lengths = spans[:, 1] - spans[:, 0]
        counts = np.maximum(1, np.ceil(lengths / _LONGEST_PIECE)).astype(int)
        owner = np.repeat(np.arange(len(spans)), counts)
        piece = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
        start = spans[owner, 0] + lengths[owner] * piece / counts[owner]
        stop = spans[owner, 0] + lengths[owner] * (piece + 1) / counts[owner]
        low, high = offsets[owner].min(axis=1), offsets[owner].max(axis=1)
        self.polygons(
            np.stack((start, stop, stop, start), axis=1),
            np.stack((low, low, high, high), axis=1),
            finish,
        )

    def polygons(
        self,
        stations: Float64[np.ndarray, "num_quads 4"],
        offsets: Float64[np.ndarray, "num_quads 4"],
        finish: Finish = _PAINT,
    ) -> None:
        """Paint four-sided figures; corners counter-clockwise from above."""
        places = self._road.line.place(stations, offsets)
        level = crown_level(self._road, stations, offsets)
        heights = self._terrain.height(places) + level + _LIFT
        corners = np.concatenate((places, heights[..., None]), axis=-1)
        uvs = np.stack((stations, offsets), axis=-1)
        self._batch.add(corners, finish, uvs=uvs)

    def dashes(
        self, first: float, last: float, offset: float, pattern: tuple[float, float], width: float
    ) -> None:
        """Paint a broken line of (dash, gap) metres; a gap of 0 makes it solid."""
        dash, gap = pattern
        if last - first < dash:
            return
        starts = np.arange(first, last - dash, dash + gap) if gap else np.array([first])
        stops = starts + dash if gap else np.array([last])
        edges = np.tile([offset - width / 2, offset + width / 2], (len(starts), 1))
        self.stripes(np.stack((starts, stops), axis=1), edges)


def make_markings(rng: np.random.Generator, layout: Layout) -> Mesh:
    """Make all markings of a street."""
    batch = QuadBatch()
    for road in layout.roads:
        painter = RoadPainter(layout, road, batch)
        if layout.kind is not StreetKind.SQUARE:
            _paint_lanes(rng, layout, road, painter)
            for side in road.sides:
                _paint_parking(layout, road, side, painter)
        _lay_covers(rng, road, painter)
    main_painter = RoadPainter(layout, layout.main, batch)
    if layout.junction is not None:
        _paint_junction(layout, layout.junction, main_painter, batch)
    elif layout.kind in (StreetKind.CITY, StreetKind.RESIDENTIAL) and rng.random() < 0.3:
        _paint_zebra(layout.main, float(rng.uniform(12.0, 50.0)), main_painter)
    return batch.mesh()


def open_stretches(layout: Layout, road: Road) -> tuple[tuple[float, float], ...]:
    """List the ranges of stations of a road outside the junction."""
    junction = layout.junction
    if junction is None:
        return ((road.first, road.last),)
    if road is layout.main:
        before = junction.station - junction.cross.left.edge - junction.corner
        after = junction.station + junction.cross.right.edge + junction.corner
        return ((road.first, before), (after, road.last))
    return road.left.stretches(road.first, road.last)


def _paint_lanes(
    rng: np.random.Generator, layout: Layout, road: Road, painter: RoadPainter
) -> None:
    """Paint lines between lanes and, on country roads, at the edges."""
    country = layout.kind is StreetKind.COUNTRY
    quiet = layout.kind is StreetKind.RESIDENTIAL or road is not layout.main
    if quiet and not country and rng.random() < 0.6:
        return
    pattern = (4.0, 8.0) if country else (3.0, 3.0) if rng.random() < 0.4 else (3.0, 6.0)
    has_edges = country or (not quiet and rng.random() < 0.5)
    solid_center = len(road.lanes) >= 4 or rng.random() < 0.12
    for first, stop in open_stretches(layout, road):
        last = stop + 120.0 if stop == road.last and road is layout.main else stop
        for right, left in zip(road.lanes[:-1], road.lanes[1:], strict=True):
            offset = right.offset + right.width / 2
            is_center = right.direction != left.direction
            beside_trams = right.for_trams != left.for_trams
            if right.for_trams and left.for_trams:
                continue
            solid = (is_center and solid_center) or beside_trams
            painter.dashes(first, last, offset, (4.0, 0.0) if solid else pattern, 0.13)
        if has_edges:
            inset = 0.18 if country else 0.10
            for side in road.sides:
                offset = side.sign * (side.lane_edge - inset)
                painter.dashes(first, last, offset, (4.0, 0.0), 0.12)
    _lay_rails(road, painter)


def _lay_rails(road: Road, painter: RoadPainter) -> None:
    """Lay two grooved rails in each tram lane."""
    rail = Finish(Material.METAL, (0.30, 0.29, 0.28))
    for lane in road.lanes:
        if not lane.for_trams:
            continue
        spans = np.tile([road.first, road.last], (2, 1))
        middle = lane.offset + np.array([-0.72, 0.72])
        painter.stripes(spans, np.stack((middle - 0.045, middle + 0.045), axis=1), rail)


def _paint_parking(layout: Layout, road: Road, side: Side, painter: RoadPainter) -> None:
    """Paint lines between places for cars that stand across the road."""
    if side.parking not in (Parking.ANGLED, Parking.PERPENDICULAR):
        return
    for first, last in parking_stretches(layout, road, side):
        starts = np.arange(first, last, bay_pitch(side.parking))
        inner, outer = side.sign * side.lane_edge, side.sign * side.edge
        # Cars drive into them forwards.
        drift = -side.sign * bay_lean(side.parking) * (side.edge - side.lane_edge)
        shares = np.linspace(0.0, 1.0, _PIECES_ACROSS + 1)
        near, far = shares[:-1, None], shares[1:, None]
        stations = np.stack(
            (
                starts + near * drift,
                starts + near * drift + 0.1,
                starts + far * drift + 0.1,
                starts + far * drift,
            ),
            axis=-1,
        ).reshape(-1, 4)
        steps = inner + shares * (outer - inner)
        corners = np.stack((steps[:-1], steps[:-1], steps[1:], steps[1:]), axis=1)
        offsets = np.repeat(corners, len(starts), axis=0)
        if side.sign < 0:
            stations, offsets = stations[:, ::-1], offsets[:, ::-1]
        painter.polygons(stations, offsets)


def parking_stretches(layout: Layout, road: Road, side: Side) -> tuple[tuple[float, float], ...]:
    """List the parking ranges along a side: not directly at a junction."""
    margin = 5.0 if layout.junction is not None else 0.0
    return side.stretches(road.first, road.last, margin)


def bay_pitch(parking: Parking) -> float:
    """Length [m] along the kerb for one car."""
    return {Parking.PARALLEL: 5.6, Parking.ANGLED: 3.1}.get(parking, 2.6)


def bay_lean(parking: Parking) -> float:
    """Slant of a place along the road per metre of distance from the lanes."""
    return 0.58 if parking is Parking.ANGLED else 0.0


def _lay_covers(rng: np.random.Generator, road: Road, painter: RoadPainter) -> None:
    """Place manholes in the lanes and gullies at the kerb."""
    count = int(rng.integers(2, 6))
    stations = rng.uniform(road.first + 5, min(road.last, 90.0), count)
    lanes = rng.integers(0, len(road.lanes), count)
    offsets = np.array([road.lanes[row].offset for row in lanes]) + rng.uniform(-0.6, 0.6, count)
    # Two crossed rectangles form an octagon.
    for long, wide in ((0.31, 0.13), (0.22, 0.22), (0.13, 0.31)):
        painter.stripes(
            np.stack((stations - long, stations + long), axis=1),
            np.stack((offsets - wide, offsets + wide), axis=1),
            _IRON,
        )
    if road.has_kerbs:
        spots = np.arange(road.first + 7.0, min(road.last, 80.0), 23.0)
        for side in road.sides:
            near, far = side.sign * (side.edge - 0.45), side.sign * (side.edge - 0.05)
            kept = [spot for spot in spots if not any(a < spot < b for a, b in side.gaps)]
            spans = np.array([[spot, spot + 0.5] for spot in kept]).reshape(-1, 2)
            painter.stripes(spans, np.tile([near, far], (len(spans), 1)), _IRON)


def _paint_junction(
    layout: Layout, junction: Junction, main_painter: RoadPainter, batch: QuadBatch
) -> None:
    """Paint stop lines, or broken lines at yield signs, and crossings at lights."""
    cross_painter = RoadPainter(layout, junction.cross, batch)
    for road, painter in ((layout.main, main_painter), (junction.cross, cross_painter)):
        must_wait = junction.has_lights or road is junction.cross
        for station, direction in stop_lines(layout, road):
            lanes = [lane for lane in road.lanes if lane.direction == direction]
            low = min(lane.offset - lane.width / 2 for lane in lanes) + 0.15
            high = max(lane.offset + lane.width / 2 for lane in lanes) - 0.15
            if must_wait and junction.has_lights:
                painter.stripes(
                    np.array([[station - 0.25, station + 0.25]]), np.array([[low, high]])
                )
            elif must_wait:
                starts = np.arange(low, high - 0.4, 0.75)
                painter.stripes(
                    np.tile([station - 0.25, station + 0.25], (len(starts), 1)),
                    np.stack((starts, starts + 0.5), axis=1),
                )
            if junction.has_lights:
                _paint_ford(road, station + direction * 2.2, painter)


def stop_lines(layout: Layout, road: Road) -> list[tuple[float, int]]:
    """List for each arm the station of the stop line and the direction of its traffic."""
    lines = []
    for first, last in open_stretches(layout, road):
        if last < road.last:
            lines.append((last - _STOP_LINE_GAP, 1))
        if first > road.first:
            lines.append((first + _STOP_LINE_GAP, -1))
    directions = {lane.direction for lane in road.lanes}
    return [line for line in lines if line[1] in directions]


def _paint_ford(road: Road, station: float, painter: RoadPainter) -> None:
    """Paint two broken lines across the road that mark a crossing."""
    starts = np.arange(-road.right.edge + 0.2, road.left.edge - 0.5, 0.8)
    for start in (station - 1.4, station + 1.4):
        painter.stripes(
            np.tile([start - 0.06, start + 0.06], (len(starts), 1)),
            np.stack((starts, starts + 0.5), axis=1),
        )


def _paint_zebra(road: Road, station: float, painter: RoadPainter) -> None:
    starts = np.arange(-road.right.lane_edge + 0.2, road.left.lane_edge - 0.5, 1.0)
    painter.stripes(
        np.tile([station - 1.6, station + 1.6], (len(starts), 1)),
        np.stack((starts, starts + 0.5), axis=1),
    )
