"""Human figures in the resting pose, with various builds, clothes and luggage."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from jaxtyping import Bool, Float64

from sightline.simulation.bodies.skeleton import (
    LEFT,
    REST_JOINTS,
    RIGHT,
    Bone,
    Skinned,
    chained,
    rigid,
)
from sightline.simulation.scene import Material
from sightline.simulation.shapes.edits import mirrored, painted
from sightline.simulation.shapes.primitives import (
    Color,
    Finish,
    boxes,
    grid,
    kept,
    moved,
    signed_power,
    superellipsoid,
    tube,
    without_slivers,
)

HEAD_RINGS = np.array([  # height, half depth, half width, offset ahead [m], from the neck up
    (1.440, 0.060, 0.066, -0.014), (1.485, 0.054, 0.055, -0.012), (1.525, 0.054, 0.054, -0.006),
    (1.537, 0.074, 0.048, 0.014), (1.562, 0.090, 0.063, 0.012), (1.605, 0.097, 0.074, 0.006),
    (1.655, 0.100, 0.078, 0.001), (1.700, 0.094, 0.074, -0.003), (1.733, 0.070, 0.056, -0.006),
    (1.750, 0.010, 0.010, -0.008),
])  # fmt: skip


Hair = Enum("Hair", "SHORT LONG BALD CAP HELMET", start=0)  # hair or headwear
Legwear = Enum("Legwear", "TROUSERS SHORTS SKIRT", start=0)
Luggage = Enum("Luggage", "NOTHING BACKPACK HANDBAG SHOULDER_BAG", start=0)  # carried luggage


@dataclass(frozen=True, kw_only=True, slots=True)
class Outfit:
    """Clothes, hair and skin."""

    skin: Color
    hair: Color
    hair_style: Hair
    top: Color
    bottom: Color
    shoes: Color
    accent: Color = (0.02, 0.02, 0.02)  # colour of hat and luggage
    short_sleeves: bool = False
    legwear: Legwear = Legwear.TROUSERS
    hem: float = 0.97  # height [m] of the top's hem on a figure of 1.75 m: 0.9 a jacket, 0.6 a coat
    shirt: Color | None = None
    """Colour visible where the top is open in front; None if it is closed."""
    luggage: Luggage = Luggage.NOTHING


CLOTH_SIDES = 16  # columns around trunk and cloth


def front_columns() -> Bool[np.ndarray, " columns"]:
    """Mark the columns of cloth in the middle of the front, where a jacket opens."""
    column = np.arange(CLOTH_SIDES)
    return np.asarray((column == 0) | (column == CLOTH_SIDES - 1))


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

    It reaches down to the height `hem` [m]; `depth` and `width` are half sizes along x and y [m] at
    the hips.
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


# Rings (height, half depth, half width, offset ahead) [m] of the resting figure of 1.75 m.
_TRUNK_RINGS = np.array([
    (0.835, 0.050, 0.080, 0.0), (0.870, 0.105, 0.150, -0.008), (0.940, 0.120, 0.172, -0.014),
    (0.990, 0.115, 0.167, -0.008), (1.000, 0.117, 0.168, -0.006), (1.100, 0.106, 0.150, 0.004),
    (1.210, 0.115, 0.162, 0.006), (1.310, 0.121, 0.181, 0.004), (1.375, 0.108, 0.192, -0.002),
    (1.412, 0.090, 0.184, -0.006), (1.440, 0.074, 0.148, -0.010), (1.463, 0.063, 0.098, -0.011),
    (1.485, 0.059, 0.066, -0.012),
])  # fmt: skip
_LEG_RINGS = np.array([
    (0.058, 0.030, 0.030, -0.005), (0.072, 0.058, 0.052, -0.005), (0.180, 0.055, 0.050, -0.010),
    (0.330, 0.063, 0.057, -0.012), (0.450, 0.062, 0.058, 0.0), (0.520, 0.065, 0.062, 0.002),
    (0.650, 0.077, 0.072, 0.0), (0.800, 0.090, 0.084, 0.0), (0.900, 0.092, 0.086, 0.0),
    (0.950, 0.060, 0.060, 0.0),
])  # fmt: skip
_ARM_RINGS = np.array([
    (0.868, 0.026, 0.024, 0.004), (0.880, 0.035, 0.032, 0.004), (1.000, 0.042, 0.039, 0.002),
    (1.100, 0.044, 0.042, 0.0), (1.150, 0.046, 0.044, 0.0), (1.250, 0.052, 0.048, 0.0),
    (1.335, 0.058, 0.053, -0.002), (1.385, 0.056, 0.053, -0.003), (1.415, 0.044, 0.042, -0.006),
    (1.432, 0.022, 0.022, -0.008),
])  # fmt: skip
_EYE = Finish(Material.SKIN, (0.03, 0.02, 0.02))
_NECK_HEIGHT = 1.49
_CROWN_HEIGHT = 1.765


@dataclass(frozen=True, kw_only=True, slots=True)
class Build:
    """Build of a body."""

    height: float  # height in metres, with hair
    girth: float = 1.0  # thickness of the trunk, 1 on average; the limbs follow partly
    head: float = 1.0  # size of the head relative to the body, 1 for adults
    shoulders: float = 1.0
    hips: float = 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Figure:
    """Clothed body with bones."""

    skinned: Skinned
    joints: Float64[np.ndarray, "num_bones 3"]  # start of each bone [m]


def make_figure(build: Build, outfit: Outfit) -> Figure:
    """Make a figure at rest; its soles stand on the ground."""
    parts = [*_trunk(build, outfit), *_arms(build, outfit), *_legs(build, outfit)]
    parts += _grown_head(build, [*_face(outfit), *headwear(outfit)])
    parts += luggage(outfit, 0.12 * build.girth)
    whole = Skinned.joined(parts)
    scale = build.height / (_NECK_HEIGHT + build.head * (_CROWN_HEIGHT - _NECK_HEIGHT))
    mesh = replace(whole.mesh, vertices=(whole.mesh.vertices * scale).astype(np.float32))
    joints = REST_JOINTS.copy()
    arms = [Bone.LEFT_ARM, Bone.LEFT_FOREARM, Bone.RIGHT_ARM, Bone.RIGHT_FOREARM]
    joints[arms, 1] += np.sign(joints[arms, 1]) * _arm_shift(build)
    return Figure(skinned=replace(whole, mesh=mesh), joints=joints * scale)


def _arm_shift(build: Build) -> float:
    """Compute the additional outward shift of the arms [m] relative to the average."""
    return 0.185 * (build.shoulders - 1) + 0.08 * (build.girth - 1)


def _trunk(build: Build, outfit: Outfit) -> list[Skinned]:
    rings = _TRUNK_RINGS.copy()
    heights = rings[:, 0]
    belly = np.interp(heights, (0.85, 1.10, 1.30, 1.42), (1.0, 1.2, 0.8, 0.3))
    rings[:, 1:3] *= (1 + (build.girth - 1) * belly)[:, None]
    rings[:, 2] *= np.interp(heights, (0.95, 1.10, 1.35), (build.hips, 1.0, build.shoulders))
    rings[:, 3] += 0.10 * (build.girth - 1) * np.interp(heights, (0.9, 1.1, 1.3), (0, 1, 0))
    top, bottom = Finish(Material.CLOTH, outfit.top), Finish(Material.CLOTH, outfit.bottom)
    shirt = Finish(Material.CLOTH, outfit.top if outfit.shirt is None else outfit.shirt)
    cells = np.zeros((len(rings) - 1, CLOTH_SIDES), dtype=np.int64)
    cells[:, front_columns()] = 3
    cells[heights[:-1] < 0.985] = 1
    cells[heights[:-1] > 1.46] = 2
    skin = Finish(Material.SKIN, outfit.skin)
    mesh = grid(ellipse_stack(rings, CLOTH_SIDES, squareness=0.85), top, closed=True)
    mesh = painted(mesh, cells, (top, bottom, skin, shirt))
    parts = [chained(mesh, (Bone.TORSO, Bone.PELVIS), (1.06,), softness=0.08)]
    depth, width = 0.130 * build.girth, 0.182 * build.girth * build.hips
    if outfit.legwear is Legwear.SKIRT:
        parts.append(hanging_cloth(0.55, depth, width, bottom))
    if outfit.hem < 0.96:
        is_open = outfit.shirt is not None
        parts.append(hanging_cloth(outfit.hem, depth + 0.012, width + 0.012, top, is_open=is_open))
    return parts


def _arms(build: Build, outfit: Outfit) -> list[Skinned]:
    rings = _ARM_RINGS.copy()
    rings[:, 1:3] *= build.girth**0.6
    sleeve, skin = Finish(Material.CLOTH, outfit.top), Finish(Material.SKIN, outfit.skin)
    bare = rings[:-1, 0] < (1.20 if outfit.short_sleeves else 0.0)
    if outfit.short_sleeves:
        rings[rings[:, 0] < 1.20, 1:3] *= 0.85
    mesh = grid(_limb(rings, 0.207, 0.172, 9), sleeve, closed=True)
    mesh = painted(mesh, np.tile(bare[:, None].astype(np.int64), (1, 9)), (sleeve, skin))
    hand = superellipsoid(
        (0.010, 0.212, 0.820), (0.040, 0.020, 0.072), skin, num_rings=6, num_sides=8
    )
    thumb = superellipsoid(
        (0.045, 0.205, 0.838), (0.018, 0.014, 0.035), skin, num_rings=4, num_sides=6
    )
    shift, parts = _arm_shift(build), []
    for limbs in (LEFT, RIGHT):
        own = [part if limbs is LEFT else mirrored(part) for part in (mesh, hand, thumb)]
        own = [moved(part, (0, limbs.side * shift, 0)) for part in own]
        chain = (Bone.TORSO, limbs.arm, limbs.forearm)
        parts.append(chained(own[0], chain, (1.43, 1.13)))
        parts += [rigid(part, limbs.forearm) for part in own[1:]]
    return parts


def _legs(build: Build, outfit: Outfit) -> list[Skinned]:
    rings = _LEG_RINGS.copy()
    rings[:, 1:3] *= build.girth**0.5
    bare_to = {Legwear.TROUSERS: 0.0, Legwear.SHORTS: 0.50, Legwear.SKIRT: 0.7}[outfit.legwear]
    bare = rings[:-1, 0] < bare_to
    rings[:-1, 1:3] *= np.where(bare, 0.82, 1.0)[:, None]
    cloth, skin = Finish(Material.CLOTH, outfit.bottom), Finish(Material.SKIN, outfit.skin)
    mesh = grid(_limb(rings, 0.09, 0.09, 10), cloth, closed=True)
    mesh = painted(mesh, np.tile(bare[:, None].astype(np.int64), (1, 10)), (cloth, skin))
    shoe = superellipsoid(
        (0.050, 0.092, 0.042),
        (0.135, 0.047, 0.058),
        Finish(Material.RUBBER, outfit.shoes),
        exponents=(0.75, 0.8),
        num_rings=7,
        num_sides=12,
    )
    shoe = replace(
        shoe, vertices=np.maximum(shoe.vertices, np.array((-9, -9, 0), dtype=np.float32))
    )
    parts = []
    for limbs in (LEFT, RIGHT):
        leg, foot = (part if limbs is LEFT else mirrored(part) for part in (mesh, shoe))
        parts.append(chained(leg, (Bone.PELVIS, limbs.thigh, limbs.shin), (0.93, 0.49)))
        parts.append(rigid(foot, limbs.foot))
    return parts


def _limb(
    rings: Float64[np.ndarray, "num_rings 4"], low_y: float, high_y: float, num_sides: int
) -> Float64[np.ndarray, "num_rings num_sides 3"]:
    """Build a left limb that leans from `high_y` at its top to `low_y` at its bottom."""
    points = ellipse_stack(rings, num_sides)
    share = (rings[:, 0] - rings[0, 0]) / (rings[-1, 0] - rings[0, 0])
    points[:, :, 1] += (low_y + share * (high_y - low_y))[:, None]
    return points


def _face(outfit: Outfit) -> list[Skinned]:
    skin = Finish(Material.SKIN, outfit.skin)
    head = grid(ellipse_stack(HEAD_RINGS, 12), skin, closed=True)
    nose = superellipsoid((0.103, 0, 1.622), (0.018, 0.014, 0.025), skin, num_rings=4, num_sides=6)
    ear = superellipsoid(
        (-0.008, 0.078, 1.625), (0.020, 0.010, 0.030), skin, num_rings=4, num_sides=6
    )
    eyes = np.array([(0.091, side * 0.033, 1.645) for side in (-1, 1)])
    eye = boxes(eyes, np.tile((0.006, 0.014, 0.005), (2, 1)), _EYE)
    rigid_parts = [rigid(part, Bone.HEAD) for part in (nose, ear, mirrored(ear), eye)]
    return [chained(without_slivers(head), (Bone.HEAD, Bone.TORSO), (1.49,)), *rigid_parts]


def _grown_head(build: Build, parts: Sequence[Skinned]) -> list[Skinned]:
    """Scale the head's parts about the neck."""
    neck = np.array((0.0, 0.0, _NECK_HEIGHT))
    return [
        replace(
            part,
            mesh=replace(
                part.mesh,
                vertices=(neck + (part.mesh.vertices - neck) * build.head).astype(np.float32),
            ),
        )
        for part in parts
    ]
