"""Procedural textures over a face's colour.

A texture maps a face's linear albedo and a place on the surface to the albedo and the surface tilt
of one pixel. Lengths are in metres of the surface's u and v: along the street and across it on the
ground, along the wall and up on buildings. All textures are filtered to the pixel.
"""

from typing import Final, NamedTuple

import numpy as np

from sightline.ops.compiled import compiled
from sightline.simulation.rays.kernels import (
    Spot,
    Vector,
    clouded,
    crack,
    grain,
    grid_lines,
    hashed,
    in_bond,
    lines,
    luminance,
    off_center,
    per_tile,
    speckle,
    value_noise,
)
from sightline.simulation.scene import Material

ROAD_PAINT_LUMINANCE: Final = 0.3
"""Minimum luminance of road paint on asphalt; it wears off in places."""

_PATCH_LENGTH, _PATCH_WIDTH = 6.5, 2.4
_BARE_ASPHALT: Final = (0.11, 0.11, 0.112)
_MORTAR: Final = (0.42, 0.39, 0.35)

_ASPHALT: Final = int(Material.ASPHALT)
_PAVEMENT: Final = int(Material.PAVEMENT)
_GRASS: Final = int(Material.GRASS)
_SOIL: Final = int(Material.SOIL)
_KERB: Final = int(Material.KERB)
_CONCRETE: Final = int(Material.CONCRETE)
_PLASTER: Final = int(Material.PLASTER)
_BRICK: Final = int(Material.BRICK)
_ROOF_TILE: Final = int(Material.ROOF_TILE)
_CAR_PAINT: Final = int(Material.CAR_PAINT)
_HEADLIGHT: Final = int(Material.HEADLIGHT)
_TAIL_LIGHT: Final = int(Material.TAIL_LIGHT)
_LEAF: Final = int(Material.LEAF)
_BARK: Final = int(Material.BARK)
_CLOTH: Final = int(Material.CLOTH)
_WOOD: Final = int(Material.WOOD)
_GRAVEL: Final = int(Material.GRAVEL)
_COBBLES: Final = int(Material.COBBLES)
_WINDOW: Final = int(Material.WINDOW)
_COATED_GLASS: Final = int(Material.COATED_GLASS)


class Textured(NamedTuple):
    """Textured surface in one pixel."""

    color: Vector  # linear RGB albedo; `textured` keeps it in [0, 1]
    tilt_u: float
    tilt_v: float  # slope of the surface along u and v


@compiled
def textured(material: int, color: Vector, spot: Spot) -> Textured:
    """Compute the texture of a material at a spot, from the face's linear albedo."""
    if material == _ASPHALT:
        surface = _asphalt(color, spot)
    elif material == _GRASS:
        surface = _grass(color, spot)
    elif material == _LEAF:
        surface = _leaf(color, spot)
    elif material == _PLASTER:
        surface = _plaster(color, spot)
    elif material in (_PAVEMENT, _KERB, _SOIL, _GRAVEL, _COBBLES):
        surface = _paving_or_soil(material, color, spot)
    elif material in (_BRICK, _ROOF_TILE, _CONCRETE, _WOOD, _WINDOW, _COATED_GLASS):
        surface = _building_surface(material, color, spot)
    else:
        surface = _object_surface(material, color, spot)
    red, green, blue = surface.color
    bounded = (_bounded(red), _bounded(green), _bounded(blue))
    return Textured(bounded, surface.tilt_u, surface.tilt_v)


@compiled
def _paving_or_soil(material: int, color: Vector, spot: Spot) -> Textured:
    if material == _PAVEMENT:
        return _paving(color, spot)
    if material == _KERB:
        return _kerb(color, spot)
    if material == _COBBLES:
        return _cobbles(color, spot)
    return _loose_ground(color, spot)


@compiled
def _building_surface(material: int, color: Vector, spot: Spot) -> Textured:
    if material == _BRICK:
        return _brick(color, spot)
    if material == _ROOF_TILE:
        return _roof_tile(color, spot)
    if material in (_WINDOW, _COATED_GLASS):
        return _window(color, spot)
    if material == _WOOD:
        return _wood(color, spot)
    return _concrete(color, spot)


