import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sightline.health.camera_checks import (
    CameraChecks,
    bad_image_regions,
    block_statistics,
    check_camera,
)
from sightline.health.monitor import rgb_of
from tests.health.frames import sound


def noisy(image, amount):
    noise = np.random.default_rng(0).normal(0, amount, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def dotted(image, share):
    changed = image.copy()
    changed[np.random.default_rng(0).random(image.shape[:2]) < share] = 0
    return changed


def black_box(image, share):
    changed = image.copy()
    changed[:, : round(share * image.shape[1])] = 0
    return changed


def white_disc(image, radius):
    changed = image.copy()
    return cv2.circle(changed, (600, 300), round(radius), (255, 255, 255), -1)


def glare_disc(image, radius):
    """A disc with a hard edge that gained 160 levels."""
    disc = cv2.circle(np.zeros_like(image), (600, 150), round(radius), (160, 160, 160), -1)
    return cv2.add(image, disc)


def mud(image, count):
    changed = image.copy()
    for number in range(round(count)):
        cv2.circle(changed, (80 * number + 40, 250), 24, (62, 54, 44), -1)
    return changed


def jpeg(image, loss):
    coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, round(100 - loss)])[1]
    return cv2.imdecode(coded, cv2.IMREAD_COLOR)


FAULTS = {
    "dark": (lambda image, x: (image / x).astype(np.uint8), (1, 3, 9)),
    "bright": (lambda image, x: np.clip(image + float(x), 0, 255).astype(np.uint8), (0, 60, 120)),
    "faint": (lambda image, x: (128 + (image - 128.0) / x).astype(np.uint8), (1, 3, 9)),
    "white": (white_disc, (1, 60, 150)),
    "lifted": (glare_disc, (1, 140, 250)),
    "covered": (black_box, (0, 0.2, 0.5)),
    "textureless": (white_disc, (1, 60, 150)),
    "still": (mud, (0, 5, 12)),
    "muddy": (mud, (0, 5, 12)),
    "blurred": (lambda image, x: cv2.blur(image, (x, x)), (1, 5, 11)),
    "noisy": (noisy, (0, 10, 40)),
    "speckled": (dotted, (0, 0.1, 0.4)),
    "blocky": (jpeg, (5, 82, 93)),
}


@pytest.mark.parametrize("name", CameraChecks._fields)
def test_each_check_grows_with_what_it_looks_for(name):
    fault, amounts = FAULTS[name]
    image = rgb_of(sound())
    found = [getattr(check_camera(fault(image, amount)), name) for amount in amounts]
    assert found[0] < found[1] < found[2]


@settings(max_examples=40)
@given(
    image=hnp.arrays(
        np.uint8,
        st.tuples(st.integers(1, 40), st.integers(1, 60), st.just(3)),
        elements=st.sampled_from([0, 0, 7, 200, 255]),
    )
)
def test_any_image_is_judged_and_stays_as_it_is(image):
    before = image.copy()
    assert np.isfinite(np.array(check_camera(image))).all()
    assert bad_image_regions(image).dtype == bool
    assert np.array_equal(image, before)


def test_blocks_have_the_mean_and_deviation_of_their_pixels():
    grey = np.random.default_rng(0).integers(0, 256, (48, 72), dtype=np.uint8)
    mean, deviation = block_statistics(grey)
    assert mean.shape == (2, 3)
    for row in range(2):
        for column in range(3):
            block = grey[24 * row : 24 * row + 24, 24 * column : 24 * column + 24]
            assert mean[row, column] == pytest.approx(block.mean(), rel=1e-4)
            assert deviation[row, column] == pytest.approx(block.std(), rel=1e-3)


def test_a_bright_sky_is_no_light_that_blinds_and_a_disc_in_it_is():
    image = rgb_of(sound()).copy()
    image[:200] = np.linspace(220, 250, 200, dtype=np.uint8)[:, None, None]
    assert check_camera(image).lifted == check_camera(rgb_of(sound())).lifted == 0
    assert check_camera(glare_disc(image, 180)).lifted > 0.01
    blinded = bad_image_regions(glare_disc(rgb_of(sound()), 180))
    rows, columns = blinded.shape
    assert blinded[round(150 / 375 * rows), round(600 / 1242 * columns)]
    assert not blinded[:, : columns // 4].any()


def test_the_regions_are_where_the_image_is_covered():
    image = rgb_of(sound())
    regions = bad_image_regions(black_box(image, 0.5))
    half = regions.shape[1] // 2
    assert regions[:, : half - 1].all()
    assert regions[:, half + 1 :].mean() < 0.05
