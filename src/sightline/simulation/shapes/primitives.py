"""Basic solids for building meshes.

Units are metres. A row of points runs counter-clockwise about the outward direction: viewed from
outside, columns of a grid run to the right and rows go up, and faces wind counter-clockwise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import SupportsFloat

import numpy as np
from jaxtyping import Bool, Float

from sightline.simulation.scene import Material, Mesh

Color = tuple[float, float, float]  # linear RGB albedo in [0, 1]
Vector = Sequence[SupportsFloat] | Float[np.ndarray, "3"]  # metres along x, y, z

_SMALLEST_AREA = 1e-9  # m^2; cells collapsed to an edge or a pole have smaller triangles


@dataclass(frozen=True, slots=True)
class Finish:
    """Material and colour of a surface."""

    material: Material
    color: Color


def grid(
    points: Float[np.ndarray, "rows columns 3"],
    finish: Finish,
    *,
    closed: bool = False,
    smooth: bool = True,
) -> Mesh:
    """Build the surface through a grid of points, with two triangles per cell.

    Cell (i, j), between rows i and i + 1 and columns j and j + 1, makes faces 2k and 2k + 1 with
    k = i * cells_per_row + j. Texture coordinates are the lengths along the row and the column. The
    last column of a `closed` grid is joined to the first; cells of a `smooth` one share their
    normals at the points. `painted` gives cells several finishes.
    """
    points = np.asarray(points, dtype=np.float64)
    if closed:  # the seam is duplicated; otherwise the texture would run back within one cell
        points = np.concatenate((points, points[:, :1]), axis=1)
    num_rows, num_columns, _ = points.shape
    cell_normals = _cross(points[1:, 1:] - points[:-1, :-1], points[1:, :-1] - points[:-1, 1:])
    index = np.arange(num_rows * num_columns).reshape(num_rows, num_columns)
    corners = np.stack((index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]), axis=-1)
    corners = corners.reshape(-1, 4)
    uvs = _lengths(points)
    if smooth:
        normals = _shared_normals(cell_normals, closed=closed).reshape(-1, 3)
        vertices, uvs = points.reshape(-1, 3), uvs.reshape(-1, 2)
    else:
        vertices, uvs = points.reshape(-1, 3)[corners.ravel()], uvs.reshape(-1, 2)[corners.ravel()]
        normals = np.repeat(cell_normals.reshape(-1, 3), 4, axis=0)
        corners = np.arange(len(vertices)).reshape(-1, 4)
    faces = corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return _mesh(vertices, normals, uvs, faces, finish)


def loft(
    rings: Float[np.ndarray, "num_rings num_sides 3"], finish: Finish, *, capped: bool = True
) -> Mesh:
    """Build the skin over closed rings, which run counter-clockwise viewed from the last ring.

    Caps are flat fans about the middles of the end rings.
    """
    if not capped:
        return grid(rings, finish, closed=True)
    rings = np.asarray(rings, dtype=np.float64)
    num_sides = rings.shape[1]
    middles = np.repeat(rings[[0, -1]].mean(axis=1, keepdims=True), num_sides, axis=1)
    # The end rings are duplicated, so that caps and sides do not share normals.
    rows = np.concatenate((middles[:1], rings[:1], rings, rings[-1:], middles[1:]))
    skin = grid(rows, finish, closed=True)
    solid = np.ones((len(rings) + 3, num_sides, 2), dtype=bool)
    solid[[1, -2]] = False
    solid[0, :, 0] = False
    solid[-1, :, 1] = False
    return kept(skin, solid.ravel())


def polygon(corners: Float[np.ndarray, "num_corners 3"], finish: Finish) -> Mesh:
    """Build a flat, star-shaped polygon; its corners run counter-clockwise from outside."""
    corners = np.asarray(corners, dtype=np.float64)
    vertices = np.concatenate((corners, corners.mean(axis=0, keepdims=True)))
    following = np.roll(corners, -1, axis=0)
    normal = _cross(corners - vertices[-1], following - vertices[-1]).sum(axis=0)
    normals = np.broadcast_to(normal, vertices.shape)
    across = corners[0] - vertices[-1]
    axes = np.stack((across, _cross(normal, across)))
    axes /= np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-12)
    uvs = (vertices - vertices[-1]) @ axes.T
    count = np.arange(len(corners))
    faces = np.stack((count, np.roll(count, -1), np.full_like(count, len(corners))), axis=1)
    return _mesh(vertices, normals, uvs, faces, finish)


def quads(corners: Float[np.ndarray, "num_quads 4 3"], finish: Finish) -> Mesh:
    """Build flat rectangles; their corners run counter-clockwise from outside."""
    first, second, _, last = np.moveaxis(np.asarray(corners, dtype=np.float64), 1, 0)
    along, up = second - first, last - first
    normals = np.repeat(_cross(along, up), 4, axis=0)
    sides = np.stack((np.linalg.norm(along, axis=1), np.linalg.norm(up, axis=1)), axis=1)
    uvs = (sides[:, None] * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])).reshape(-1, 2)
    starts = np.arange(len(corners))[:, None, None] * 4
    faces = (starts + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return _mesh(corners.reshape(-1, 3), normals, uvs, faces, finish)


def boxes(
    centers: Float[np.ndarray, "num_boxes 3"],
    half_sizes: Float[np.ndarray, "num_boxes 3"],
    finish: Finish,
) -> Mesh:
    """Build upright cuboids."""
    centers, half_sizes = np.asarray(centers, np.float64), np.asarray(half_sizes, np.float64)
    vertices = centers[:, None] + half_sizes[:, None] * _BOX_CORNERS
    scaled = np.abs(half_sizes[:, None, :]) * _BOX_CORNERS
    u, v = (scaled[:, np.arange(24), axis] for axis in _BOX_UV)
    faces = (np.arange(len(centers))[:, None, None] * 24 + _BOX_FACES).reshape(-1, 3)
    normals = np.tile(_BOX_NORMALS, (len(centers), 1))
    uvs = np.stack((u, v), axis=-1).reshape(-1, 2)
    return _mesh(vertices.reshape(-1, 3), normals, uvs, faces, finish)


def box(center: Vector, half_size: Vector, finish: Finish) -> Mesh:
    """Build one upright cuboid."""
    return boxes(np.array([center], float), np.array([half_size], float), finish)


def tube(
    path: Float[np.ndarray, "num_points 3"] | Sequence[Vector],
    radii: float | Sequence[SupportsFloat],
    finish: Finish,
    *,
    num_sides: int = 8,
    capped: bool = True,
) -> Mesh:
    """Build a round rod along a path, with one radius [m] or one for each point."""
    points = np.asarray(path, dtype=np.float64)
    along = np.gradient(points, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    # The axis least along the path rotates least about it, so that rings do not twist.
    reference = np.eye(3)[np.abs(along).max(axis=0).argmin()]
    first = _cross(reference, along)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = _cross(along, first)
    angles = np.arange(num_sides) * (2 * np.pi / num_sides)
    circle = np.cos(angles)[:, None] * first[:, None] + np.sin(angles)[:, None] * second[:, None]
    radius = np.broadcast_to(np.asarray(radii, dtype=np.float64), len(points))
    return loft(points[:, None] + radius[:, None, None] * circle, finish, capped=capped)


def rods(
    starts: Float[np.ndarray, "num_rods 3"] | Sequence[Vector],
    ends: Float[np.ndarray, "num_rods 3"] | Sequence[Vector],
    radii: float | Sequence[SupportsFloat],
    finish: Finish,
    *,
    num_sides: int = 7,
) -> Mesh:
    """Build straight round rods, open at the ends, of one radius [m] or one each."""
    starts, ends = np.asarray(starts, np.float64), np.asarray(ends, np.float64)
    lengths = np.linalg.norm(ends - starts, axis=1, keepdims=True)
    along = (ends - starts) / lengths
    reference = np.eye(3)[np.abs(along).argmin(axis=1)]
    first = _cross(reference, along)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = _cross(along, first)
    angles = np.arange(num_sides + 1)[:, None] * (2 * np.pi / num_sides)
    outward = np.cos(angles) * first[:, None] + np.sin(angles) * second[:, None]
    radius = np.broadcast_to(np.asarray(radii, np.float64), len(starts))[:, None, None]
    circles = np.stack((starts[:, None] + radius * outward, ends[:, None] + radius * outward), 1)
    uvs = np.zeros((*circles.shape[:3], 2))
    uvs[..., 0] = radius * angles[:, 0]
    uvs[:, 1, :, 1] = lengths
    index = np.arange(circles[..., 0].size).reshape(circles.shape[:3])
    low, high = index[:, 0], index[:, 1]
    corners = np.stack((low[:, :-1], low[:, 1:], high[:, 1:], high[:, :-1]), -1).reshape(-1, 4)
    faces = corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    normals = np.repeat(outward[:, None], 2, axis=1).reshape(-1, 3)
    return _mesh(circles.reshape(-1, 3), normals, uvs.reshape(-1, 2), faces, finish)


def superellipsoid(
    center: Vector,
    radii: Vector,
    finish: Finish,
    *,
    exponents: tuple[float, float] = (1.0, 1.0),
    num_rings: int = 9,
    num_sides: int = 14,
) -> Mesh:
    """Build an ellipsoid (exponents 1), or a box with round edges (exponents near 0).

    `radii` are half sizes. The exponents apply to the outline from the side and from above; rings
    run from pole to pole, sides around.
    """
    unit = _unit_superellipsoid(exponents, num_rings, num_sides)
    half_sizes = np.asarray(radii, dtype=np.float64)
    girth = half_sizes[:2].mean()
    uvs = unit.uvs * np.array([girth, (girth + half_sizes[2]) / 2])
    vertices = unit.vertices * half_sizes + np.asarray(center)
    return _mesh(vertices, unit.normals / half_sizes, uvs, unit.faces, finish)


@lru_cache(maxsize=64)
def _unit_superellipsoid(exponents: tuple[float, float], num_rings: int, num_sides: int) -> Mesh:
    """Build one with half sizes of 1 at the origin; cached, as many in vehicles are equal."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, num_rings)[:, None]
    longitude = np.arange(num_sides) * (2 * np.pi / num_sides)
    around = signed_power(np.cos(latitude), exponents[0])
    points = np.stack(
        (
            around * signed_power(np.cos(longitude), exponents[1]),
            around * signed_power(np.sin(longitude), exponents[1]),
            signed_power(np.sin(latitude), exponents[0]) * np.ones(num_sides),
        ),
        axis=-1,
    )
    return without_slivers(grid(points, Finish(Material.PLASTIC, (0.0, 0.0, 0.0)), closed=True))


