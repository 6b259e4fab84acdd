"""Errors of invalid settings: key, expectation and value."""

from dataclasses import dataclass, field

import pytest

from sightline.files.settings import config_to_dict, differing_settings, parse_settings


@dataclass(frozen=True, kw_only=True)
class Part:
    """Settings within settings."""

    names: tuple[str, ...] = ()
    count: int = 1
    share: float = 0.5

    def __post_init__(self) -> None:
        """Checks the count."""
        if self.count < 1:
            raise ValueError(f"count must be at least 1, got {self.count}")


@dataclass(frozen=True, kw_only=True)
class Whole:
    """Settings with a part that may be absent."""

    part: Part | None = field(default_factory=Part)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ({"names": "a"}, r'"names": Expected a list, such as \[a, b\]. Got value: a$'),
        ({"names": [1]}, r'"names": Expected text. Got value: 1$'),
        ({"count": 2.5}, r'"count": Expected a whole number. Got value: 2.5$'),
        ({"share": "half"}, r'"share": Expected a number. Got value: half$'),
        ({"count": 0}, r"^count must be at least 1, got 0$"),
    ],
)
def test_a_value_that_does_not_fit_is_told_by_its_key_in_plain_words(part, message):
    with pytest.raises(ValueError, match=message) as refused:
        parse_settings(Whole, {"part": part})
    assert "class" not in str(refused.value)


def test_what_fits_is_read():
    assert parse_settings(Whole, {"part": {"names": ["a"]}}) == Whole(part=Part(names=("a",)))
    assert parse_settings(Whole, {"part": None}) == Whole(part=None)


def test_settings_that_differ_are_named_one_by_one_within_their_part():
    given = config_to_dict(Whole(part=Part(names=("a",), count=2)))
    message = differing_settings(given, Whole())
    assert message == "part.count 2 instead of 1, part.names ['a'] instead of []"
    assert differing_settings({"part": None}, Whole()).startswith("part None instead of {")
    assert differing_settings(config_to_dict(Whole()), Whole()) == ""


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ({"count": None}, r"^the setting part\.count is null, expected a value$"),
        ({"names": None}, r"^the setting part\.names is null, expected a value$"),
        ({"count": 10**30}, r"^the setting part\.count is 1000+\.\.\., expected up to 2147483647$"),
    ],
)
def test_what_the_parser_accepts_for_any_type_is_refused_in_plain_words(part, message):
    with pytest.raises(ValueError, match=message):
        parse_settings(Whole, {"part": part})
