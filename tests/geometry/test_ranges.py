from dataclasses import dataclass
from typing import Annotated

import pytest

from sightline.geometry.ranges import Within, check_ranges


@dataclass(frozen=True, kw_only=True)
class Settings:
    share: Annotated[float, Within(0, 1)] = 0.5
    count: Annotated[int, Within(1)] = 1
    range_m: Annotated[tuple[float, float], Within(0, 10)] = (1.0, 2.0)
    color: Annotated[tuple[int, int, int], Within(0, 255)] = (9, 5, 7)
    free: float = -1.0

    def __post_init__(self):
        check_ranges(self)


@pytest.mark.parametrize(
    "given",
    [
        {"share": 0.0},
        {"share": 1},
        {"count": 10**9},
        {"range_m": (0.0, 10.0)},
        {"range_m": (3.0, 3.0)},
        {"color": (255, 0, 3)},
        {"free": float("inf")},
    ],
)
def test_values_within_their_limits_are_taken(given):
    Settings(**given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"share": 1.5}, "share must be finite and from 0 to 1, got 1.5"),
        ({"share": float("nan")}, "share must be finite and from 0 to 1, got nan"),
        ({"count": 0}, "count must be finite and at least 1, got 0"),
        ({"count": float("inf")}, "count must be finite and at least 1, got inf"),
        ({"range_m": (2.0, 1.0)}, "range_m must be two numbers from 0 to 10, the lower first"),
        ({"range_m": (1.0, 11.0)}, "got 1 and 11"),
        ({"color": (3, 256, 0)}, "each number of color must be finite and from 0 to 255, got 256"),
    ],
)
def test_a_value_beyond_its_limits_is_named(given, message):
    with pytest.raises(ValueError, match=message):
        Settings(**given)


def test_a_subclass_inherits_limits_and_adds_its_own():
    @dataclass(frozen=True, kw_only=True)
    class More(Settings):
        angle_deg: Annotated[float, Within(-180, 180)] = 0.0

    with pytest.raises(ValueError, match="share"):
        More(share=2.0)
    with pytest.raises(ValueError, match="angle_deg"):
        More(angle_deg=181.0)