def torus(
    center: Vector,
    radius: float,
    tube_radius: float,
    finish: Finish,
    *,
    num_sides: int = 24,
    num_tube_sides: int = 6,
) -> Mesh:
    """Build a ring about the y axis."""
    angles = np.linspace(0, 2 * np.pi, num_tube_sides + 1)
    profile = np.stack((radius + tube_radius * np.cos(angles), tube_radius * np.sin(angles)), 1)
    return moved(lathe(profile, finish, num_sides=num_sides), center)


def lathe(
    profile: Float[np.ndarray, "num_points 2"], finish: Finish, *, num_sides: int = 24
) -> Mesh:
    """Rotate (radius, y) points about the y axis; from outside, the profile starts at the bottom.

    A profile that runs towards +y at a positive radius thus has its outside away from the axis.
    """
    angles = -np.arange(num_sides) * (2 * np.pi / num_sides)
    radius, y = profile[:, :1], profile[:, 1:]
    rings = np.stack(
        (radius * np.cos(angles), y * np.ones(num_sides), radius * np.sin(angles)), axis=-1
    )
    return without_slivers(grid(rings, finish, closed=True))


def disc(
    center: Vector, normal: Vector, radius: float, finish: Finish, *, num_sides: int = 16
) -> Mesh:
    """Build a flat circle that faces along `normal`."""
    axis = np.asarray(normal, dtype=np.float64)
    axis = axis / np.linalg.norm(axis)
    first = _cross(axis, np.eye(3)[np.abs(axis).argmin()])
    first /= np.linalg.norm(first)
    angles = np.arange(num_sides)[:, None] * (2 * np.pi / num_sides)
    circle = np.cos(angles) * first + np.sin(angles) * _cross(axis, first)
    return polygon(np.asarray(center) + radius * circle, finish)