@compiled
def _object_surface(material: int, color: Vector, spot: Spot) -> Textured:
    if material == _BARK:
        return _bark(color, spot)
    if material == _CLOTH:
        return _cloth(color, spot)
    if material == _CAR_PAINT:
        return _car_paint(color, spot)
    if material in (_HEADLIGHT, _TAIL_LIGHT):
        return _lamp_glass(color, spot)
    return Textured(_dimmed(color, 1.0 + 0.06 * clouded(spot, 3.0, 3.0, 0)), 0.0, 0.0)


@compiled
def _bounded(value: float) -> float:
    return min(max(value, 0.0), 1.0)


@compiled
def _dimmed(color: Vector, factor: float) -> Vector:
    return color[0] * factor, color[1] * factor, color[2] * factor


@compiled
def _mixed(color: Vector, other: Vector, share: float) -> Vector:
    """Mix a colour with a share of another."""
    kept = 1.0 - share
    return (
        color[0] * kept + other[0] * share,
        color[1] * kept + other[1] * share,
        color[2] * kept + other[2] * share,
    )


@compiled
def _asphalt(color: Vector, spot: Spot) -> Textured:
    """Texture of stones in tar, stains, repaired rectangles, cracks, or worn paint."""
    stones = speckle(spot, 0.022, 0) + 0.12 * grain(spot, 9.0, 9.0, 1)
    if luminance(color) > ROAD_PAINT_LUMINANCE:
        wear = 0.5 * clouded(spot, 5.0, 5.0, 2) + 0.5 * stones + 0.4 * grain(spot, 0.4, 0.4, 5)
        bare = _bounded(1.6 * (wear - 0.32)) + 0.10
        return Textured(_mixed(_dimmed(color, 1.0 + 0.1 * stones), _BARE_ASPHALT, bare), 0.0, 0.0)
    # Traffic wear is stretched along the road.
    worn = grain(spot, 0.05, 0.09, 18)
    tone = 1.0 + 0.14 * clouded(spot, 0.12, 0.5, 6) + 0.10 * grain(spot, 0.04, 1.8, 9)
    tone *= 1.0 - 0.24 * _repair(spot)
    if worn > 0.0:
        tone *= 1.0 - 0.8 * min(1.0, 4.0 * worn) * crack(spot, 0.16, 0.035, 16)
    tone *= 1.0 + 0.5 * stones
    return Textured(_dimmed(color, tone), 0.0, 0.0)


@compiled
def _repair(spot: Spot) -> float:
    """Compute the share of the pixel on repaired asphalt: some rectangles of a loose grid."""
    row = int(np.floor(spot.v / _PATCH_WIDTH))
    shifted = spot.u + 40.0 * hashed(row, 0, spot.seed + 12)
    column = int(np.floor(shifted / _PATCH_LENGTH))
    if hashed(column, row, spot.seed + 13) < 0.9:
        return 0.0
    along = shifted - column * _PATCH_LENGTH
    across = spot.v - row * _PATCH_WIDTH
    length = _PATCH_LENGTH * (0.35 + 0.6 * hashed(column, row, spot.seed + 14))
    width = _PATCH_WIDTH * (0.4 + 0.6 * hashed(column, row, spot.seed + 15))
    return lines(along, spot.width_u, 1e9, length) * lines(across, spot.width_v, 1e9, width)


@compiled
def _grass(color: Vector, spot: Spot) -> Textured:
    """Texture of tufts and blades, with dry and bare places.

    Upright blades do not flatten at a grazing angle as a pattern on the ground would. Speckle,
    which is as fine as the pixel, has this look.
    """
    tufts = 0.5 * clouded(spot, 0.9, 0.9, 0) + speckle(spot, 0.16, 3)
    blades = speckle(spot, 0.05, 4)
    dry = _bounded(0.35 + 0.9 * clouded(spot, 0.22, 0.22, 5))
    straw = (color[0] * 1.9, color[1] * 1.15, color[2] * 1.1)
    tone = max(0.2, 1.0 + 0.35 * tufts + 0.7 * blades)
    tilt_u, tilt_v = 0.4 * speckle(spot, 0.10, 8), 0.4 * speckle(spot, 0.10, 9)
    return Textured(_dimmed(_mixed(color, straw, dry), tone), tilt_u, tilt_v)


