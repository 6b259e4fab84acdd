"""Street layout: lanes, kerbs, pavements, a crossing road and the plots beside them."""

from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np
from jaxtyping import Float, Float64

from sightline.simulation.layout_line import CenterLine, Terrain

KERB_HEIGHT_M: Final = 0.12


class StreetKind(Enum):
    """Kind of street."""

    RESIDENTIAL = "residential"
    CITY = "city"
    AVENUE = "avenue"
    COUNTRY = "country"
    SQUARE = "square"


class Parking(Enum):
    """Arrangement of cars along the kerb."""

    NONE = "none"
    PARALLEL = "parallel"
    ANGLED = "angled"
    PERPENDICULAR = "perpendicular"


PARKING_DEPTH_M: Final = {
    Parking.NONE: 0.0,
    Parking.PARALLEL: 2.1,
    Parking.ANGLED: 5.1,
    Parking.PERPENDICULAR: 5.2,
}


class Ground(Enum):
    """Kind of a band beside the carriageway."""

    VERGE = "verge"
    CYCLE_PATH = "cycle path"
    PAVEMENT = "pavement"
    SHOULDER = "shoulder"


class Plots(Enum):
    """Kind of plots beyond the pavement."""

    HOUSES = "houses"
    TERRACES = "terraces"
    APARTMENTS = "apartments"
    BLOCKS = "blocks"
    HALLS = "halls"
    PARK = "park"
    FOREST = "forest"
    FIELD = "field"
    CAR_PARK = "car park"


@dataclass(frozen=True, kw_only=True, slots=True)
class Lane:
    """Vehicle lane of a road."""

    offset: float
    """Offset of its middle from the centre line [m], positive to the left."""
    width: float
    direction: int
    """1 along the line, -1 against it."""
    for_trams: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class Band:
    """Strip of ground beside the carriageway; distances from the centre line [m]."""

    ground: Ground
    inner: float
    outer: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Side:
    """One side of a road; distances from the centre line [m], all positive."""

    sign: int
    """1 left, -1 right."""
    lane_edge: float
    """End of the lanes and start of parking."""
    edge: float
    """Edge of the carriageway."""
    level: float
    """Height of the bands above the carriageway."""
    parking: Parking
    bands: tuple[Band, ...]
    plots: Plots
    setback: float
    """Distance between the last band and the buildings."""
    has_tree_row: bool = False
    gaps: tuple[tuple[float, float], ...] = ()
    """Ranges of stations where a crossing road opens this side."""
    ramps: tuple[float, ...] = ()
    """Stations where the kerb is lowered for driveways."""

    @property
    def outer(self) -> float:
        """End of the last band."""
        return self.bands[-1].outer

    def band(self, ground: Ground) -> Band | None:
        """Find the band of a kind, or None."""
        return next((band for band in self.bands if band.ground is ground), None)

    def stretches(
        self, first: float, last: float, margin: float = 0.0
    ) -> tuple[tuple[float, float], ...]:
        """Find the stretches between two stations outside the gaps, widened by `margin`."""
        cuts = [first]
        for start, stop in self.gaps:
            cuts += [start - margin, stop + margin]
        cuts.append(last)
        pairs = zip(cuts[::2], cuts[1::2], strict=True)
        return tuple((max(a, first), min(b, last)) for a, b in pairs if b - a > 0.5)


@dataclass(frozen=True, kw_only=True, slots=True)
class Road:
    """Road with its lanes and both sides."""

    line: CenterLine
    first: float
    last: float
    """Range of stations where the road is built."""
    lanes: tuple[Lane, ...]
    left: Side
    right: Side
    has_kerbs: bool
    crown_m: float = 0.0
    """Height of the carriageway's middle above its edges, for drainage."""

    @property
    def sides(self) -> tuple[Side, Side]:
        """Left and right side."""
        return self.left, self.right


@dataclass(frozen=True, kw_only=True, slots=True)
class Junction:
    """Crossing of the main road, or a road that ends at it.

    The stations of the crossing road are the offsets of the main road.
    """

    station: float
    radius: float
    """Radius of the kerb at the corners [m]."""
    corner: float
    """Side length of a corner's square beside both carriageways [m]."""
    cross: Road
    opens_left: bool
    opens_right: bool
    has_lights: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Layout:
    """Plan of a street before anything is built."""

    kind: StreetKind
    terrain: Terrain
    main: Road
    junction: Junction | None
    ego_lane: Lane
    main_waits: bool
    """Whether the main road waits at the junction while the crossing traffic drives."""
    wooded_horizon: bool

    @property
    def roads(self) -> tuple[Road, ...]:
        """All roads of the layout."""
        return (self.main,) if self.junction is None else (self.main, self.junction.cross)


def ground_places(
    layout: Layout,
    road: Road,
    stations: Float[np.ndarray, "..."],
    offsets: Float[np.ndarray, "..."] | float,
    level: float,
) -> Float64[np.ndarray, "... 3"]:
    """Compute world points at stations and offsets of a road, at a level above the terrain."""
    places = road.line.place(np.asarray(stations, np.float64), np.asarray(offsets, np.float64))
    heights = layout.terrain.height(places) + level
    return np.concatenate((places, heights[..., None]), axis=-1)
