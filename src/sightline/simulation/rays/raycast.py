"""Embree 4, called through the library in the package `embreex`.

The classes of `embreex` are not used: they copy a mesh number by number, which takes longer than
all of Embree's work, and cast rays one by one (`benchmarks/raycast.py`).
"""

import ctypes
import functools
import sys
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple, NoReturn

import numpy as np
from jaxtyping import Bool, Float32, Int32

from sightline.files.extras import import_library
from sightline.ops.compiled import compiled
from sightline.simulation.arrays import RayRows, RayValues, RayVectors
from sightline.simulation.scene import Mesh


@functools.cache
def embree_library() -> ctypes.CDLL:
    """Load the library and declare its functions.

    Raises:
        ValueError: `embreex` is not installed.
        ImportError: If this `embreex` does not bring Embree along as a library.
    """
    pointer, number, size = ctypes.c_void_p, ctypes.c_uint, ctypes.c_size_t
    ray_query = (None, (pointer, pointer, pointer, pointer))
    declarations = {
        "rtcNewDevice": (pointer, (ctypes.c_char_p,)),
        "rtcGetDeviceError": (number, (pointer,)),
        "rtcNewScene": (pointer, (pointer,)),
        "rtcCommitScene": (None, (pointer,)),
        "rtcReleaseScene": (None, (pointer,)),
        "rtcNewGeometry": (pointer, (pointer, number)),
        "rtcSetNewGeometryBuffer": (pointer, (pointer, number, number, number, size, size)),
        "rtcCommitGeometry": (None, (pointer,)),
        "rtcAttachGeometry": (number, (pointer, pointer)),
        "rtcReleaseGeometry": (None, (pointer,)),
        "rtcIntersect8": ray_query,
        "rtcOccluded8": ray_query,
    }
    try:
        library = ctypes.CDLL(str(_library_file()))
        for name, (result, arguments) in declarations.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
    except (OSError, AttributeError) as error:
        raise ImportError(
            f"no Embree 4 library in the package embreex ({error}): install embreex 4.4"
        ) from error
    return library


def _library_file() -> Path:
    file = import_library("embreex.rtcore_scene", "simulate").__file__
    assert file is not None, "embreex is compiled into a file"
    module = Path(file)
    if sys.platform == "win32":
        return module.parents[1] / "embreex.libs" / "embree4.dll"
    return module  # elsewhere a library also resolves its dependencies' symbols


@functools.cache
def embree_device() -> int:
    """Create an Embree device with one thread: frames are spread over processes.

    Raises:
        RuntimeError: If Embree cannot start here.
    """
    library = embree_library()
    device: int | None = library.rtcNewDevice(b"threads=1")
    if device is None:
        raise RuntimeError(f"Embree could not start: error {library.rtcGetDeviceError(None)}")
    return device


_LANES: Final = 8  # rays per packet
_ALIGNMENT: Final = 64
# Rows of an RTCRayHit8; each holds one number per lane.
_ORIGIN, _NEAR, _DIRECTION, _TIME, _FAR, _MASK, _ID, _FLAGS = 0, 3, 4, 7, 8, 9, 10, 11
_U, _V, _PRIMITIVE, _GEOMETRY, _INSTANCE = 15, 16, 17, 18, 19
_ROWS: Final = 24  # with room to spare

_TRIANGLES: Final = 0  # RTC_GEOMETRY_TYPE_TRIANGLE
_FACE_BUFFER, _VERTEX_BUFFER = 0, 1  # RTC_BUFFER_TYPE_INDEX, RTC_BUFFER_TYPE_VERTEX
_UINT3, _FLOAT3 = 0x5003, 0x9003  # RTC_FORMAT_UINT3, RTC_FORMAT_FLOAT3
_EVERY_FEATURE: Final = 0xFFFFFFFF  # RTC_FEATURE_FLAG_ALL
_INCOHERENT, _COHERENT = 0, 1 << 16  # RTC_RAY_QUERY_FLAG_...


class _QueryArguments(ctypes.Structure):
    """RTCIntersectArguments, and RTCOccludedArguments of the same layout."""

    _fields_ = (
        ("flags", ctypes.c_uint),
        ("feature_mask", ctypes.c_uint),
        ("context", ctypes.c_void_p),
        ("filter", ctypes.c_void_p),
        ("intersect", ctypes.c_void_p),
    )


