"""Trees of several species, bushes and hedges: trunks, boughs and cards of foliage."""

from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float

from sightline.simulation.arrays import AnyPoints, Points, Values
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import stamped
from sightline.simulation.shapes.primitives import Color, Finish, boxes, kept, repainted, tube
from sightline.simulation.tables import read_table

Species = Enum("Species", "LIME PLANE POPLAR BIRCH SPRUCE PINE CHERRY BUSH")  # kinds of plants
Detail = Enum("Detail", "CLOSE NEAR MIDDLE FAR")  # level of detail of a plant, by its distance


@dataclass(frozen=True, kw_only=True, slots=True)
class _PlantForm:
    """Form of a species; lengths are shares of its height."""

    height: float  # height of the model [m]
    crown_base: float
    crown_radius: float
    profile: tuple[float, ...]  # relative radius of the crown from its base to its top
    clumps: int
    clump_radius: float  # radius relative to the crown's
    trunk_radius: float
    droop: float  # droop of the foliage, 0 to 1
    leaf: Color
    bark: Color


_PLANT_FORMS: Final = {
    Species[name]: _PlantForm(**row) for name, row in read_table(__file__, "plants").items()
}

_CARDS: Final = {Detail.CLOSE: 3600, Detail.NEAR: 1000, Detail.MIDDLE: 340, Detail.FAR: 110}
_DETAIL_LIMITS_M: Final = (14.0, 28.0, 58.0)
_BEHIND_FACTOR: Final = 3.0  # distance factor for plants behind the ego, visible only to the LiDAR
_BUSH_SHARE: Final = 0.35
_VARIANTS: Final = 3


class Plants(NamedTuple):
    """Plants to be placed."""

    places: Points
    heights: Values  # heights [m]
    spread: float  # widths relative to the species' own
    coarseness: float = 1.0
    """Factor on the distance for choosing models; above 1 for plants in the rear."""


@cache
def tree_model(species: Species, detail: Detail, variant: int) -> Mesh:
    """Build a plant at the origin, of its species' usual height; cached."""
    rng = np.random.default_rng([list(Species).index(species), variant])
    form = _PLANT_FORMS[species]
    clumps, radii = _clumps(rng, form)
    share = _BUSH_SHARE if species is Species.BUSH else 0.5 + 0.05 * form.height
    foliage = _foliage(rng, form, clumps, radii, int(share * _CARDS[detail]))
    if species is Species.BUSH:
        return foliage
    parts = [_trunk(rng, form, detail), foliage]
    if detail is not Detail.FAR:
        parts += _boughs(rng, form, clumps, 4 if detail is Detail.MIDDLE else 12)
    wood = Mesh.joined([part for part in parts if part is not foliage])
    if species is Species.BIRCH:
        wood = _birch_bark(wood)
    return Mesh.joined((wood, foliage))


def set_out(rng: np.random.Generator, species: Species, plants: Plants) -> list[Mesh]:
    """Copy a species' models, each with its own heading, stretch and colour.

    The model is finer the nearer the plant is to the world's origin, where the ego starts.
    """
    count = len(plants.places)
    if count == 0:
        return []
    distance = np.hypot(plants.places[:, 0], plants.places[:, 1])
    is_behind = plants.places[:, 0] < -8.0
    distance *= plants.coarseness * np.where(is_behind, _BEHIND_FACTOR, 1.0)
    detail = np.digitize(distance, _DETAIL_LIMITS_M)
    variant = rng.integers(0, _VARIANTS, count)
    yaws = rng.uniform(0, 2 * np.pi, count)
    stretch = plants.heights / _PLANT_FORMS[species].height
    widths = stretch * plants.spread * rng.uniform(0.88, 1.15, count)
    scales = np.stack((widths, widths * rng.uniform(0.9, 1.1, count), stretch), axis=1)
    warmth = rng.uniform(0.8, 1.25, count)
    tints = np.stack((warmth, np.ones(count), rng.uniform(0.8, 1.2, count)), axis=1)
    tints *= rng.uniform(0.75, 1.25, (count, 1))
    parts = []
    for level, grade in enumerate(Detail):
        for kind in range(_VARIANTS):
            rows = (detail == level) & (variant == kind)
            if rows.any():
                parts.append(
                    stamped(
                        tree_model(species, grade, kind),
                        plants.places[rows],
                        yaws[rows],
                        scales=scales[rows],
                        tints=tints[rows],
                        tinted=(Material.LEAF,),
                    )
                )
    return parts


