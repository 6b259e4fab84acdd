"""Settings as they are built outside the tests, where nothing checks the types."""

from typing import Any


def set_unchecked(settings: Any, **wrong: object) -> None:
    """Gives settings values that beartype refuses under pytest, then has them check themselves."""
    for name, value in wrong.items():
        object.__setattr__(settings, name, value)
    settings.__post_init__()
