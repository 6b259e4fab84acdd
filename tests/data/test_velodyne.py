import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from sightline.data.velodyne import read_sweep, write_sweep

finite = st.floats(width=32, allow_nan=False, allow_infinity=False)
sweeps = arrays.arrays(np.float32, st.tuples(st.integers(0, 9), st.just(4)), elements=finite)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("sweep") / "0.bin"


@given(points=sweeps)
def test_sweeps_survive_reading_and_writing_bit_by_bit(path, points):
    write_sweep(path, points)
    assert path.stat().st_size == 16 * len(points)
    assert read_sweep(path).tobytes() == points.tobytes()
    assert read_sweep(path).flags.writeable


def test_an_empty_file_is_a_sweep_of_zero_points(tmp_path):
    (tmp_path / "0.bin").touch()
    assert read_sweep(tmp_path / "0.bin").shape == (0, 4)


@pytest.mark.parametrize("num_bytes", [1, 4, 15, 17, 33])
def test_a_sweep_cut_short_is_refused_with_its_length(tmp_path, num_bytes):
    (tmp_path / "0.bin").write_bytes(bytes(num_bytes))
    with pytest.raises(ValueError, match=rf"0\.bin: holds {num_bytes} bytes.* multiple of 16.*cut"):
        read_sweep(tmp_path / "0.bin")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("column", range(4))
def test_non_finite_points_are_refused_with_their_number_and_the_first(tmp_path, value, column):
    points = np.ones((9, 4), np.float32)
    points[[3, 7], column] = value
    points.tofile(tmp_path / "0.bin")
    with pytest.raises(
        ValueError, match=r"0\.bin: holds 2 points with .* the first is point 3 of 9"
    ):
        read_sweep(tmp_path / "0.bin")
    kept = read_sweep(tmp_path / "0.bin", drop_non_finite=True)
    assert np.array_equal(kept, np.ones((7, 4), np.float32))
    with pytest.raises(ValueError, match=r"2 points hold NaN or infinite .* first is point 3"):
        write_sweep(tmp_path / "1.bin", points)
    assert not (tmp_path / "1.bin").exists()
