"""Clipping of projected lines and polygons at the borders of a camera's view.

It uses homogeneous coordinates, before the division by depth: for an edge that begins behind the
camera, only the part in front has pixels.
"""

import numpy as np
from jaxtyping import Float

_NEAR_M = 0.1
_MARGIN_PX = 16.0  # strokes end outside the picture, so their ends are invisible


def view_planes(image_size: tuple[int, int]) -> Float[np.ndarray, "5 4"]:
    """Clipping planes (x, y, w, 1): their product with a point in view is not negative."""
    height, width = image_size
    return np.array(
        [
            [0.0, 0.0, 1.0, -_NEAR_M],
            [1.0, 0.0, _MARGIN_PX, 0.0],
            [-1.0, 0.0, width + _MARGIN_PX, 0.0],
            [0.0, 1.0, _MARGIN_PX, 0.0],
            [0.0, -1.0, height + _MARGIN_PX, 0.0],
        ]
    )


def clip_segments(
    segments: Float[np.ndarray, "num_segments 2 3"], planes: Float[np.ndarray, "num_planes 4"]
) -> Float[np.ndarray, "num_kept 2 2"]:
    """Clip segments of homogeneous points; returns the pixels (x, y) of their visible parts.

    After Liang and Barsky 1984: each plane cuts the segment's parameter from one side.
    """
    start, end = segments[:, 0], segments[:, 1]
    at_start = start @ planes[:, :3].T + planes[:, 3]
    at_end = end @ planes[:, :3].T + planes[:, 3]
    change = at_start - at_end
    crossing = at_start / np.where(change == 0, 1.0, change)
    first = np.where((at_start < 0) & (at_end >= 0), crossing, 0.0).max(axis=1)
    last = np.where((at_start >= 0) & (at_end < 0), crossing, 1.0).min(axis=1)
    kept = (first < last) & ~((at_start < 0) & (at_end < 0)).any(axis=1)
    parameters = np.stack((first, last), axis=1)[kept, :, None]
    visible = start[kept, None] + parameters * (end - start)[kept, None]
    pixels: Float[np.ndarray, "num_kept 2 2"] = visible[..., :2] / visible[..., 2:]
    return pixels


def clip_polygon(
    vertices: Float[np.ndarray, "num_vertices 3"], planes: Float[np.ndarray, "num_planes 4"]
) -> Float[np.ndarray, "num_kept 2"]:
    """Clip a convex polygon of homogeneous points; returns the pixels (x, y) of its visible part.

    After Sutherland and Hodgman 1974: plane by plane, crossings replace vertices outside.
    """
    for plane in planes:
        if len(vertices) == 0:
            break
        following = np.roll(vertices, -1, axis=0)
        here = vertices @ plane[:3] + plane[3]
        there = following @ plane[:3] + plane[3]
        change = here - there
        crossing = here / np.where(change == 0, 1.0, change)
        cut = vertices + crossing[:, None] * (following - vertices)
        pairs = np.stack((vertices, cut), axis=1)
        kept = np.stack((here >= 0, (here >= 0) != (there >= 0)), axis=1)
        vertices = pairs[kept]
    pixels: Float[np.ndarray, "num_kept 2"] = vertices[:, :2] / vertices[:, 2:]
    return pixels
