import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sightline.data.image_file import write_rgb
from sightline.data.mask_png import read_mask_png, write_mask_png
from sightline.files.problem import FileError
from tests.data.scenes import few, seeds


@few
@given(size=st.tuples(st.integers(1, 20), st.integers(1, 20)), seed=seeds)
def test_a_mask_is_read_as_it_was_written(tmp_path_factory, size, seed):
    path = tmp_path_factory.mktemp("masks") / "0.png"
    mask = np.random.default_rng(seed).random(size) < 0.5
    write_mask_png(path, mask)
    assert np.array_equal(read_mask_png(path), mask)


def test_a_mask_of_another_maker_is_cut_at_middle_grey(tmp_path):
    levels = np.array([[0, 127, 128, 255]], dtype=np.uint8)
    write_rgb(tmp_path / "0.png", np.repeat(levels[..., None], 3, axis=2))
    assert read_mask_png(tmp_path / "0.png").tolist() == [[False, False, True, True]]


def test_what_is_no_mask_is_refused(tmp_path):
    with pytest.raises(ValueError, match="at least one pixel"):
        write_mask_png(tmp_path / "0.png", np.zeros((0, 4), dtype=np.bool_))
    (tmp_path / "0.png").write_bytes(b"no picture")
    with pytest.raises(FileError):
        read_mask_png(tmp_path / "0.png")
