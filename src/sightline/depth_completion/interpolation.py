"""Depth completion by interpolation: nearest neighbour, and linear over triangles."""

import numpy as np
import torch
from jaxtyping import Float32, Int64
from scipy.ndimage import distance_transform_edt
from scipy.spatial import Delaunay, QhullError

from sightline.depth_completion.interpolation_kernels import draw_triangles
from sightline.depth_completion.sparse_map import check_sparse_depth, inside_hull
from sightline.structures.predictions import DepthMap


def nearest_depth(sparse_depth_m: Float32[np.ndarray, "height width"]) -> DepthMap:
    """Nearest-neighbour interpolation: the depth of the nearest measured pixel (Euclidean).

    Valid inside the convex hull of the measured pixels, a guess outside; empty without
    measurements. Ties are broken deterministically, in no specified order.

    Raises:
        ValueError: `sparse_depth_m` contains invalid depths.
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
    """Linear interpolation of inverse depth over the Delaunay triangles of the measured pixels.

    The inverse depth of a plane in the scene is linear in the image, so planes are exact. Valid
    inside the convex hull of the measured pixels; no value outside. If the measurements span no
    triangle (fewer than three, or all on one line), only the measured pixels are valid. Qhull
    chooses the diagonal of rectangles.

    Raises:
        ValueError: `sparse_depth_m` contains invalid depths.
    """
    check_sparse_depth(sparse_depth_m)
    is_measured = sparse_depth_m > 0
    pixels = np.argwhere(is_measured)
    inverse_depth = draw_triangles(
        pixels,
        1.0 / sparse_depth_m[is_measured].astype(np.float64),
        _delaunay(pixels),
        sparse_depth_m.shape,
    )
    depth_m = sparse_depth_m.copy()
    is_filled = ~is_measured & (inverse_depth > 0)
    depth_m[is_filled] = 1.0 / inverse_depth[is_filled]
    return DepthMap(depth_m=torch.from_numpy(depth_m), valid=torch.from_numpy(depth_m > 0))


def _delaunay(pixels: Int64[np.ndarray, "n 2"]) -> Int64[np.ndarray, "m 3"]:
    """Corners of the Delaunay triangles; empty if the pixels span no triangle."""
    if len(pixels) >= 3:
        try:
            return Delaunay(pixels).simplices.astype(np.int64)
        except QhullError:  # all on one line
            pass
    return np.empty((0, 3), np.int64)
