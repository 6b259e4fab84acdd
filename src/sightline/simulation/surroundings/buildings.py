"""Kinds of buildings, their walls, roofs, balconies and chimneys."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float, Float64

from sightline.simulation.scene import Material
from sightline.simulation.shapes.edits import QuadBatch, box_corners
from sightline.simulation.shapes.primitives import Color, Finish
from sightline.simulation.surroundings.facades import Facade, Front, Look, build_front


@dataclass(frozen=True, kw_only=True, slots=True)
class BuildingForm:
    """Shape and finishes of a building."""

    look: Look
    storeys: int
    storey_height: float
    plinth: float  # height of the ground floor's level above the street [m]
    roof: str  # flat, gable (ridge along the front) or cross (ridge across)
    roof_pitch: float  # rise per metre
    roof_finish: Finish
    has_shop: bool = False
    has_balconies: bool = False
    has_chimney: bool = False
    has_dormers: bool = False
    is_glazed: bool = False  # whether all storeys have fronts of coated glass


_PLASTERS: Final[tuple[Color, ...]] = (
    (0.72, 0.68, 0.58), (0.76, 0.74, 0.70), (0.66, 0.55, 0.38), (0.70, 0.60, 0.44),
    (0.60, 0.42, 0.30), (0.56, 0.58, 0.60), (0.74, 0.69, 0.50), (0.58, 0.36, 0.28),
    (0.50, 0.56, 0.48), (0.47, 0.52, 0.60), (0.80, 0.79, 0.76),
)  # fmt: skip
_BRICKS: Final[tuple[Color, ...]] = ((0.36, 0.15, 0.10), (0.42, 0.22, 0.14), (0.45, 0.36, 0.25))
_ROOFS: Final[tuple[Color, ...]] = (
    (0.30, 0.11, 0.07), (0.36, 0.15, 0.09), (0.22, 0.10, 0.08), (0.09, 0.09, 0.10),
    (0.14, 0.11, 0.10),
)  # fmt: skip
_TRIMS: Final[tuple[Color, ...]] = ((0.78, 0.77, 0.74), (0.62, 0.60, 0.55), (0.30, 0.20, 0.13))
_FRAMES: Final[tuple[Color, ...]] = (
    (0.05, 0.05, 0.055), (0.30, 0.31, 0.32), (0.12, 0.11, 0.10), (0.55, 0.55, 0.54),
)  # fmt: skip
_DOORS: Final[tuple[Color, ...]] = (
    (0.20, 0.10, 0.05), (0.10, 0.16, 0.12), (0.45, 0.45, 0.46), (0.08, 0.10, 0.18),
    (0.28, 0.05, 0.05),
)  # fmt: skip


def _pick(rng: np.random.Generator, colors: tuple[Color, ...]) -> Color:
    color = np.array(colors[int(rng.integers(len(colors)))]) * rng.uniform(0.88, 1.08, 1)
    red, green, blue = np.clip(color * rng.uniform(0.96, 1.04, 3), 0.01, 0.9).tolist()
    return red, green, blue


def draw_look(rng: np.random.Generator, brick_share: float) -> Look:
    """Draw colours of a building and the size of its windows."""
    if rng.random() < brick_share:
        wall = Finish(Material.BRICK, _pick(rng, _BRICKS))
    else:
        wall = Finish(Material.PLASTER, _pick(rng, _PLASTERS))
    trim = _pick(rng, _TRIMS)
    return Look(
        wall=wall,
        base=Finish(Material.CONCRETE, (0.34, 0.33, 0.31)) if rng.random() < 0.6 else wall,
        trim=Finish(Material.PLASTIC, trim),
        door=Finish(Material.WOOD, _pick(rng, _DOORS)),
        window_width=float(rng.uniform(0.95, 1.5)),
        window_height=float(rng.uniform(1.25, 1.7)),
        window_pitch=float(rng.uniform(2.3, 3.3)),
        recess=float(rng.uniform(0.08, 0.20)),
        shutter_share=float(rng.choice([0.0, 0.1, 0.3])),
        has_folding_shutters=bool(rng.random() < 0.2),
    )


def draw_house(rng: np.random.Generator) -> BuildingForm:
    """Draw a detached house."""
    return BuildingForm(
        look=draw_look(rng, 0.15),
        storeys=int(rng.choice([1, 2, 2, 2])),
        storey_height=float(rng.uniform(2.65, 2.9)),
        plinth=float(rng.uniform(0.25, 0.9)),
        roof=str(rng.choice(["gable", "cross", "gable", "flat"], p=[0.4, 0.3, 0.2, 0.1])),
        roof_pitch=float(rng.uniform(0.55, 1.05)),
        roof_finish=Finish(Material.ROOF_TILE, _pick(rng, _ROOFS)),
        has_balconies=bool(rng.random() < 0.25),
        has_chimney=bool(rng.random() < 0.8),
        has_dormers=bool(rng.random() < 0.3),
    )


def draw_terrace(rng: np.random.Generator) -> BuildingForm:
    """Draw a house of a terrace: its neighbours have the same form and other colours."""
    return BuildingForm(
        look=draw_look(rng, 0.2),
        storeys=int(rng.choice([2, 2, 3])),
        storey_height=2.75,
        plinth=0.3,
        roof="gable",
        roof_pitch=float(rng.uniform(0.6, 0.9)),
        roof_finish=Finish(Material.ROOF_TILE, _pick(rng, _ROOFS)),
        has_chimney=True,
        has_dormers=bool(rng.random() < 0.4),
    )


def draw_apartments(rng: np.random.Generator) -> BuildingForm:
    """Draw a free-standing block of flats."""
    roof = "flat" if rng.random() < 0.6 else "gable"
    return BuildingForm(
        look=draw_look(rng, 0.1),
        storeys=int(rng.integers(3, 6)),
        storey_height=2.8,
        plinth=float(rng.uniform(0.4, 1.1)),
        roof=roof,
        roof_pitch=0.45,
        roof_finish=Finish(Material.ROOF_TILE, _pick(rng, _ROOFS)),
        has_balconies=bool(rng.random() < 0.65),
        has_chimney=True,
    )


def draw_town_house(rng: np.random.Generator) -> BuildingForm:
    """Draw a house of a continuous row in a town, often with a shop."""
    return BuildingForm(
        look=draw_look(rng, 0.18),
        storeys=int(rng.choice([2, 3, 4, 4, 5])),
        storey_height=float(rng.uniform(3.0, 3.5)),
        plinth=float(rng.uniform(0.1, 0.6)),
        roof=str(rng.choice(["gable", "flat"], p=[0.75, 0.25])),
        roof_pitch=float(rng.uniform(0.6, 1.1)),
        roof_finish=Finish(Material.ROOF_TILE, _pick(rng, _ROOFS)),
        has_shop=bool(rng.random() < 0.45),
        has_balconies=bool(rng.random() < 0.15),
        has_chimney=bool(rng.random() < 0.7),
        has_dormers=bool(rng.random() < 0.5),
    )


def draw_hall(rng: np.random.Generator) -> BuildingForm:
    """Draw an office, a supermarket or a workshop."""
    return BuildingForm(
        look=draw_look(rng, 0.15),
        storeys=int(rng.choice([1, 1, 2, 4])),
        storey_height=float(rng.uniform(3.4, 5.0)),
        plinth=0.1,
        roof="flat",
        roof_pitch=0.0,
        roof_finish=Finish(Material.GRAVEL, (0.25, 0.25, 0.24)),
        has_shop=bool(rng.random() < 0.6),
    )


_TALL_STOREYS: Final = (6, 16)


def heightened(rng: np.random.Generator, form: BuildingForm) -> BuildingForm:
    """Give a building of a town six storeys or more."""
    return replace(
        form,
        storeys=int(rng.integers(*_TALL_STOREYS)),
        roof="flat",
        has_dormers=False,
        has_balconies=form.has_balconies or bool(rng.random() < 0.3),
    )


def glazed(rng: np.random.Generator, form: BuildingForm) -> BuildingForm:
    """Give a building fronts of mirroring glass in thin frames, as offices have."""
    frame = Finish(Material.METAL, _pick(rng, _FRAMES))
    look = replace(
        form.look,
        wall=frame,
        base=frame,
        trim=frame,
        window_pitch=float(rng.uniform(1.2, 2.4)),
        recess=0.03,
    )
    return replace(
        form, look=look, is_glazed=True, roof="flat", plinth=0.1, has_balconies=False,
        has_dormers=False,
    )  # fmt: skip


_FOUNDATION: Final = 2.0  # depth of the walls below the ground [m], which may slope


@dataclass(frozen=True, kw_only=True, slots=True)
class BuildingSite:
    """Place of a building: its front runs from `corner` along `yaw`, its body is to the left.

    Viewed from the street, the front starts on the left; the outside is on the right of the front
    line.
    """

    corner: tuple[float, float]  # world x, y of the front's start
    yaw: float
    ground: float  # height of the ground in front
    width: float
    depth: float
    is_far: bool  # whether details smaller than a hand are left out
    is_free: tuple[bool, bool] = (True, True)
    """Whether its right and its left side have no neighbours."""


def build(
    rng: np.random.Generator, batch: QuadBatch, site: BuildingSite, form: BuildingForm
) -> None:
    """Add a building to a batch."""
    eaves = form.plinth + form.storeys * form.storey_height
    for front in _fronts(site, form):
        build_front(rng, batch, front, form.look)
    # The frame from here on: x along the front, y into the building, z up from the ground.
    batch.use_frame(site.corner[0], site.corner[1], site.ground, site.yaw)
    if form.roof == "flat":
        _flat_roof(batch, site, form, eaves)
    else:
        _gable_roof(rng, batch, site, form, eaves)
    if form.has_balconies:
        _balconies(rng, batch, site, form)
    batch.use_world()


def _fronts(site: BuildingSite, form: BuildingForm) -> list[Front]:
    """Build the four walls, the street's first; back walls and party walls have no windows."""
    corner = np.array(site.corner)
    along = np.array([np.cos(site.yaw), np.sin(site.yaw)])
    inwards = np.array([-along[1], along[0]])
    starts = (
        corner,
        corner + along * site.width,
        corner + along * site.width + inwards * site.depth,
        corner + inwards * site.depth,
    )
    fronts = []
    for row, start in enumerate(starts):
        is_visible = row in (1, 3) and site.is_free[0 if row == 1 else 1]
        sides_open = is_visible and not site.is_far
        facade = Facade.STREET if row == 0 else Facade.SIDE if sides_open else Facade.BLIND
        fronts.append(
            Front(
                start=(float(start[0]), float(start[1])),
                yaw=site.yaw + row * np.pi / 2,
                ground=site.ground,
                length=site.width if row % 2 == 0 else site.depth,
                plinth=form.plinth,
                storeys=form.storeys,
                storey_height=form.storey_height,
                facade=facade,
                has_shop=form.has_shop and row == 0,
                is_glazed=form.is_glazed,
                foundation=_FOUNDATION,
                is_far=site.is_far,
            )
        )
    return fronts


