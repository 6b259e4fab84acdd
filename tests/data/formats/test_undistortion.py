import re

import cv2
import numpy as np
import pytest
import torch

from sightline.data.check import check_tree
from sightline.data.formats.undistortion import lens_fault, undistort
from sightline.data.open import open_dataset
from tests.data.recordings import write_calibration, write_recording

CAMERA = np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])
LENSES = {
    "plumb_bob": (-0.25, 0.08, 0.001, -0.002, 0.01),
    "rational_polynomial": (-0.2, 0.05, 0.001, 0.0, 0.01, 0.02, -0.01, 0.0),
    "equidistant": (0.02, -0.01, 0.004, -0.001),
}


def seen(points, lens, model):
    """Pixels of points on the plane z = 1, by the lens' own equations in OpenCV."""
    spread = np.pad(points, ((0, 0), (0, 1)), constant_values=1.0)[:, None]
    project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    zeros = np.zeros(3)
    return project(spread, zeros, zeros, CAMERA, np.array(lens))[0].reshape(-1, 2)


@pytest.mark.parametrize("model", LENSES)
def test_a_point_comes_to_lie_where_a_lens_without_distortion_shows_it(model):
    for x, y in ((-0.4, -0.3), (0.0, 0.0), (0.35, 0.25), (-0.2, 0.3)):
        (pixel,) = seen(np.array([[x, y]]), LENSES[model], model)
        rows, columns = np.mgrid[:240, :320]
        spot = 255 * np.exp(-((columns - pixel[0]) ** 2 + (rows - pixel[1]) ** 2) / 8)
        picture = np.repeat(spot.astype(np.uint8)[..., None], 3, axis=2)
        straight = undistort(picture, CAMERA, LENSES[model], model=model)[..., 0].astype(float)
        total = straight.sum()
        centre = (straight * columns).sum() / total, (straight * rows).sum() / total
        np.testing.assert_allclose(centre, (300 * x + 159.5, 300 * y + 119.5), atol=0.3)


@pytest.mark.parametrize(
    ("model", "lens", "said"),
    [
        ("plumb_bob", (0.1,), "has 1 distortion coefficients, expected 4 or 5 finite numbers"),
        ("equidistant", (0.1, np.nan, 0, 0), "expected 4 finite numbers for the model equidistant"),
    ],
)
def test_coefficients_that_a_model_does_not_take_are_refused(model, lens, said):
    with pytest.raises(ValueError, match=said):
        undistort(np.zeros((4, 5, 3), np.uint8), CAMERA, lens, model=model)


@pytest.mark.parametrize("model", LENSES)
def test_zeros_behind_the_last_coefficient_are_no_matter(model):
    picture = np.arange(240 * 320 * 3, dtype=np.uint64).reshape(240, 320, 3).astype(np.uint8)
    filled = (*LENSES[model], *[0.0] * (16 - len(LENSES[model])))
    if model == "plumb_bob":  # a list of 8 is that of the rational model
        filled = filled[:6]
    straight = undistort(picture, CAMERA, filled, model=model)
    assert np.array_equal(straight, undistort(picture, CAMERA, LENSES[model], model=model))


@pytest.mark.parametrize(
    ("image", "camera", "said"),
    [
        (np.zeros((4, 5, 3)), CAMERA, r"the image is float64 of shape \(4, 5, 3\), expected uint8"),
        (np.zeros((4, 5), np.uint8), CAMERA, r"the image is uint8 of shape \(4, 5\), expected"),
        (
            np.zeros((4, 5, 3), np.uint8),
            CAMERA[:2],
            r"camera_matrix is of shape \(2, 3\), expected",
        ),
        (np.zeros((4, 5, 3), np.uint8), CAMERA.T, "expected 0 0 1: it is probably transposed"),
        (np.zeros((4, 5, 3), np.uint8), CAMERA * np.nan, r"expected 3x3 finite numbers; give"),
    ],
)
def test_what_is_no_picture_or_no_camera_is_refused_instead_of_giving_black(image, camera, said):
    with pytest.raises(ValueError, match=said):
        undistort(image, camera, LENSES["plumb_bob"])


def test_a_fisheye_of_zeros_is_none_of_a_pinhole(tmp_path):
    write_recording(tmp_path, ("a",))
    plain = open_dataset(tmp_path)[0].image
    for model, is_straight in (("plumb_bob", True), ("equidistant", False)):
        lens = {"model": model, "coefficients": [0.0] * 4, "undistort": True}
        write_calibration(tmp_path, lens=lens)
        assert torch.equal(open_dataset(tmp_path)[0].image, plain) is is_straight
    write_calibration(tmp_path, lens=lens | {"undistort": False})
    (problem,) = check_tree(tmp_path)
    assert "lens has distortion, but images must be undistorted" in problem.problem


def test_a_fisheye_cannot_show_what_is_beside_the_camera():
    camera = CAMERA * np.array([[0.001], [0.001], [1]])
    assert "focal lengths from the axis" in lens_fault(
        "equidistant", (0.0,) * 4, camera, (240, 320)
    )


@pytest.mark.parametrize("model", LENSES)
def test_a_lens_that_was_calibrated_has_no_fault(model):
    assert lens_fault(model, LENSES[model], CAMERA, (240, 320)) is None


@pytest.mark.parametrize(
    ("model", "coefficients", "complaint"),
    [
        ("plumb_bob", (-2.0, 0, 0, 0), "folds the picture of 240x320 over itself, from "),
        ("plumb_bob", (-0.25, 0.08, 0, 0, -2.0), "folds the picture"),
        ("plumb_bob", (-0.2, 0, 0.9, 0), "folds the picture"),
        ("plumb_bob", (-1000.0, 0, 0, 0), "folds the picture"),
        ("plumb_bob", (1000.0, 0, 0, 0), "fills only . % of the picture of 240x320"),
        ("rational_polynomial", (0, 0, 0, 0, 0, -4.0, 0, 0), "folds the picture"),
        ("equidistant", (-2.0, 0, 0, 0), "folds the picture"),
    ],
)
def test_a_lens_that_folds_or_loses_the_picture_is_refused(model, coefficients, complaint):
    fault = lens_fault(model, tuple(map(float, coefficients)), CAMERA, (240, 320))
    assert re.match(complaint, fault)
    with pytest.raises(ValueError, match=r"the lens (folds|fills).*; give the coefficients"):
        undistort(np.zeros((240, 320, 3), np.uint8), CAMERA, coefficients, model=model)


def test_a_lens_that_folds_beyond_the_picture_alone_is_taken():
    assert lens_fault("plumb_bob", (-1.0, 0.0, 0.0, 0.0), CAMERA, (120, 160)) is not None
    assert lens_fault("plumb_bob", (-0.5, 0.0, 0.0, 0.0), CAMERA, (240, 320)) is None
