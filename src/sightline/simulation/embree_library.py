"""Embree 4, called through the library in the package `embreex`.

The classes of `embreex` are not used: they copy a mesh number by number, which takes longer than
all of Embree's work, and cast rays one by one (`benchmarks/raycast.py`).
"""

import ctypes
import functools
import sys
from pathlib import Path

import embreex.rtcore_scene


@functools.cache
def embree_library() -> ctypes.CDLL:
    """Load the library and declare its functions.

    Raises:
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
    module = Path(embreex.rtcore_scene.__file__)
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