def _clumps(rng: np.random.Generator, form: _PlantForm) -> tuple[Points, Values]:
    """Draw centres and radii [m] of the balls of foliage in a crown."""
    count = form.clumps
    rise = (np.arange(count) + rng.uniform(0.1, 0.9, count)) / count
    widths = np.interp(rise, np.linspace(0, 1, len(form.profile)), form.profile)
    radius = form.crown_radius * form.height
    angles = np.arange(count) * 2.39996 + rng.uniform(-0.5, 0.5, count)  # the golden angle
    out = radius * widths * rng.uniform(0.35, 0.85, count)
    base = form.crown_base * form.height
    crown = form.height - base
    radii = form.clump_radius * radius * (0.45 + 0.55 * widths) * rng.uniform(0.7, 1.2, count)
    z = base + rise * crown
    z = np.clip(z, base * 0.9 + 0.5 * radii, form.height - 0.8 * radii)
    return np.stack((out * np.cos(angles), out * np.sin(angles), z), axis=1), radii


def _foliage(
    rng: np.random.Generator, form: _PlantForm, clumps: Points, radii: Values, num_cards: int
) -> Mesh:
    """Build cards of leaves on the clumps; fewer cards are larger."""
    weights = radii**2
    owner = rng.choice(len(clumps), num_cards, p=weights / weights.sum())
    directions = rng.normal(size=(num_cards, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions[:, 2] = np.where(
        rng.random(num_cards) < form.droop, -np.abs(directions[:, 2]), directions[:, 2]
    )
    reach = radii[owner] * rng.uniform(0.45, 1.05, num_cards)
    squash = np.array([1.0, 1.0, 0.8 + 0.6 * form.droop])
    centers = clumps[owner] + reach[:, None] * directions * squash
    centers[:, 2] = np.maximum(centers[:, 2], 0.02 * form.height)
    covered = np.sqrt(4 * np.pi * weights.sum() / num_cards)
    size = covered * rng.uniform(0.42, 0.85, num_cards)[:, None]
    first = np.cross(directions, rng.normal(size=(num_cards, 3)))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(first, directions + 0.9 * rng.normal(size=(num_cards, 3)))
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    corners = np.stack(
        (centers - first * size, centers - 0.62 * second * size, centers + first * size,
         centers + 0.62 * second * size),
        axis=1,
    )  # fmt: skip
    middle = np.array([0.0, 0.0, (0.35 + 0.65 * form.crown_base) * form.height])
    outward = centers - middle
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    normals = 0.6 * outward + 0.6 * directions + [0.0, 0.0, 0.25]
    return _card_mesh(rng, corners, normals, form.leaf)


def _card_mesh(
    rng: np.random.Generator,
    corners: Float[np.ndarray, "count 4 3"],
    normals: AnyPoints,
    leaf: Color,
) -> Mesh:
    count = len(corners)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    wide = np.linalg.norm(corners[:, 2] - corners[:, 0], axis=1)
    high = np.linalg.norm(corners[:, 3] - corners[:, 1], axis=1)
    unit = np.array([[0, 0.5], [0.5, 0], [1, 0.5], [0.5, 1]])
    uvs = np.stack((wide, high), axis=1)[:, None] * unit + rng.uniform(0, 5, (count, 1, 2))
    starts = np.arange(count)[:, None, None] * 4
    faces = (starts + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    colors = np.array(leaf) * rng.uniform(0.7, 1.3, (count, 1)) * rng.uniform(0.9, 1.1, (count, 3))
    return Mesh(
        vertices=corners.reshape(-1, 3).astype(np.float32),
        normals=np.repeat(normals, 4, axis=0).astype(np.float32),
        uvs=uvs.reshape(-1, 2).astype(np.float32),
        faces=faces.astype(np.int32),
        materials=np.full(2 * count, Material.LEAF, np.int32),
        colors=np.repeat(colors, 2, axis=0).astype(np.float32),
    )


def _trunk(rng: np.random.Generator, form: _PlantForm, detail: Detail) -> Mesh:
    top = form.height * (0.45 + 0.45 * form.crown_base + 0.1)
    bend = rng.normal(0, 0.012 * form.height, (4, 2))
    bend[0] = 0
    heights = np.array([-0.3, 0.06 * form.height, 0.5 * top, top])
    path = np.concatenate((np.cumsum(bend * [[0], [0.2], [1], [1]], axis=0), heights[:, None]), 1)
    thick = form.trunk_radius * form.height
    radii = (1.55 * thick, 1.05 * thick, 0.75 * thick, 0.2 * thick)
    sides = {Detail.MIDDLE: 6, Detail.FAR: 4}.get(detail, 9)
    return tube(path, radii, Finish(Material.BARK, form.bark), num_sides=sides, capped=False)


def _boughs(rng: np.random.Generator, form: _PlantForm, clumps: Points, count: int) -> list[Mesh]:
    """Build branches from the trunk into some of the clumps."""
    boughs = []
    thick = form.trunk_radius * form.height
    finish = Finish(Material.BARK, form.bark)
    for row in rng.permutation(len(clumps))[:count]:
        tip = clumps[row]
        out = float(np.hypot(tip[0], tip[1]))
        low = max(tip[2] - 1.1 * out, 0.6 * form.crown_base * form.height, 0.1)
        root = np.array([0.0, 0.0, min(low, 0.75 * form.height)])
        elbow = 0.5 * (root + tip) + [0, 0, 0.12 * out]
        radii = (0.42 * thick, 0.28 * thick, 0.10 * thick)
        boughs.append(tube([root, elbow, tip], radii, finish, num_sides=5, capped=False))
    return boughs


def _birch_bark(wood: Mesh) -> Mesh:
    """Paint white bark with black bands, and dark boughs higher up."""
    middle = wood.vertices[wood.faces].mean(axis=1)
    dark = np.sin(middle[:, 2] * 23.0 + middle[:, 0] * 40.0) > 0.75
    return repainted(wood, dark, Finish(Material.BARK, (0.06, 0.055, 0.05)))


_HEDGE_PIECE: Final = 2.0


@cache
def hedge_model(variant: int, is_fine: bool) -> Mesh:  # noqa: FBT001 - a key of the cache
    """Build 2 m of clipped hedge along x, 1 m high and 0.7 m deep: a dark core in leaf cards."""
    rng = np.random.default_rng([77, variant])
    count = 130 if is_fine else 45
    core = boxes(
        np.array([[0.0, 0.0, 0.44]]),
        np.array([[_HEDGE_PIECE / 2 + 0.02, 0.26, 0.46]]),
        Finish(Material.LEAF, (0.03, 0.05, 0.018)),
    )
    side = rng.choice(3, count, p=(0.36, 0.36, 0.28))
    x = rng.uniform(-_HEDGE_PIECE / 2, _HEDGE_PIECE / 2, count)
    directions = np.array([[0, -1.0, 0], [0, 1.0, 0], [0, 0, 1.0]])[side]
    y = np.where(side == 2, rng.uniform(-0.33, 0.33, count), directions[:, 1] * 0.31)
    z = np.where(side == 2, 0.96, rng.uniform(0.03, 0.97, count))
    centers = np.stack((x, y, z), axis=1) + rng.normal(0, 0.025, (count, 3))
    size = np.sqrt(4.6 / count) * rng.uniform(0.5, 0.9, count)[:, None]
    tilted = directions + 0.45 * rng.normal(size=(count, 3))
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    first = np.cross(tilted, rng.normal(size=(count, 3)))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(tilted, first)
    corners = np.stack(
        (centers - first * size, centers - 0.7 * second * size, centers + first * size,
         centers + 0.7 * second * size),
        axis=1,
    )  # fmt: skip
    cards = _card_mesh(rng, corners, directions + 0.3 * tilted + [0, 0, 0.2], (0.06, 0.11, 0.03))
    # The bottom of the core is never visible.
    return Mesh.joined((kept(core, core.normals[core.faces[:, 0], 2] > -0.5), cards))


def make_hedge(
    rng: np.random.Generator, starts: AnyPoints, stops: AnyPoints, height: float
) -> list[Mesh]:
    """Build hedges between pairs of world points, in pieces that follow the ground."""
    pieces = []
    for start, stop in zip(starts, stops, strict=True):
        length = float(np.hypot(*(stop - start)[:2]))
        count = max(1, round(length / _HEDGE_PIECE))
        shares = (np.arange(count) + 0.5) / count
        middles = start + shares[:, None] * (stop - start)
        yaw = float(np.arctan2(stop[1] - start[1], stop[0] - start[0]))
        rows = np.full((count, 2), (yaw, length / count / _HEDGE_PIECE))
        pieces.append(np.concatenate((middles, rows), axis=1))
    if not pieces:
        return []
    table = np.concatenate(pieces)
    count = len(table)
    tint = rng.uniform(0.7, 1.3) * np.array([rng.uniform(0.8, 1.4), 1.0, 1.0])
    tints = tint * rng.uniform(0.93, 1.07, (count, 1))
    scales = np.stack(
        (table[:, 4], np.full(count, rng.uniform(0.8, 1.3)), np.full(count, height)), axis=1
    )
    fine = (np.hypot(table[:, 0], table[:, 1]) < 24.0) & (table[:, 0] > -3.0)
    variant = rng.integers(0, 3, count)
    parts = []
    for kind in range(3):
        for is_fine in (True, False):
            rows_of = (variant == kind) & (fine == is_fine)
            if rows_of.any():
                parts.append(
                    stamped(
                        hedge_model(kind, is_fine),
                        table[rows_of, :3],
                        table[rows_of, 3],
                        scales=scales[rows_of],
                        tints=tints[rows_of],
                        tinted=(Material.LEAF,),
                    )
                )
    return parts