def _flat_roof(batch: QuadBatch, site: BuildingSite, form: BuildingForm, eaves: float) -> None:
    """Build a parapet around gravel, and a box for the lift or the ventilation."""
    width, depth = site.width, site.depth
    lid = [[0, 0, 0], [width, 0, 0], [width, depth, 0], [0, depth, 0]]
    top = np.array([lid], np.float64) + np.array([0, 0, eaves])
    batch.add(top, Finish(Material.GRAVEL, (0.22, 0.22, 0.21)))
    half = 0.15
    rims = np.array(
        [
            [width / 2, half, eaves + 0.2, width / 2 + 0.03, half + 0.03],
            [width / 2, depth - half, eaves + 0.2, width / 2 + 0.03, half + 0.03],
            [half, depth / 2, eaves + 0.2, half + 0.03, depth / 2 + 0.03],
            [width - half, depth / 2, eaves + 0.2, half + 0.03, depth / 2 + 0.03],
        ]
    )
    halves = np.stack((rims[:, 3], rims[:, 4], np.full(4, 0.22)), axis=1)
    _boxes(batch, rims[:, :3], halves, form.look.trim)
    if width > 9:
        center = np.array([[width * 0.4, depth * 0.6, eaves + 1.1]])
        _boxes(batch, center, np.array([[1.6, 1.3, 1.1]]), form.look.wall)


