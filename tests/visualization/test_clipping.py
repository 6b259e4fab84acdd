"""Clipping, compared with densely sampled points of the edge."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sightline.visualization.clipping import clip_polygon, clip_segments, view_planes

IMAGE_SIZE = (30, 50)
coordinate = st.integers(-40, 40).map(float)
vertices = st.tuples(coordinate, coordinate, st.integers(-4, 8).map(float))


def seen(point: np.ndarray, margin_px: float) -> bool:
    """Whether a homogeneous point is clearly in view, or clearly not (negative margin)."""
    x, y, w = point
    if w < 0.1 + 0.01 * np.sign(margin_px):
        return False
    column, row = x / w, y / w
    within_columns = -16 + margin_px <= column <= IMAGE_SIZE[1] + 16 - margin_px
    return bool(within_columns and -16 + margin_px <= row <= IMAGE_SIZE[0] + 16 - margin_px)


def distance_to_segment(pixel: np.ndarray, segment: np.ndarray) -> float:
    start, end = segment
    length2 = float(((end - start) ** 2).sum())
    at = 0.0 if length2 == 0 else float(np.clip((pixel - start) @ (end - start) / length2, 0, 1))
    return float(np.linalg.norm(start + at * (end - start) - pixel))


@given(start=vertices, end=vertices)
def test_a_clipped_segment_covers_what_is_in_view_and_nothing_else(start, end):
    segment = np.array([start, end])
    clipped = clip_segments(segment[None], view_planes(IMAGE_SIZE))
    along = np.linspace(0, 1, 101)[:, None]
    for point in segment[0] + along * (segment[1] - segment[0]):
        if seen(point, margin_px=0.01):
            assert len(clipped) == 1
            assert distance_to_segment(point[:2] / point[2], clipped[0]) < 1e-6
    assert (clipped > np.array([-16.01, -16.01])).all()
    assert (clipped < np.array([66.01, 46.01])).all()


@given(corners=st.tuples(vertices, vertices, vertices))
def test_a_clipped_triangle_covers_the_centre_of_every_pixel_it_covered(corners):
    triangle = np.array(corners)
    polygon = clip_polygon(triangle, view_planes(IMAGE_SIZE))
    weights = np.array([(i, j, 12 - i - j) for i in range(1, 11) for j in range(1, 12 - i)]) / 12
    for point in weights @ triangle:
        if seen(point, margin_px=0.01) and abs(np.linalg.det(triangle)) > 1:
            assert within_convex(point[:2] / point[2], polygon)


def within_convex(pixel: np.ndarray, polygon: np.ndarray) -> bool:
    edges = np.roll(polygon, -1, axis=0) - polygon
    offsets = pixel - polygon
    turns = edges[:, 0] * offsets[:, 1] - edges[:, 1] * offsets[:, 0]
    return bool((turns >= -1e-6).all() or (turns <= 1e-6).all())


def test_an_edge_behind_the_camera_has_no_pixel():
    behind = np.array([[[0.0, 0.0, -1.0], [5.0, 5.0, -3.0]]])
    assert len(clip_segments(behind, view_planes(IMAGE_SIZE))) == 0
    assert len(clip_polygon(behind[0], view_planes(IMAGE_SIZE))) == 0


def test_an_edge_that_passes_the_camera_ends_at_the_picture_and_not_at_its_mirror_image():
    # From 10 m ahead, in the middle of the picture, to 10 m behind on the right.
    edge = np.array([[[250.0, 150.0, 10.0], [400.0, 150.0, -10.0]]])
    clipped = clip_segments(edge, view_planes(IMAGE_SIZE))
    assert clipped[0, 0] == pytest.approx([25.0, 15.0])
    assert clipped[0, 1, 0] == pytest.approx(66.0)