_QUERIES: Final = {
    coherent: _QueryArguments(flags=flags, feature_mask=_EVERY_FEATURE)
    for coherent, flags in ((False, _INCOHERENT), (True, _COHERENT))
}


class _Packet(NamedTuple):
    """Memory of an RTCRayHit8."""

    floats: Float32[np.ndarray, "24 8"]
    integers: Int32[np.ndarray, "24 8"]  # the same memory as integers
    active: Int32[np.ndarray, "8"]  # -1 for lanes with a ray, otherwise 0


class EmbreeScene:
    """Triangles for ray casting; usable only in the process that made the scene."""

    def __init__(
        self,
        vertices: Float32[np.ndarray, "num_vertices 3"],
        faces: Int32[np.ndarray, "num_faces 3"],
    ) -> None:
        """Copy a mesh and build Embree's search tree over it.

        Raises:
            ValueError: A face refers to a vertex that does not exist.
            RuntimeError: Embree reports an error, for example out of memory.
        """
        if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise ValueError(
                f"faces must name vertices 0 to {len(vertices) - 1}, got {faces.min()} to "
                f"{faces.max()}"
            )
        library, device = embree_library(), embree_device()
        self._address: int = library.rtcNewScene(device)
        weakref.finalize(self, library.rtcReleaseScene, self._address)
        if len(faces):
            geometry = library.rtcNewGeometry(device, _TRIANGLES)
            _copy_rows(
                geometry, _VERTEX_BUFFER, _FLOAT3, np.ascontiguousarray(vertices, np.float32)
            )
            _copy_rows(geometry, _FACE_BUFFER, _UINT3, np.ascontiguousarray(faces, np.int32))
            library.rtcCommitGeometry(geometry)
            library.rtcAttachGeometry(self._address, geometry)
            library.rtcReleaseGeometry(geometry)
        library.rtcCommitScene(self._address)
        error = library.rtcGetDeviceError(device)
        if error:
            raise RuntimeError(f"Embree could not take a mesh of {len(faces)} faces: error {error}")

    def __reduce__(self) -> NoReturn:
        """Refuse copies and pickling: Embree owns the triangles, not Python."""
        raise TypeError("an EmbreeScene cannot be copied or pickled: build it from its mesh")

    def intersect(
        self, origins: RayVectors, directions: RayVectors, *, coherent: bool
    ) -> tuple[RayRows, RayValues, Float32[np.ndarray, "num_rays 2"]]:
        """Find face, distance, u and v of each ray's first hit: -1, inf and 0 if there is none.

        Rays are `coherent` if eight in a row have nearly the same direction.
        """
        count = _count(origins, directions)
        faces, distances = np.empty(count, np.int32), np.empty(count, np.float32)
        barycentric = np.empty((count, 2), np.float32)
        query = ctypes.addressof(_QUERIES[coherent])
        _intersect(
            embree_library().rtcIntersect8,
            self._address,
            query,
            _packet(),
            origins,
            directions,
            faces,
            distances,
            barycentric,
        )
        return faces, distances, barycentric

    def occluded(
        self, origins: RayVectors, directions: RayVectors, max_distance: float, *, coherent: bool
    ) -> Bool[np.ndarray, " num_rays"]:
        """Test whether each ray meets anything within `max_distance`, in units of its direction."""
        hidden = np.empty(_count(origins, directions), np.bool_)
        query = ctypes.addressof(_QUERIES[coherent])
        _occluded(
            embree_library().rtcOccluded8,
            self._address,
            query,
            _packet(),
            origins,
            directions,
            max_distance,
            hidden,
        )
        return hidden


def _copy_rows(geometry: int, buffer: int, form: int, rows: np.ndarray) -> None:
    row_bytes = rows.itemsize * rows.shape[1]
    place = embree_library().rtcSetNewGeometryBuffer(
        geometry, buffer, 0, form, row_bytes, len(rows)
    )
    if place:
        ctypes.memmove(place, rows.ctypes.data, rows.nbytes)


def _count(origins: np.ndarray, directions: np.ndarray) -> int:
    """Count the rays and check their shapes; the kernels below read memory unchecked."""
    if not origins.shape == directions.shape == (len(origins), 3):
        raise ValueError(
            f"rays need an origin and a direction of 3 numbers each, got arrays of {origins.shape} "
            f"and {directions.shape}"
        )
    return len(origins)