def _boxes(
    batch: QuadBatch,
    centers: Float[np.ndarray, "num_boxes 3"],
    half_sizes: Float[np.ndarray, "num_boxes 3"],
    finish: Finish,
) -> None:
    batch.add(box_corners(centers, half_sizes, np.zeros(len(centers))), finish)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Gable:
    """Shape of a roof with two slopes; lengths across, along and above its ridge."""

    is_cross: bool  # whether the ridge runs across the front
    wide: float
    ends: tuple[float, float]  # ends of the roof along the ridge, including the overhang
    long: float
    low: float  # height of the lower edges
    over: float  # overhang of the lower edges
    eaves: float
    rise: float
    thickness: float

    def place(
        self, local: Sequence[Sequence[Sequence[float]]]
    ) -> Float64[np.ndarray, "num_quads 4 3"]:
        """Place rectangles of (across the ridge, along it, up) in the building's frame."""
        array = np.array(local, np.float64)
        if self.is_cross:
            return array
        return array[:, ::-1, [1, 0, 2]]

    def placed_uvs(
        self, uvs: Float64[np.ndarray, "num_quads 4 2"]
    ) -> Float64[np.ndarray, "num_quads 4 2"]:
        """Reorder texture coordinates like the corners in `place`."""
        return uvs if self.is_cross else uvs[:, ::-1]