@compiled
def _loose_ground(color: Vector, spot: Spot) -> Textured:
    """Soil and gravel: lumps of every size."""
    tone = 1.0 + 0.25 * clouded(spot, 0.7, 0.7, 0) + 0.35 * grain(spot, 30.0, 30.0, 3)
    tone *= 1.0 + 0.4 * speckle(spot, 0.04, 4)
    tilt = 0.35 * grain(spot, 30.0, 30.0, 5)
    return Textured(_dimmed(color, tone), tilt, 0.35 * grain(spot, 30.0, 30.0, 6))


@compiled
def _paving(color: Vector, spot: Spot) -> Textured:
    """Slabs in running bond, or small stones, by the seed."""
    small = spot.seed % 3 == 0
    slab_u, slab_v, joint = (0.2, 0.1, 0.008) if small else (0.5, 0.5, 0.012)
    shifted = in_bond(spot, slab_u, slab_v)
    joints = grid_lines(shifted, slab_u, slab_v, joint)
    tone = 1.0 + 0.13 * per_tile(shifted, slab_u, slab_v, 0) + 0.15 * clouded(spot, 0.4, 0.4, 1)
    tone *= (1.0 + 0.25 * speckle(spot, 0.03, 4)) * (1.0 - 0.5 * joints)
    return Textured(_dimmed(color, tone), 0.0, 0.0)


@compiled
def _kerb(color: Vector, spot: Spot) -> Textured:
    """Granite stones of one metre."""
    joint = lines(spot.u, spot.width_u, 1.0, 0.012)
    tone = 1.0 + 0.10 * per_tile(spot, 1.0, 1e6, 0) + 0.25 * speckle(spot, 0.03, 1)
    tone *= (1.0 + 0.14 * clouded(spot, 1.5, 4.0, 2)) * (1.0 - 0.6 * joint)
    return Textured(_dimmed(color, tone), 0.0, 0.0)


@compiled
def _cobbles(color: Vector, spot: Spot) -> Textured:
    """Rounded stones in rows."""
    stone = 0.115
    shifted = in_bond(spot, stone, stone)
    joints = grid_lines(shifted, stone, stone, 0.018)
    tone = 1.0 + 0.25 * per_tile(shifted, stone, stone, 0) + 0.15 * clouded(spot, 0.5, 0.5, 1)
    tone *= (1.0 - 0.55 * joints) * (1.0 + 0.2 * speckle(spot, 0.03, 4))
    near = max(0.0, 1.0 - 2.0 * max(spot.width_u, spot.width_v) / stone)
    tilt_u, tilt_v = off_center(shifted.u, stone), off_center(spot.v, stone)
    return Textured(_dimmed(color, tone), 0.9 * near * tilt_u, 0.9 * near * tilt_v)


@compiled
def _plaster(color: Vector, spot: Spot) -> Textured:
    """Rough render with weather streaks, dirtier towards the ground."""
    tone = 1.0 + 0.05 * clouded(spot, 0.35, 0.35, 0) + 0.05 * grain(spot, 1.8, 0.15, 3)
    tone *= 1.0 + 0.10 * speckle(spot, 0.04, 4)
    splashes = max(0.0, 1.0 - abs(spot.v) / 0.7) * (0.6 + 0.4 * grain(spot, 2.0, 0.5, 5))
    return Textured(_dimmed(color, tone * (1.0 - 0.22 * splashes)), 0.0, 0.0)


@compiled
def _brick(color: Vector, spot: Spot) -> Textured:
    """Stretcher bond of German format, 24 x 7.1 cm with 1 cm of mortar."""
    length, height, mortar = 0.25, 0.081, 0.011
    shifted = in_bond(spot, length, height)
    joints = grid_lines(shifted, length, height, mortar)
    tone = 1.0 + 0.28 * per_tile(shifted, length, height, 0) + 0.10 * clouded(spot, 0.4, 0.4, 1)
    tone *= 1.0 + 0.15 * speckle(spot, 0.03, 4)
    return Textured(_mixed(_dimmed(color, tone), _MORTAR, joints), 0.0, 0.0)


@compiled
def _roof_tile(color: Vector, spot: Spot) -> Textured:
    """Curved tiles in rows, dark under each edge, with moss."""
    width, height = 0.24, 0.34
    edge = lines(spot.v, spot.width_v, height, 0.045)
    tone = 1.0 + 0.18 * per_tile(spot, width, height, 0) + 0.15 * clouded(spot, 0.5, 0.5, 1)
    tone *= 1.0 - 0.45 * edge
    near = max(0.0, 1.0 - 2.0 * spot.width_u / width)
    tilt_u = 1.1 * near * off_center(spot.u, width)
    return Textured(_dimmed(color, tone), tilt_u, -0.2 * near)


