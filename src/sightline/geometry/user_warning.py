"""Warnings that point to the line of the user's code that called Sightline."""

import sys
import warnings
from types import FrameType
from typing import Final

_NOT_USERS: Final = {
    *("sightline", "jaxtyping", "beartype", "contextlib", "functools"),
    "torch",  # data loaders
}
"""Packages between a user's call and the warning."""


def warn_user(message: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the line of the innermost caller outside Sightline.

    Python shows a text once for each line: a mistake made again elsewhere is told again.
    """
    frame: FrameType | None = sys._getframe(1)  # noqa: SLF001  # the public way is ten times slower
    level = 2
    while frame is not None and _is_ours(frame):
        frame = frame.f_back
        level += 1
    warnings.warn(message, category, stacklevel=level)


def _is_ours(frame: FrameType) -> bool:
    return str(frame.f_globals.get("__name__", "")).partition(".")[0] in _NOT_USERS