def _gable_roof(
    rng: np.random.Generator, batch: QuadBatch, site: BuildingSite, form: BuildingForm, eaves: float
) -> None:
    """Build two slopes, the gables under them, chimneys and similar parts."""
    is_cross = form.roof == "cross"
    long, wide = (site.depth, site.width) if is_cross else (site.width, site.depth)
    over, side = 0.45, 0.3 if all(site.is_free) else 0.0
    gable = _Gable(
        is_cross=is_cross,
        wide=wide,
        ends=(-side, long + side),
        long=long,
        low=eaves - over * form.roof_pitch,
        over=over,
        eaves=eaves,
        rise=form.roof_pitch * wide / 2,
        thickness=0.18,
    )
    _slopes(batch, gable, form)
    _roof_edges(batch, gable)
    _gable_walls(batch, gable, form)
    if is_cross:
        _gable_window(batch, site, form, eaves, gable.rise)
    if form.has_chimney:
        _chimney(rng, batch, site, eaves + gable.rise)
    if form.has_dormers and not is_cross and not site.is_far:
        _dormers(batch, site, form, eaves)


def _slopes(batch: QuadBatch, gable: _Gable, form: BuildingForm) -> None:
    """Build tiles above and boards below; the rows of tiles are along the ridge."""
    (start, stop), ridge = gable.ends, gable.wide / 2
    for thickness, finish in ((gable.thickness, form.roof_finish), (0.0, form.look.trim)):
        low, top = gable.low + thickness, gable.eaves + gable.rise + thickness
        left = [[-gable.over, stop, low], [-gable.over, start, low], [ridge, start, top],
                [ridge, stop, top]]  # fmt: skip
        far = gable.wide + gable.over
        right = [[far, start, low], [far, stop, low], [ridge, stop, top], [ridge, start, top]]
        length, slant = stop - start, float(np.hypot(ridge + gable.over, top - low))
        uvs = np.tile([[0, 0], [length, 0], [length, slant], [0, slant]], (2, 1, 1))
        batch.add(gable.place([left, right]), finish, uvs=gable.placed_uvs(uvs))


def _roof_edges(batch: QuadBatch, gable: _Gable) -> None:
    """Build gutters, and boards along the slopes' ends."""
    (start, stop), ridge, low = gable.ends, gable.wide / 2, gable.low
    top, thick = gable.eaves + gable.rise, gable.thickness
    edges = []
    for x in (-gable.over, gable.wide + gable.over):
        edges.append([[x, start, low], [x, stop, low], [x, stop, low + thick],
                      [x, start, low + thick]])  # fmt: skip
        edges += [
            [[x, end, low], [x, end, low + thick], [ridge, end, top + thick], [ridge, end, top]]
            for end in gable.ends
        ]
    batch.add(gable.place(edges), Finish(Material.METAL, (0.25, 0.24, 0.23)))


def _gable_walls(batch: QuadBatch, gable: _Gable, form: BuildingForm) -> None:
    """Build the triangles under the roof at both ends."""
    ridge, top = gable.wide / 2, gable.eaves + gable.rise
    walls = [
        [[0.0, end, gable.eaves], [gable.wide, end, gable.eaves], [ridge, end, top],
         [ridge, end, top]]
        for end in (0.0, gable.long)
    ]  # fmt: skip
    across = np.tile([0.0, gable.wide, ridge, ridge], (2, 1))
    heights = np.tile([gable.eaves, gable.eaves, top, top], (2, 1))
    uvs = gable.placed_uvs(np.stack((across, heights), axis=-1))
    batch.add(gable.place(walls), form.look.wall, uvs=uvs)


