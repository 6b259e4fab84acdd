"""Camera matrices of KITTI's own images with images of another size."""

import numpy as np
import pytest

from sightline.geometry.kitti_sizes import kitti_size_doubt
from tests.geometry.cameras import IMAGE_FROM_CAMERA

MATRIX = np.array(IMAGE_FROM_CAMERA, dtype=np.float64)
SIZE = (375, 1242)


def noise(size):
    return np.random.default_rng(0).integers(0, 256, (*size, 3), dtype=np.uint8)


@pytest.mark.parametrize("size", [(352, 1216), (352, 1242), (375, 1100), (384, 1216)])
def test_a_cropped_image_is_told_with_both_sizes(size):
    doubt = kitti_size_doubt(MATRIX, size)
    assert doubt is not None
    assert "375x1242" in doubt
    assert f"{size[0]}x{size[1]}" in doubt


@pytest.mark.parametrize(
    ("camera", "size"),
    [
        ((707.0493, 604.0814, 180.5066), (370, 1224)),
        ((718.3351, 600.3891, 181.5122), (374, 1238)),
        ((707.0912, 601.8873, 183.1104), (370, 1226)),
        ((718.856, 607.1928, 185.2157), (376, 1241)),
    ],
)
def test_each_matrix_has_its_own_size(camera, size):
    focal_px, x, y = camera
    matrix = np.array([[focal_px, 0, x], [0, focal_px, y], [0, 0, 1]])
    assert kitti_size_doubt(matrix, size) is None
    assert kitti_size_doubt(matrix, (352, 1216)) is not None


def test_its_own_size_or_one_that_is_hardly_another_is_no_doubt():
    assert kitti_size_doubt(MATRIX, SIZE) is None
    assert kitti_size_doubt(MATRIX, (376, 1241)) is None


@pytest.mark.parametrize("shift_px", [13.0, 0.5])
def test_another_matrix_is_no_doubt(shift_px):
    cropped = MATRIX.copy()
    cropped[0, 2] -= shift_px
    assert kitti_size_doubt(cropped, (352, 1216)) is None
    assert kitti_size_doubt(0.5 * MATRIX, (188, 621)) is None


@pytest.mark.parametrize("size", [(384, 1280), (375, 1280), (384, 1242)])
def test_a_larger_image_is_told_unless_one_colour_extends_it(size):
    image = noise(size)
    assert kitti_size_doubt(MATRIX, size, lambda: image) is not None
    assert kitti_size_doubt(MATRIX, size) is None  # an image nobody can look at
    extended = np.full((*size, 3), (124, 116, 104), dtype=np.uint8)
    extended[:375, :1242] = noise(SIZE)
    assert kitti_size_doubt(MATRIX, size, lambda: extended) is None
