"""Which pixels an object would cover if nothing stood in front of it."""

import numpy as np
from jaxtyping import Bool, Float64, Int32

from sightline.ops.compiled import compiled


def silhouette(
    pixels: Float64[np.ndarray, "num_vertices 2"],
    faces: Int32[np.ndarray, "num_faces 3"],
    box: tuple[int, int, int, int],
) -> Bool[np.ndarray, "height width"]:
    """Marks the pixels whose centres lie in the projection of any face.

    Agrees with rays through the centres of pixels, but for centres on an edge to the last bit.

    Args:
        pixels: Where the vertices are seen, x and y [px]; all in front of the camera.
        faces: Of these vertices, turned either way.
        box: First column and row, last column and row of what is looked at.
    """
    x_min, y_min, x_max, y_max = box
    covered = np.zeros((y_max - y_min + 1, x_max - x_min + 1), dtype=np.bool_)
    _fill(pixels - np.array((x_min, y_min), dtype=np.float64), faces, covered)
    return covered


@compiled
def _fill(
    pixels: Float64[np.ndarray, "num_vertices 2"],
    faces: Int32[np.ndarray, "num_faces 3"],
    covered: Bool[np.ndarray, "height width"],
) -> None:
    height, width = covered.shape
    for face in faces:
        ax, ay = pixels[face[0]]
        bx, by = pixels[face[1]]
        cx, cy = pixels[face[2]]
        first_row = max(0, int(np.ceil(min(ay, by, cy))))
        last_row = min(height - 1, int(np.floor(max(ay, by, cy))))
        for row in range(first_row, last_row + 1):
            # The row cuts a triangle in one span, between the crossings of its edges.
            left, right = np.inf, -np.inf
            for start_x, start_y, end_x, end_y in (
                (ax, ay, bx, by),
                (bx, by, cx, cy),
                (cx, cy, ax, ay),
            ):
                if min(start_y, end_y) <= row <= max(start_y, end_y):
                    if start_y == end_y:
                        left = min(left, start_x, end_x)
                        right = max(right, start_x, end_x)
                    else:
                        share = (row - start_y) / (end_y - start_y)
                        crossing = start_x + share * (end_x - start_x)
                        left, right = min(left, crossing), max(right, crossing)
            left, right = max(left, 0.0), min(right, width - 1.0)
            if left <= right:
                covered[row, int(np.ceil(left)) : int(np.floor(right)) + 1] = True
