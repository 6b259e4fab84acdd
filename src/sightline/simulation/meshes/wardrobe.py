"""Clothes and luggage: hanging cloth, hair, hats and bags, in the resting pose of 1.75 m."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from jaxtyping import Bool, Float64

from sightline.simulation.materials import Material
from sightline.simulation.meshes.edits import mirrored
from sightline.simulation.meshes.primitives import (
    Color,
    Finish,
    grid,
    kept,
    signed_power,
    superellipsoid,
    tube,
)
from sightline.simulation.meshes.skeleton import Bone, Skinned, chained, rigid

HEAD_RINGS = np.array(  # height, half depth, half width, offset ahead [m], from the neck up
    [
        (1.440, 0.060, 0.066, -0.014),
        (1.485, 0.054, 0.055, -0.012),
        (1.525, 0.054, 0.054, -0.006),
        (1.537, 0.074, 0.048, 0.014),
        (1.562, 0.090, 0.063, 0.012),
        (1.605, 0.097, 0.074, 0.006),
        (1.655, 0.100, 0.078, 0.001),
        (1.700, 0.094, 0.074, -0.003),
        (1.733, 0.070, 0.056, -0.006),
        (1.750, 0.010, 0.010, -0.008),
    ]
)


class Hair(Enum):
    """Hair or headwear."""

    SHORT = 0
    LONG = 1
    BALD = 2
    CAP = 3
    HELMET = 4


class Legwear(Enum):
    """Legwear."""

    TROUSERS = 0
    SHORTS = 1
    SKIRT = 2


class Luggage(Enum):
    """Carried luggage."""

    NOTHING = 0
    BACKPACK = 1
    HANDBAG = 2
    SHOULDER_BAG = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class Outfit:
    """Clothes, hair and skin."""

    skin: Color
    hair: Color
    hair_style: Hair
    top: Color
    bottom: Color
    shoes: Color
    accent: Color = (0.02, 0.02, 0.02)
    """Colour of hat and luggage."""
    short_sleeves: bool = False
    legwear: Legwear = Legwear.TROUSERS
    hem: float = 0.97
    """Height [m] of the top's hem on a figure of 1.75 m: 0.9 a jacket, 0.6 a coat."""
    shirt: Color | None = None
    """Colour visible where the top is open in front; None if it is closed."""
    luggage: Luggage = Luggage.NOTHING


CLOTH_SIDES = 16
"""Columns around trunk and cloth."""


def front_columns() -> Bool[np.ndarray, " columns"]:
    """Mark the columns of cloth in the middle of the front, where a jacket opens."""
    column = np.arange(CLOTH_SIDES)
    front: Bool[np.ndarray, " columns"] = (column == 0) | (column == CLOTH_SIDES - 1)
    return front


def ellipse_stack(
    stations: Float64[np.ndarray, "num_rings 4"], num_sides: int, *, squareness: float = 1.0
) -> Float64[np.ndarray, "num_rings num_sides 3"]:
    """Compute rings (height, half depth, half width, offset ahead) about z; column 0 is ahead."""
    angles = np.arange(num_sides) * (2 * np.pi / num_sides)
    cos = signed_power(np.cos(angles), squareness)
    sin = signed_power(np.sin(angles), squareness)
    height, depth, width, ahead = (stations[:, [index]] for index in range(4))
    return np.stack((ahead + depth * cos, width * sin, height + 0 * cos), axis=-1)


def hanging_cloth(
    hem: float, depth: float, width: float, finish: Finish, *, is_open: bool = False
) -> Skinned:
    """Build a jacket's lower part, a coat or a skirt, following the hips and, lower, both thighs.

    Args:
        hem: Height [m] of its lower edge.
        depth: Half size along x [m] at the hips.
        width: Half size along y [m] at the hips.
        finish: Finish of the cloth.
        is_open: Whether it is open in front.
    """
    start = 1.08  # the waist
    heights = np.linspace(hem, start, max(3, round((start - hem) / 0.07)))
    fit = np.interp(heights, (0.45, 0.88, 0.95, 1.02, 1.08), (1.40, 1.05, 1.01, 0.89, 0.76))
    stations = np.stack((heights, depth * fit, width * fit, np.full_like(heights, -0.005)), axis=1)
    mesh = grid(ellipse_stack(stations, CLOTH_SIDES, squareness=0.85), finish, closed=True)
    if is_open:
        shut = np.repeat(np.tile(~front_columns(), len(stations) - 1), 2)
        mesh = kept(mesh, shut)
    skinned = chained(mesh, (Bone.TORSO, Bone.PELVIS), (1.04,), softness=0.06)
    y, z = mesh.vertices[:, 1], mesh.vertices[:, 2]
    thigh = 0.8 * np.clip((0.93 - z) / 0.30, 0, 1)
    left = np.clip(0.5 + y / 0.15, 0, 1)
    weights = skinned.weights * (1 - thigh[:, None])
    weights[:, Bone.LEFT_THIGH] += thigh * left
    weights[:, Bone.RIGHT_THIGH] += thigh * (1 - left)
    return Skinned(mesh=mesh, weights=weights)