def repainted(mesh: Mesh, selected: Bool[np.ndarray, " num_faces"], finish: Finish) -> Mesh:
    """Change the finish of the selected faces."""
    materials = np.where(selected, np.int32(finish.material), mesh.materials)
    colors = np.where(selected[:, None], np.array(finish.color, np.float32), mesh.colors)
    return replace(mesh, materials=materials, colors=colors)


def moved(mesh: Mesh, offset: Vector) -> Mesh:
    """Move the mesh by `offset` [m]."""
    return replace(mesh, vertices=(mesh.vertices + np.asarray(offset)).astype(np.float32))


def kept(mesh: Mesh, selected: Bool[np.ndarray, " num_faces"]) -> Mesh:
    """Keep only the selected faces; all vertices stay."""
    return replace(
        mesh,
        faces=mesh.faces[selected],
        materials=mesh.materials[selected],
        colors=mesh.colors[selected],
    )


def without_slivers(mesh: Mesh) -> Mesh:
    """Remove triangles without area."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return kept(mesh, np.square(_cross(b - a, c - a)).sum(axis=1) > _SMALLEST_AREA**2)


def signed_power(
    values: Float[np.ndarray, "*shape"], exponent: float
) -> Float[np.ndarray, "*shape"]:
    """Compute the power of the magnitude with the value's sign, for superellipses."""
    return np.asarray(np.sign(values) * np.abs(values) ** exponent)


