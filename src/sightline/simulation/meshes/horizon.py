"""Distant background of a street: woods, single trees and roofs."""

from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
from jaxtyping import Bool, Float64

from sightline.simulation.layout import Layout, StreetKind
from sightline.simulation.materials import Material
from sightline.simulation.meshes.batches import QuadBatch, stamped
from sightline.simulation.meshes.building_forms import draw_apartments, draw_house
from sightline.simulation.meshes.buildings import BuildingSite, build
from sightline.simulation.meshes.plots import DECIDUOUS, planted
from sightline.simulation.meshes.primitives import Finish, grid
from sightline.simulation.scene import Mesh


def make_horizon(rng: np.random.Generator, layout: Layout) -> list[Mesh]:
    """Build distant woods and roofs all around, so that no street ends at a bare edge."""
    parts = [_distant_woods(rng, layout, distance) for distance in (300.0, 430.0)]
    angles = rng.uniform(0, 2 * np.pi, 110)
    distances = rng.uniform(110.0, 280.0, len(angles))
    places = np.stack((distances * np.cos(angles), distances * np.sin(angles)), axis=1)
    places = places[_clear_of_road(layout, places, 22.0)]
    heights = layout.terrain.height(places)[:, None] - 0.5
    standing = np.concatenate((places, heights), axis=1)
    kind = DECIDUOUS[int(rng.integers(len(DECIDUOUS)))]
    parts += planted(rng, kind, standing, (10.0, 18.0), spread=1.4)
    num_houses = {StreetKind.CITY: 46, StreetKind.SQUARE: 40, StreetKind.COUNTRY: 8}.get(
        layout.kind, 26
    )
    angles = rng.uniform(0, 2 * np.pi, num_houses)
    distances = rng.uniform(130.0, 280.0, num_houses)
    sites = np.stack((distances * np.cos(angles), distances * np.sin(angles)), axis=1)
    sites = sites[_clear_of_road(layout, sites, 40.0)]
    ground = layout.terrain.height(sites)[:, None]
    # Their fronts face the ego.
    yaws = np.arctan2(sites[:, 1], sites[:, 0]) - np.pi / 2 + rng.uniform(-0.6, 0.6, len(sites))
    is_tall = layout.kind in (StreetKind.CITY, StreetKind.SQUARE)
    variant = rng.integers(0, _DISTANT_VARIANTS, len(sites)) + (_DISTANT_VARIANTS if is_tall else 0)
    standing = np.concatenate((sites, ground), axis=1)
    for kind in np.unique(variant):
        rows = variant == kind
        parts.append(stamped(_distant_building(int(kind)), standing[rows], yaws[rows]))
    return parts


_DISTANT_VARIANTS: Final = 6


@cache
def _distant_building(variant: int) -> Mesh:
    """Build a house, or from `_DISTANT_VARIANTS` on a tall building, at the origin; cached."""
    rng = np.random.default_rng([5, variant])
    is_tall = variant >= _DISTANT_VARIANTS
    batch = QuadBatch()
    width, depth = rng.uniform(10.0, 26.0 if is_tall else 14.0), rng.uniform(9.0, 12.0)
    site = BuildingSite(
        corner=(0.0, 0.0), yaw=0.0, ground=0.0, width=float(width), depth=float(depth), is_far=True
    )
    build(rng, batch, site, draw_apartments(rng) if is_tall else draw_house(rng))
    return batch.mesh()


def _distant_woods(rng: np.random.Generator, layout: Layout, distance: float) -> Mesh:
    """Build a ring of lumpy foliage, higher for near woods and absent for open views."""
    count = 260
    angles = np.arange(count) * (2 * np.pi / count)
    phases = rng.uniform(0, 2 * np.pi, 4)
    waves = sum(
        np.sin(turns * angles + phase) / row
        for row, (turns, phase) in enumerate(zip((2, 5, 9, 17), phases, strict=True), start=1)
    )
    cover = 8.0 if layout.wooded_horizon else -2.0
    tops = np.clip(cover + 7.0 * np.asarray(waves), -4.0, 20.0) + rng.uniform(0.0, 3.5, count)
    far = distance * (1.0 + 0.12 * np.sin(3 * angles + phases[0])) + rng.uniform(-4, 4, count)
    rows = []
    for share, back in ((-0.2, 0.0), (0.55, 1.0), (0.9, 4.0), (1.0, 9.0)):
        radius = far + back + rng.uniform(-1.5, 1.5, count)
        lumps = rng.uniform(-0.8, 0.8, count)
        z = share * tops + lumps - 4.0
        rows.append(np.stack((radius * np.cos(angles), radius * np.sin(angles), z), axis=1))
    tone = float(rng.uniform(0.8, 1.2))
    leaf = Finish(Material.LEAF, (0.055 * tone, 0.09 * tone, 0.03 * tone))
    # Viewed from inside, columns run to the right with decreasing angle.
    mesh = grid(np.stack(rows)[:, ::-1], leaf, closed=True)
    tints = np.repeat(rng.uniform(0.75, 1.3, (len(mesh.faces) // 2, 1)), 2, axis=0)
    return replace(mesh, colors=(mesh.colors * tints).astype(np.float32))


def _clear_of_road(
    layout: Layout, places: Float64[np.ndarray, "count 2"], room: float
) -> Bool[np.ndarray, " count"]:
    """Test which places are far from the roads and from the buildings along them."""
    clear = np.ones(len(places), dtype=bool)
    for road in layout.roads:
        stations = np.arange(road.first - 20.0, road.last + 170.0, 8.0)
        line = road.line.place(stations, np.zeros(len(stations)))
        apart = np.linalg.norm(places[:, None] - line[None], axis=-1).min(axis=1)
        clear &= apart > room
    return clear