def headwear(outfit: Outfit) -> list[Skinned]:
    """Build hair, cap or helmet."""
    hair = Finish(Material.CLOTH, outfit.hair)
    accent = Finish(Material.CLOTH, outfit.accent)
    style = outfit.hair_style
    parts = []
    if style in (Hair.SHORT, Hair.LONG, Hair.CAP, Hair.HELMET):
        parts.append(_hair_shell(hair))
    if style is Hair.LONG:
        parts.append(_long_hair(hair))
    if style is Hair.CAP:
        crown = superellipsoid(
            (-0.005, 0, 1.685), (0.115, 0.092, 0.095), accent, num_rings=9, num_sides=12
        )
        above = crown.vertices[crown.faces][:, :, 2].mean(axis=1) > 1.675
        parts.append(rigid(kept(crown, above), Bone.HEAD))
        brim = superellipsoid(
            (0.125, 0, 1.685), (0.075, 0.07, 0.008), accent, num_rings=5, num_sides=10
        )
        parts.append(rigid(brim, Bone.HEAD))
    if style is Hair.HELMET:
        plastic = Finish(Material.PLASTIC, outfit.accent)
        shell = superellipsoid(
            (-0.005, 0, 1.690), (0.140, 0.105, 0.095), plastic, num_rings=9, num_sides=14
        )
        above = shell.vertices[shell.faces][:, :, 2].mean(axis=1) > 1.665
        parts.append(rigid(kept(shell, above), Bone.HEAD))
    return parts


def _hair_shell(finish: Finish) -> Skinned:
    """Build a layer over the skull without the face and the ears."""
    heights = np.array([1.555, 1.590, 1.625, 1.655, 1.680, 1.700, 1.720, 1.742, 1.757, 1.765])
    columns = [np.interp(heights / 1.008, HEAD_RINGS[:, 0], HEAD_RINGS[:, k]) for k in (1, 2, 3)]
    thicker = np.interp(heights, (1.55, 1.65, 1.75), (0.002, 0.009, 0.010))
    depth, width, ahead = columns
    rings = np.stack((heights, depth + thicker, width + thicker, ahead - 0.006), axis=1)
    num_sides = 16
    mesh = grid(ellipse_stack(rings, num_sides), finish, closed=True)
    cos = np.cos((np.arange(num_sides) + 0.5) * (2 * np.pi / num_sides))
    middle = (heights[:-1] + heights[1:]) / 2
    limit = np.interp(middle, (1.60, 1.63, 1.66, 1.69, 1.705), (-0.35, 0.0, 0.35, 0.8, 1.1))
    return rigid(kept(mesh, np.repeat((cos[None] < limit[:, None]).ravel(), 2)), Bone.HEAD)


def _long_hair(finish: Finish) -> Skinned:
    """Build hair down to the shoulders."""
    rings = np.array(
        [
            (1.40, 0.050, 0.100, -0.080),
            (1.48, 0.065, 0.105, -0.065),
            (1.56, 0.088, 0.100, -0.030),
            (1.64, 0.100, 0.090, -0.014),
        ]
    )
    mesh = grid(ellipse_stack(rings, 14), finish, closed=True)
    behind = np.cos((np.arange(14) + 0.5) * (2 * np.pi / 14)) < 0.15
    keep = np.repeat(np.tile(behind, len(rings) - 1), 2)
    return chained(kept(mesh, keep), (Bone.HEAD, Bone.TORSO), (1.44,))


def luggage(outfit: Outfit, trunk_depth: float) -> list[Skinned]:
    """Build a bag with its straps; `trunk_depth` is half the chest's depth [m]."""
    finish = Finish(Material.CLOTH, outfit.accent)
    if outfit.luggage is Luggage.BACKPACK:
        body = superellipsoid(
            (-trunk_depth - 0.085, 0, 1.23),
            (0.095, 0.150, 0.215),
            finish,
            exponents=(0.5, 0.5),
            num_rings=8,
            num_sides=12,
        )
        front = trunk_depth + 0.012
        path = [
            (-trunk_depth, 0.09, 1.40),
            (0.0, 0.10, 1.465),
            (0.75 * front, 0.105, 1.39),
            (front, 0.11, 1.28),
            (0.6 * front, 0.145, 1.14),
        ]
        strap = tube(path, 0.018, finish, num_sides=5)
        return [rigid(part, Bone.TORSO) for part in (body, strap, mirrored(strap))]
    if outfit.luggage is Luggage.HANDBAG:
        body = superellipsoid(
            (0.0, -0.235, 0.52),
            (0.15, 0.05, 0.12),
            finish,
            exponents=(0.4, 0.4),
            num_rings=6,
            num_sides=12,
        )
        handle = [(-0.07, -0.235, 0.62), (0.0, -0.235, 0.80), (0.07, -0.235, 0.62)]
        grip = tube(handle, 0.01, finish, num_sides=5)
        return [rigid(part, Bone.RIGHT_FOREARM) for part in (body, grip)]
    if outfit.luggage is Luggage.SHOULDER_BAG:
        body = superellipsoid(
            (-0.04, -0.245, 0.93),
            (0.14, 0.055, 0.11),
            finish,
            exponents=(0.4, 0.4),
            num_rings=6,
            num_sides=12,
        )
        front = trunk_depth + 0.02
        path = [
            (0.06, -0.215, 1.02),
            (front, -0.02, 1.22),
            (0.6 * front, 0.10, 1.42),
            (0.0, 0.105, 1.475),
            (-0.7 * front, 0.06, 1.38),
            (-front, -0.04, 1.22),
            (-0.10, -0.215, 1.02),
        ]
        strap = tube(path, 0.012, finish, num_sides=5)
        return [rigid(body, Bone.PELVIS), chained(strap, (Bone.TORSO, Bone.PELVIS), (1.06,))]
    return []
