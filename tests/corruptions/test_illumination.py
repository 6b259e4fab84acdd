import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.corruptions.exposure import CameraIllumination, brighten, disc_mask
from tests.data.scenes import SIZE, sample_of, seeds
from tests.reference import corruptions as reference

whole = st.integers(0, 9).map(float)  # at which pixels are on the very edge


@given(
    seed=seeds,
    centre=st.tuples(st.floats(-3, 12), st.floats(-3, 9)) | st.tuples(whole, whole),
    radius=st.floats(0, 20) | whole,
    added=st.integers(0, 255),
)
def test_a_disc_is_brightened_as_loops_say(seed, centre, radius, added):
    image = np.random.default_rng(seed).integers(0, 256, (3, 7, 10), dtype=np.uint8)
    mask = disc_mask((7, 10), centre, radius)
    found = brighten(torch.from_numpy(image), mask, added)
    assert found.tolist() == reference.brightened_image(image.tolist(), centre, radius, added)


@given(seed=seeds)
def test_the_mask_is_the_recorded_disc_and_where_a_dark_image_changes(seed):
    dark = sample_of(image=torch.full((3, *SIZE), 20, dtype=torch.uint8))
    found = CameraIllumination().corrupt(dark, np.random.default_rng(seed))
    drawn = found.record.parameters
    expected = disc_mask(SIZE, tuple(drawn["centre_px"]), drawn["radius_px"])
    assert torch.equal(found.camera_mask, expected)
    changed = found.sample.image[:, found.camera_mask]
    assert torch.equal(changed, torch.full_like(changed, 20 + drawn["added_levels"]))
    assert (found.sample.image[:, ~found.camera_mask] == 20).all()


def test_centre_radius_and_brightness_are_drawn_evenly_over_their_whole_ranges():
    black = torch.zeros(3, 30, 90, dtype=torch.uint8)
    sample = sample_of(image=black, image_size=(30, 90), depth=None)
    rng = np.random.default_rng(0)
    drawn = [CameraIllumination().corrupt(sample, rng).record.parameters for _ in range(2000)]
    for values, (low, high) in (
        ([each["centre_px"][0] for each in drawn], (-0.5, 89.5)),
        ([each["centre_px"][1] for each in drawn], (-0.5, 29.5)),
        ([each["radius_px"] for each in drawn], (100, 400)),
        ([each["added_levels"] for each in drawn], (99.5, 230.5)),
    ):
        counts, _ = np.histogram(values, bins=10, range=(low, high))
        assert counts.sum() == 2000
        assert counts.min() > 145  # of 200 expected
        assert counts.max() < 255
    assert {100, 230} <= {each["added_levels"] for each in drawn}


@pytest.mark.parametrize("radius_px", [(-1.0, 5.0), (5.0, 4.0), (5.0, math.inf), (math.nan, 5.0)])
def test_radii_that_cannot_be_drawn_are_refused(radius_px):
    with pytest.raises(ValueError, match="radius_px must be two numbers from 0 to inf"):
        CameraIllumination(radius_px=radius_px)
