import math

import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.depth_completion.surroundings import NUM_PLANES, find_surroundings


@given(st.integers(0, 2**31), st.integers(1, 4))
def test_nearest_and_farthest_are_those_of_the_window_and_the_pixels_own(seed, reach):
    generator = torch.Generator().manual_seed(seed)
    height, width = 9, 11
    depth = 2 + 80 * torch.rand(1, 1, height, width, generator=generator)
    is_measured = torch.rand(1, 1, height, width, generator=generator) < 0.05
    sparse = torch.where(is_measured, depth, 0.0)
    filled = 2 + 80 * torch.rand(1, 1, height, width, generator=generator)
    surroundings = find_surroundings(sparse, filled, reach)
    assert surroundings.planes.shape == (1, NUM_PLANES, height, width)
    for y in range(height):
        for x in range(width):
            rows = slice(max(y - reach, 0), y + reach + 1)
            columns = slice(max(x - reach, 0), x + reach + 1)
            measured = sparse[0, 0, rows, columns]
            measured = measured[measured > 0].tolist()
            own = filled[0, 0, y, x].item()
            planes = surroundings.planes[0, :, y, x].tolist()
            assert math.isclose(
                surroundings.nearest_m[0, 0, y, x].item(), min([*measured, own]), rel_tol=1e-5
            )
            assert math.isclose(
                surroundings.farthest_m[0, 0, y, x].item(), max([*measured, own]), rel_tol=1e-5
            )
            expected = [(math.log(own) - 3) / 2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
            if measured:
                expected[1:3] = (
                    min(max(math.log(each / own), -2), 2) for each in (min(measured), max(measured))
                )
                expected[4] = 1.0
            if sparse[0, 0, y, x] > 0:
                expected[3] = min(max(math.log(sparse[0, 0, y, x].item() / own), -2), 2)
                expected[5] = 1.0
            expected[6] = float(not (sparse[0, 0, : y + 1, x] > 0).any())
            assert all(
                math.isclose(a, b, abs_tol=1e-4) for a, b in zip(planes, expected, strict=True)
            )


def test_where_nothing_is_measured_the_completion_is_all_there_is():
    filled = torch.full((1, 1, 4, 5), 7.0)
    surroundings = find_surroundings(torch.zeros(1, 1, 4, 5), filled, 2)
    assert torch.equal(surroundings.nearest_m, filled)
    assert torch.equal(surroundings.farthest_m, filled)
    assert surroundings.planes.isfinite().all()
