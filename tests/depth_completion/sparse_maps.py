"""Sparse depth maps for the tests of this folder."""

import numpy as np
from hypothesis import strategies as st

IMAGE = (352, 1216)


def random_map(seed, shape, density, *, far_m=60.0):
    rng = np.random.default_rng(seed)
    depth = rng.uniform(1.0, far_m, shape).astype(np.float32)
    return np.where(rng.random(shape) < density, depth, np.float32(0))


def random_maps(*, max_rows=24, max_columns=32, far_m=60.0):
    """Strategy for maps of any size and density, some empty, some full."""
    return st.builds(
        random_map,
        st.integers(0, 2**31),
        st.tuples(st.integers(1, max_rows), st.integers(1, max_columns)),
        st.sampled_from([0.0, 0.01, 0.1, 0.5, 1.0]),
        far_m=st.just(far_m),
    )


def rings(dense, *, row_spacing, column_spacing=3, first_row=2):
    """Sample a dense map as a LiDAR with horizontal rings does."""
    sparse = np.zeros_like(dense)
    sampled = (slice(first_row, None, row_spacing), slice(None, None, column_spacing))
    sparse[sampled] = dense[sampled]
    return sparse


def plane(shape, *, per_row, per_column=0.0, at_origin=0.01):
    """Depth map of a plane: its inverse is linear in the image."""
    rows, columns = np.indices(shape)
    return (1 / (at_origin + per_row * rows + per_column * columns)).astype(np.float32)