def _packet() -> _Packet:
    size = 4 * _LANES * (_ROWS + 1)
    memory = np.zeros(size + _ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % _ALIGNMENT
    floats = memory[start : start + size].view(np.float32).reshape(_ROWS + 1, _LANES)
    integers = floats.view(np.int32)
    return _Packet(floats[:_ROWS], integers[:_ROWS], integers[_ROWS])


@compiled
def _fill(
    packet: _Packet, first: int, origins: RayVectors, directions: RayVectors, far: float
) -> None:
    """Fill a packet with rays, starting at row `first`."""
    for lane in range(min(_LANES, origins.shape[0] - first)):
        for axis in range(3):
            packet.floats[_ORIGIN + axis, lane] = origins[first + lane, axis]
            packet.floats[_DIRECTION + axis, lane] = directions[first + lane, axis]
    for lane in range(_LANES):
        packet.active[lane] = -1 if first + lane < origins.shape[0] else 0
        packet.floats[_NEAR, lane] = packet.floats[_TIME, lane] = 0.0
        packet.floats[_FAR, lane] = far
        packet.integers[_MASK, lane] = -1
        packet.integers[_ID, lane] = packet.integers[_FLAGS, lane] = 0
        packet.integers[_PRIMITIVE, lane] = packet.integers[_GEOMETRY, lane] = -1
        packet.integers[_INSTANCE, lane] = -1
        packet.floats[_U, lane] = packet.floats[_V, lane] = 0.0


@compiled
def _intersect(
    intersect8: Callable[..., None],
    scene: int,
    query: int,
    packet: _Packet,
    origins: RayVectors,
    directions: RayVectors,
    faces: RayRows,
    distances: RayValues,
    barycentric: Float32[np.ndarray, "num_rays 2"],
) -> None:
    for first in range(0, origins.shape[0], _LANES):
        _fill(packet, first, origins, directions, np.inf)
        intersect8(packet.active.ctypes, scene, packet.floats.ctypes, query)
        for lane in range(min(_LANES, origins.shape[0] - first)):
            faces[first + lane] = packet.integers[_PRIMITIVE, lane]
            distances[first + lane] = packet.floats[_FAR, lane]
            barycentric[first + lane, 0] = packet.floats[_U, lane]
            barycentric[first + lane, 1] = packet.floats[_V, lane]


@compiled
def _occluded(
    occluded8: Callable[..., None],
    scene: int,
    query: int,
    packet: _Packet,
    origins: RayVectors,
    directions: RayVectors,
    far: float,
    hidden: Bool[np.ndarray, " num_rays"],
) -> None:
    for first in range(0, origins.shape[0], _LANES):
        _fill(packet, first, origins, directions, far)
        occluded8(packet.active.ctypes, scene, packet.floats.ctypes, query)
        for lane in range(min(_LANES, origins.shape[0] - first)):
            hidden[first + lane] = packet.floats[_FAR, lane] == -np.inf


class Hits(NamedTuple):
    """First hit of each ray."""

    faces: RayRows  # index of the face; -1 = nothing
    distances: RayValues
    """Distance along the ray, in units of its direction; inf = nothing."""
    barycentric: Float32[np.ndarray, "num_rays 2"]
    """Weights of the face's second and third vertices."""


class Raycaster:
    """Acceleration structure over a mesh, for rays from any number of origins at once.

    Rays are cast eight at a time. If eight in a row have about the same origin and direction, as
    rays of neighbouring pixels do, `coherent` is faster; otherwise it is slower.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._scene = EmbreeScene(mesh.vertices, mesh.faces)

    def cast(self, origins: RayVectors, directions: RayVectors, *, coherent: bool = False) -> Hits:
        """Find the first hit of each ray."""
        return Hits(*self._scene.intersect(origins, directions, coherent=coherent))

    def occluded(
        self,
        origins: RayVectors,
        directions: RayVectors,
        max_distance_m: float = 1e4,
        *,
        coherent: bool = False,
    ) -> Bool[np.ndarray, " num_rays"]:
        """Test whether anything is within `max_distance_m` along each ray (unit directions)."""
        return self._scene.occluded(origins, directions, max_distance_m, coherent=coherent)
