"""Edits and copies of meshes: painting, turning, mirroring, stretching, and many rectangles."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Float64, Int

from sightline.simulation.arrays import AnyPoints
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.primitives import Color, Finish, Vector, moved


def painted(mesh: Mesh, cells: Int[np.ndarray, "rows columns"], palette: Sequence[Finish]) -> Mesh:
    """Paint a `grid` with the finishes that `cells` selects from the palette."""
    picked = np.repeat(cells.ravel(), 2)
    materials = np.array([finish.material for finish in palette], dtype=np.int32)
    colors = np.array([finish.color for finish in palette], dtype=np.float32)
    return replace(mesh, materials=materials[picked], colors=colors[picked])


def turned(mesh: Mesh, rotation: Float64[np.ndarray, "3 3"]) -> Mesh:
    """Rotate the mesh about the origin."""
    return replace(
        mesh,
        vertices=(mesh.vertices @ rotation.T).astype(np.float32),
        normals=(mesh.normals @ rotation.T).astype(np.float32),
    )


def mirrored(mesh: Mesh) -> Mesh:
    """Mirror the mesh in the xz plane, like left and right of a vehicle."""
    flip = np.array([1, -1, 1], dtype=np.float32)
    faces = np.ascontiguousarray(mesh.faces[:, ::-1])
    return replace(mesh, vertices=mesh.vertices * flip, normals=mesh.normals * flip, faces=faces)


def both_sides(*parts: Mesh) -> Mesh:
    """Join the parts and their mirror images."""
    own = Mesh.joined(parts)
    return Mesh.joined((own, mirrored(own)))


def fitted(mesh: Mesh, size_lwh: Vector) -> Mesh:
    """Stretch the mesh to fill exactly the upright box of a size [m] over the origin."""
    low, high = mesh.vertices.min(axis=0).astype(np.float64), mesh.vertices.max(axis=0)
    length, width, height = np.asarray(size_lwh, np.float64)
    centred = moved(mesh, (-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]))
    ends, scale = np.array([-0.5, 0.5]), (width / (high - low)[1], height / (high - low)[2])
    return stretched(centred, ends * (high - low)[0], ends * length, scale)


def stretched(
    mesh: Mesh,
    knots: Float64[np.ndarray, " num_knots"],
    places: Float64[np.ndarray, " num_knots"],
    scale_yz: tuple[float, float],
) -> Mesh:
    """Change the mesh's lengths between places along x, its width and its height.

    The ordered `knots` move to `places` [m], and parts beyond the ends with them; `scale_yz` are
    factors.
    """
    knots = np.array([knots[0] - 1, *knots, knots[-1] + 1])
    places = np.array([places[0] - 1, *places, places[-1] + 1])
    x = mesh.vertices[:, 0]
    between = np.clip(np.searchsorted(knots, x), 1, len(knots) - 1) - 1
    slope = (np.diff(places) / np.diff(knots))[between]
    vertices = mesh.vertices * np.array([1.0, *scale_yz], np.float32)
    vertices[:, 0] = places[between] + slope * (x - knots[between])
    normals = mesh.normals / np.array([1.0, *scale_yz], np.float32)
    normals[:, 0] /= slope
    normals /= np.sqrt(np.square(normals).sum(axis=1, keepdims=True))
    return replace(mesh, vertices=vertices, normals=normals)


EMPTY: Final = Mesh(
    vertices=np.zeros((0, 3), np.float32),
    normals=np.zeros((0, 3), np.float32),
    uvs=np.zeros((0, 2), np.float32),
    faces=np.zeros((0, 3), np.int32),
    materials=np.zeros(0, np.int32),
    colors=np.zeros((0, 3), np.float32),
)
"""An empty mesh."""

_UNIT_UVS: Final = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)


class QuadBatch:
    """Flat rectangles, collected in any frames and then converted to one mesh of the world."""

    def __init__(self) -> None:
        self._corners: list[np.ndarray] = []
        self._uvs: list[np.ndarray | None] = []
        self._colors: list[np.ndarray | Color] = []
        self._materials: list[int] = []
        self._frames: list[tuple[float, float, float, float]] = [(0.0, 0.0, 0.0, 0.0)]
        self._frame_of: list[int] = []

    def use_frame(self, x: float, y: float, z: float, yaw: float) -> None:
        """Set the frame of the following parts: rotated by `yaw` [rad] about z, then moved."""
        self._frames.append((x, y, z, yaw))

    def use_world(self) -> None:
        """Set the world's frame for the following parts."""
        self._frames.append(self._frames[0])

    def add(
        self,
        corners: Float[np.ndarray, "num_quads 4 3"],
        finish: Finish,
        *,
        colors: Float[np.ndarray, "num_quads 3"] | None = None,
        uvs: Float[np.ndarray, "num_quads 4 2"] | None = None,
    ) -> None:
        """Add rectangles with corners counter-clockwise when viewed from outside.

        The first edge runs along u, the last one along v; two coincident corners make a triangle.
        `colors` replace the finish's; `uvs` [m] start at each rectangle's first corner by default.
        """
        if len(corners) == 0:
            return
        self._corners.append(corners)
        self._uvs.append(uvs)
        self._colors.append(finish.color if colors is None else colors)
        self._materials.append(int(finish.material))
        self._frame_of.append(len(self._frames) - 1)

    def mesh(self) -> Mesh:
        """Build the mesh of all rectangles added so far."""
        if not self._corners:
            return EMPTY
        counts = np.array([len(corners) for corners in self._corners])
        local = np.concatenate(self._corners).astype(np.float64, copy=False)
        frames = np.array(self._frames)[np.repeat(self._frame_of, counts)][:, None]
        cos, sin = np.cos(frames[..., 3]), np.sin(frames[..., 3])
        corners = np.empty_like(local)
        corners[..., 0] = frames[..., 0] + local[..., 0] * cos - local[..., 1] * sin
        corners[..., 1] = frames[..., 1] + local[..., 0] * sin + local[..., 1] * cos
        corners[..., 2] = frames[..., 2] + local[..., 2]
        normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = np.where(lengths > 1e-12, normals / np.maximum(lengths, 1e-12), (0.0, 0.0, 1.0))
        starts = np.arange(len(corners))[:, None, None] * 4
        faces = (starts + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
        colors = np.empty((len(corners), 3), np.float32)
        stops = np.cumsum(counts)
        for start, stop, color in zip(stops - counts, stops, self._colors, strict=True):
            colors[start:stop] = color
        return Mesh(
            vertices=corners.reshape(-1, 3).astype(np.float32),
            normals=np.repeat(normals, 4, axis=0).astype(np.float32),
            uvs=self._all_uvs(corners, counts).reshape(-1, 2),
            faces=faces.astype(np.int32),
            materials=np.repeat(np.array(self._materials, np.int32), 2 * counts),
            colors=np.repeat(colors, 2, axis=0),
        )

    def _all_uvs(
        self, corners: Float[np.ndarray, "num_quads 4 3"], counts: np.ndarray
    ) -> Float32[np.ndarray, "num_quads 4 2"]:
        along = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
        up = np.linalg.norm(corners[:, 3] - corners[:, 0], axis=1)
        uvs = (np.stack((along, up), axis=1)[:, None] * _UNIT_UVS).astype(np.float32)
        stops = np.cumsum(counts)
        for start, stop, own in zip(stops - counts, stops, self._uvs, strict=True):
            if own is not None:
                uvs[start:stop] = own
        return uvs


def box_corners(
    centers: Float[np.ndarray, "num_boxes 3"],
    half_sizes: Float[np.ndarray, "num_boxes 3"],
    yaws: Float[np.ndarray, " num_boxes"],
) -> Float64[np.ndarray, "num_quads 4 3"]:
    """Compute sides and top of upright boxes turned about z, five rectangles each."""
    count = len(centers)
    scaled = half_sizes[:, None, None] * _OPEN_BOX
    cos, sin = np.cos(yaws)[:, None, None], np.sin(yaws)[:, None, None]
    turned = np.stack(
        (
            scaled[..., 0] * cos - scaled[..., 1] * sin,
            scaled[..., 0] * sin + scaled[..., 1] * cos,
            scaled[..., 2],
        ),
        axis=-1,
    )
    return np.asarray((turned + np.asarray(centers)[:, None, None]).reshape(count * 5, 4, 3))


_OPEN_BOX: Final = np.array(
    [
        [[-1, -1, -1], [1, -1, -1], [1, -1, 1], [-1, -1, 1]],
        [[1, -1, -1], [1, 1, -1], [1, 1, 1], [1, -1, 1]],
        [[1, 1, -1], [-1, 1, -1], [-1, 1, 1], [1, 1, 1]],
        [[-1, 1, -1], [-1, -1, -1], [-1, -1, 1], [-1, 1, 1]],
        [[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]],
    ],
    dtype=np.float64,
)


def stamped(
    mesh: Mesh,
    places: AnyPoints,
    yaws: Float[np.ndarray, " count"],
    *,
    scales: AnyPoints | None = None,
    tints: AnyPoints | None = None,
    tinted: Sequence[Material] = (),
) -> Mesh:
    """Copy a mesh to `places`: stretched along its own axes, turned about z by `yaws` [rad], moved.

    `tints` are factors for the colours of faces of the `tinted` materials.
    """
    count = len(places)
    if count == 0:
        return EMPTY
    scales = np.ones((count, 3)) if scales is None else scales
    rotations = np.zeros((count, 3, 3))
    rotations[:, 0, 0] = rotations[:, 1, 1] = np.cos(yaws)
    rotations[:, 1, 0], rotations[:, 0, 1] = np.sin(yaws), -np.sin(yaws)
    rotations[:, 2, 2] = 1.0
    stretch = (rotations * scales[:, None, :]).astype(np.float32)
    vertices = mesh.vertices @ stretch.transpose(0, 2, 1)
    vertices += np.asarray(places, np.float32)[:, None]
    bend = (rotations / scales[:, None, :]).astype(np.float32)
    normals = mesh.normals @ bend.transpose(0, 2, 1)
    normals /= np.sqrt(np.einsum("cni,cni->cn", normals, normals))[..., None]
    shifts = (np.arange(count) * len(mesh.vertices))[:, None, None]
    colors = np.broadcast_to(mesh.colors, (count, *mesh.colors.shape))
    if tints is not None:
        takes = np.isin(mesh.materials, np.array(tinted, dtype=np.int32))[None, :, None]
        colors = np.clip(np.where(takes, colors * tints[:, None], colors), 0.0, 1.0)
    return Mesh(
        vertices=vertices.reshape(-1, 3),
        normals=normals.reshape(-1, 3),
        uvs=np.tile(mesh.uvs, (count, 1)),
        faces=(mesh.faces + shifts).reshape(-1, 3).astype(np.int32),
        materials=np.tile(mesh.materials, count),
        colors=colors.reshape(-1, 3).astype(np.float32),
    )