def _mesh(
    vertices: Float[np.ndarray, "num_vertices 3"],
    normals: Float[np.ndarray, "num_vertices 3"],
    uvs: Float[np.ndarray, "num_vertices 2"],
    faces: np.ndarray,
    finish: Finish,
) -> Mesh:
    """Build a mesh of one finish; normals may have any length, and zero normals become upward."""
    lengths = np.sqrt(np.square(normals).sum(axis=1, keepdims=True))
    vanishing = lengths < 1e-14
    units = np.where(vanishing, (0.0, 0.0, 1.0), normals / np.where(vanishing, 1.0, lengths))
    return Mesh(
        vertices=np.ascontiguousarray(vertices, dtype=np.float32),
        normals=units.astype(np.float32),
        uvs=uvs.astype(np.float32),
        faces=np.ascontiguousarray(faces, dtype=np.int32),
        materials=np.full(len(faces), finish.material, dtype=np.int32),
        colors=np.tile(np.array(finish.color, np.float32), (len(faces), 1)),
    )


def _shared_normals(
    cell_normals: Float[np.ndarray, "cell_rows cell_columns 3"], *, closed: bool
) -> Float[np.ndarray, "rows columns 3"]:
    """Compute normals at the points of a grid: area-weighted sums over the cells around them."""
    rows, columns, _ = cell_normals.shape
    padded = np.zeros((rows + 2, columns + 2, 3))
    padded[1:-1, 1:-1] = cell_normals
    if closed:
        padded[:, 0], padded[:, -1] = padded[:, -2], padded[:, 1]
    padded[:-1] += padded[1:]
    padded[:, :-1] += padded[:, 1:]
    return padded[:-1, :-1]


def _cross(
    first: Float[np.ndarray, "*#shape 3"], second: Float[np.ndarray, "*#shape 3"]
) -> Float[np.ndarray, "*_ 3"]:
    """Compute the cross product, several times faster than numpy's for one part's small arrays."""
    ax, ay, az = first[..., 0], first[..., 1], first[..., 2]
    bx, by, bz = second[..., 0], second[..., 1], second[..., 2]
    product = np.empty(np.broadcast_shapes(first.shape, second.shape))
    product[..., 0] = ay * bz - az * by
    product[..., 1] = az * bx - ax * bz
    product[..., 2] = ax * by - ay * bx
    return product


def _lengths(points: Float[np.ndarray, "rows columns 3"]) -> Float[np.ndarray, "rows columns 2"]:
    """Compute the distance of each point along its row and along its column [m]."""
    uvs = np.zeros((*points.shape[:2], 2))
    steps = np.sqrt(np.square(np.diff(points, axis=1)).sum(axis=2))
    np.cumsum(steps, axis=1, out=uvs[:, 1:, 0])
    steps = np.sqrt(np.square(np.diff(points, axis=0)).sum(axis=2))
    np.cumsum(steps, axis=0, out=uvs[1:, :, 1])
    return uvs


def _unit_box() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Build corners, normals, faces and texture axes of a cube from -1 to 1, 4 corners a side."""
    corners, normals, axes = np.zeros((6, 4, 3)), np.zeros((6, 4, 3)), np.zeros((6, 4, 2), int)
    for side, (axis, sign) in enumerate((axis, sign) for axis in range(3) for sign in (-1, 1)):
        corners[side, :, axis] = normals[side, :, axis] = sign
        corners[side, :, (axis + 1) % 3] = np.array([-1, 1, 1, -1]) * sign
        corners[side, :, (axis + 2) % 3] = [-1, -1, 1, 1]
        axes[side] = (1 if axis == 0 else 0, 1 if axis == 2 else 2)
    faces = np.arange(6)[:, None, None] * 4 + np.array([[0, 1, 2], [0, 2, 3]])
    return (
        corners.reshape(-1, 3),
        normals.reshape(-1, 3),
        faces.reshape(-1, 3),
        axes.reshape(-1, 2).T,
    )


_BOX_CORNERS, _BOX_NORMALS, _BOX_FACES, _BOX_UV = _unit_box()
