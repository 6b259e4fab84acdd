"""Clouds for the tests of point operations: near and far, crowded and in a plane."""

import torch
from hypothesis import strategies as st

whole = st.integers(-3, 3).map(float)  # equal distances, and copies, are common
anywhere = st.floats(-50, 50, width=32)
crowded = st.tuples(whole, whole, whole)
spread = st.tuples(anywhere, anywhere, anywhere)
flat = st.tuples(anywhere, st.just(2.0), st.just(0.0))


def clouds(min_size: int = 0, max_size: int = 12) -> st.SearchStrategy:
    """Lists of points."""
    return st.one_of(
        *(
            st.lists(point, min_size=min_size, max_size=max_size)
            for point in (crowded, spread, flat)
        )
    )


def as_batch(*lists: list) -> torch.Tensor:
    """Equally long lists of points, or of boxes, as a batch."""
    width = 3 if not lists[0] else len(lists[0][0])
    return torch.tensor(lists, dtype=torch.float32).reshape(len(lists), -1, width)


def street(seed: int, count: int) -> torch.Tensor:
    """A large cloud with places of very different density, (1, count, 3)."""
    generator = torch.Generator().manual_seed(seed)
    distance = 70 * torch.rand(count, generator=generator) ** 2
    angle = torch.rand(count, generator=generator) - 0.5
    height = torch.rand(count, generator=generator) * 3 - 2
    return torch.stack((distance * angle.cos(), distance * angle.sin(), height), dim=1)[None]
