import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sightline.simulation.raycast import Raycaster
from sightline.simulation.scene import Mesh
from sightline.simulation.silhouette import silhouette

triangles = st.lists(
    st.lists(st.tuples(st.floats(-6, 16), st.floats(-6, 16)), min_size=3, max_size=3),
    min_size=1,
    max_size=4,
)


def slow_silhouette(pixels: np.ndarray, box: tuple[int, int, int, int]) -> np.ndarray:
    """By the side of each edge on which a centre lies; a centre near an edge is undecided (-1)."""
    x_min, y_min, x_max, y_max = box
    answer = np.zeros((y_max - y_min + 1, x_max - x_min + 1), dtype=int)
    for row in range(y_min, y_max + 1):
        for column in range(x_min, x_max + 1):
            for a, b, c in pixels:
                sides = [
                    (q[0] - p[0]) * (row - p[1]) - (q[1] - p[1]) * (column - p[0])
                    for p, q in ((a, b), (b, c), (c, a))
                ]
                cell = answer[row - y_min, column - x_min]
                if min(np.abs(sides)) < 1e-6 and cell == 0:
                    answer[row - y_min, column - x_min] = -1
                elif min(np.abs(sides)) >= 1e-6 and (min(sides) > 0 or max(sides) < 0):
                    answer[row - y_min, column - x_min] = 1
    return answer


@given(corners=triangles)
def test_pixels_are_those_whose_centres_lie_in_a_triangle(corners):
    pixels = np.array(corners, dtype=np.float64)
    box = (-2, 1, 9, 8)
    faces = np.arange(pixels.size // 2, dtype=np.int32).reshape(-1, 3)
    covered = silhouette(pixels.reshape(-1, 2), faces, box)
    expected = slow_silhouette(pixels, box)
    decided = expected >= 0
    assert np.array_equal(covered[decided], expected[decided] == 1)


def test_it_agrees_with_rays_on_a_cloud_of_triangles():
    rng = np.random.default_rng(0)
    pixels = rng.uniform(0, 60, (150, 2))
    faces = rng.integers(0, 150, (60, 3)).astype(np.int32)
    covered = silhouette(pixels, faces, (0, 0, 59, 59))
    flat = np.column_stack((pixels, np.ones(150))).astype(np.float32)
    mesh = Mesh(
        vertices=flat,
        normals=flat,
        uvs=flat[:, :2].copy(),
        faces=faces,
        materials=np.zeros(60, np.int32),
        colors=np.zeros((60, 3), np.float32),
    )
    y, x = np.indices((60, 60), dtype=np.float32).reshape(2, -1)
    origins = np.stack((x, y, np.zeros_like(x)), axis=1)
    directions = np.tile(np.array([[0, 0, 1]], np.float32), (len(x), 1))
    hit = Raycaster(mesh).cast(origins, directions).faces >= 0
    assert (covered.reshape(-1) != hit).mean() < 0.002  # centres on edges
    assert 0.2 < hit.mean() < 1


@pytest.mark.parametrize("shift", [-100.0, 100.0])
def test_what_lies_outside_the_box_marks_nothing(shift: float):
    pixels = np.array([[0, 0], [10, 0], [0, 10]], dtype=np.float64) + shift
    faces = np.array([[0, 1, 2]], dtype=np.int32)
    assert not silhouette(pixels, faces, (0, 0, 20, 20)).any()