def _gable_window(
    batch: QuadBatch, site: BuildingSite, form: BuildingForm, eaves: float, rise: float
) -> None:
    """Build a window under the roof on the street's side."""
    if rise < 2.6:
        return
    middle, low = site.width / 2, eaves + 0.6
    for wide, high, out, finish in (
        (0.62, 1.25, -0.03, form.look.trim),
        (0.52, 1.05, -0.045, Finish(Material.WINDOW, (0.05, 0.055, 0.06))),
    ):
        bottom = low + (1.25 - high) / 2
        corners = [
            [middle - wide, out, bottom],
            [middle + wide, out, bottom],
            [middle + wide, out, bottom + high],
            [middle - wide, out, bottom + high],
        ]
        batch.add(np.array([corners], np.float64), finish)


def _chimney(rng: np.random.Generator, batch: QuadBatch, site: BuildingSite, top: float) -> None:
    center = np.array(
        [[site.width * rng.uniform(0.2, 0.8), site.depth * rng.uniform(0.4, 0.6), top]]
    )
    brick = Finish(Material.BRICK, (0.33, 0.15, 0.10))
    _boxes(batch, center, np.array([[0.28, 0.35, 0.9]]), brick)


def _dormers(batch: QuadBatch, site: BuildingSite, form: BuildingForm, eaves: float) -> None:
    """Build small boxes with a window in the slope towards the street."""
    count = int(site.width // 4.0)
    if count == 0 or form.roof_pitch < 0.5:
        return
    middles = (np.arange(count) + 0.5) * site.width / count
    back = 1.0 / form.roof_pitch
    depth = 0.9
    centers = np.stack(
        (middles, np.full(count, depth + back / 2), np.full(count, eaves + 0.4 + depth)), axis=1
    )
    halves = np.tile([0.75, back / 2 + 0.4, 0.8], (count, 1))
    _boxes(batch, centers, halves, form.look.wall)
    front = depth - 0.4
    for wide, low, high, out, finish in (
        (0.6, -0.55, 0.65, 0.015, form.look.trim),
        (0.5, -0.45, 0.55, 0.03, Finish(Material.WINDOW, (0.05, 0.055, 0.06))),
    ):
        corners = np.array([[-wide, 0, low], [wide, 0, low], [wide, 0, high], [-wide, 0, high]])
        local = (
            corners[None]
            + np.stack((middles, np.full(count, front - out), centers[:, 2]), axis=1)[:, None]
        )
        batch.add(local, finish)
    lids = np.stack((middles, centers[:, 1] - 0.1, centers[:, 2] + 0.85), axis=1)
    _boxes(batch, lids, halves * [1.15, 1.1, 0.08], form.roof_finish)


def _balconies(
    rng: np.random.Generator, batch: QuadBatch, site: BuildingSite, form: BuildingForm
) -> None:
    """Build a column of slabs with parapets for every few metres of front."""
    count = max(1, int(site.width // 9.0))
    deep = float(rng.uniform(1.0, 1.5))
    middles = (np.arange(count) + 0.5) * site.width / count
    floors = form.plinth + np.arange(1, form.storeys) * form.storey_height
    if len(floors) == 0:
        return
    grid = np.stack(np.meshgrid(middles, floors, indexing="ij"), axis=-1).reshape(-1, 2)
    slabs = np.stack((grid[:, 0], np.full(len(grid), -deep / 2), grid[:, 1] - 0.05), axis=1)
    concrete = Finish(Material.CONCRETE, (0.5, 0.5, 0.48))
    _boxes(batch, slabs, np.tile([1.7, deep / 2, 0.09], (len(grid), 1)), concrete)
    tone = form.look.door if rng.random() < 0.3 else form.look.trim
    parapet = Finish(Material.PLASTIC, tone.color)
    sheets = slabs + np.array([0, -deep / 2 + 0.03, 0.55])
    _boxes(batch, sheets, np.tile([1.7, 0.03, 0.46], (len(grid), 1)), parapet)
    for sign in (-1.67, 1.67):
        cheeks = slabs + np.array([sign, 0, 0.55])
        _boxes(batch, cheeks, np.tile([0.03, deep / 2, 0.46], (len(grid), 1)), parapet)