@compiled
def _concrete(color: Vector, spot: Spot) -> Textured:
    """Stains, pores and the joints of the formwork."""
    joint = lines(spot.u, spot.width_u, 2.5, 0.02)
    tone = 1.0 + 0.14 * clouded(spot, 0.6, 0.4, 0) + 0.08 * grain(spot, 2.5, 0.2, 3)
    tone *= (1.0 + 0.10 * speckle(spot, 0.04, 4)) * (1.0 - 0.35 * joint)
    return Textured(_dimmed(color, tone), 0.0, 0.0)


@compiled
def _wood(color: Vector, spot: Spot) -> Textured:
    """Upright boards with grain."""
    board = 0.12
    gap = lines(spot.u, spot.width_u, board, 0.008)
    tone = 1.0 + 0.16 * per_tile(spot, board, 1e6, 0) + 0.16 * clouded(spot, 35.0, 1.2, 1)
    return Textured(_dimmed(color, tone * (1.0 - 0.6 * gap)), 0.0, 0.0)


@compiled
def _window(color: Vector, spot: Spot) -> Textured:
    """Texture of old panes, which are not flat: their reflections are slightly bent."""
    bend = 0.012 * value_noise(spot.u * 1.3, spot.v * 1.3, spot.seed)
    return Textured(color, bend, 0.012 * value_noise(spot.u * 1.3, spot.v * 1.3, spot.seed + 1))


@compiled
def _bark(color: Vector, spot: Spot) -> Textured:
    """Upright ridges."""
    ridges = 0.7 * clouded(spot, 16.0, 3.0, 0) + 0.3 * grain(spot, 60.0, 12.0, 3)
    tone = 1.0 + 0.45 * ridges + 0.25 * clouded(spot, 1.0, 1.0, 4)
    return Textured(_dimmed(color, tone), 0.9 * grain(spot, 16.0, 3.0, 7), 0.0)


@compiled
def _leaf(color: Vector, spot: Spot) -> Textured:
    """Texture of small leaves on a card of foliage, each at its own angle, dark in between."""
    gap = max(0.0, per_tile(spot, 0.055, 0.045, 5) - 0.4)
    tone = (1.0 + 0.4 * per_tile(spot, 0.09, 0.07, 0)) * (1.15 - 1.6 * gap)
    tone *= 1.0 + 0.5 * speckle(spot, 0.08, 6)
    warm = 0.25 * (1.0 + per_tile(spot, 0.09, 0.07, 2))
    leafy = (color[0] * (0.85 + warm), color[1], color[2] * (1.1 - 0.4 * warm))
    tilt_u = 1.2 * per_tile(spot, 0.09, 0.07, 3)
    return Textured(_dimmed(leafy, tone), tilt_u, 1.2 * per_tile(spot, 0.09, 0.07, 4))


@compiled
def _cloth(color: Vector, spot: Spot) -> Textured:
    """Texture of folds, and a weave visible only at close range."""
    tone = 1.0 + 0.12 * clouded(spot, 5.0, 3.0, 0) + 0.08 * grain(spot, 90.0, 90.0, 3)
    tilt_u = 0.45 * grain(spot, 9.0, 4.0, 4)
    return Textured(_dimmed(color, tone), tilt_u, 0.25 * grain(spot, 5.0, 7.0, 5))


@compiled
def _car_paint(color: Vector, spot: Spot) -> Textured:
    """Flakes, and a veil of dust."""
    tone = 1.0 + 0.10 * grain(spot, 220.0, 220.0, 0)
    dust = 0.035 * (1.0 + clouded(spot, 2.5, 2.5, 1))
    return Textured(_mixed(_dimmed(color, tone), (0.35, 0.33, 0.30), dust), 0.0, 0.0)


@compiled
def _lamp_glass(color: Vector, spot: Spot) -> Textured:
    """Ribs of the lens, chambers behind it."""
    ribs = lines(spot.u, spot.width_u, 0.03, 0.015)
    tone = 0.75 + 0.35 * ribs + 0.25 * grain(spot, 12.0, 12.0, 0)
    return Textured(_dimmed(color, tone), 0.25 * grain(spot, 25.0, 25.0, 1), 0.0)
