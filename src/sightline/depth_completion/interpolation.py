"""Depth completion by interpolation: the nearest measurement, and linear between three."""

import numpy as np
import torch
from jaxtyping import Float32, Int64
from scipy.interpolate import LinearNDInterpolator
from scipy.ndimage import distance_transform_edt
from scipy.spatial import Delaunay, QhullError

from sightline.depth_completion.sparse_map import check_sparse_depth, inside_hull
from sightline.structures.predictions import DepthMap


def nearest_depth(sparse_depth_m: Float32[np.ndarray, "height width"]) -> DepthMap:
    """Every pixel takes the depth of the measured pixel nearest to it in the image (Euclidean).

    Valid inside the convex hull of the measured pixels, a guess outside; nothing without a
    measurement. Among equally near ones the choice is open but the same every time.

    Raises:
        ValueError: `sparse_depth_m` holds something else than depths.
    """
    check_sparse_depth(sparse_depth_m)
    is_measured = sparse_depth_m > 0
    depth_m = np.zeros_like(sparse_depth_m)
    if is_measured.any():
        rows, columns = distance_transform_edt(
            ~is_measured, return_distances=False, return_indices=True
        )
        depth_m = sparse_depth_m[rows, columns]
    return DepthMap(
        depth_m=torch.from_numpy(depth_m), valid=torch.from_numpy(inside_hull(is_measured))
    )


def linear_depth(sparse_depth_m: Float32[np.ndarray, "height width"]) -> DepthMap:
    """Linear in inverse depth over the Delaunay triangles of the measured pixels.

    The inverse depth of a plane in the scene is linear in the image, so planes come out exactly.
    Valid inside the convex hull of the measured pixels; no value outside. Fewer than three
    measurements, or all on one line, span no triangle: those pixels alone are valid then.

    Raises:
        ValueError: `sparse_depth_m` holds something else than depths.
    """
    check_sparse_depth(sparse_depth_m)
    pixels = np.argwhere(sparse_depth_m > 0)
    depth_m = sparse_depth_m.copy()
    triangles = _triangulate(pixels)
    if triangles is not None:
        inverse_depths = 1.0 / sparse_depth_m[*pixels.T].astype(np.float64)
        interpolate = LinearNDInterpolator(triangles, inverse_depths, fill_value=np.inf)
        # Outside the hull a search through all triangles would precede the answer.
        is_asked = inside_hull(sparse_depth_m > 0) & (sparse_depth_m == 0)
        depth_m[is_asked] = 1.0 / interpolate(np.argwhere(is_asked))
    return DepthMap(depth_m=torch.from_numpy(depth_m), valid=torch.from_numpy(depth_m > 0))


def _triangulate(pixels: Int64[np.ndarray, "n 2"]) -> Delaunay | None:
    """None where the pixels span no triangle."""
    if len(pixels) < 3:
        return None
    try:
        return Delaunay(pixels)
    except QhullError:  # all on one line
        return None
