"""Folder for a user's compiled kernels and converted networks, kept between runs."""

import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path


def cache_folder() -> Path | None:
    """Find the first folder that this user can write to; create it if it is missing.

    Candidates are $XDG_CACHE_HOME/sightline, ~/.cache/sightline, and sightline-UID in the folder
    for temporary files. Its contents are run as code, so a folder that another user owns or that
    everybody may write to is never used.

    Returns:
        The folder; None if there is none.
    """
    return next(filter(_is_private, _candidates()), None)


def _candidates() -> Iterator[Path]:
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if base.is_absolute():
        yield base / "sightline"
    with suppress(RuntimeError):  # a user without a home
        home = Path.home()
        if home.is_absolute():
            yield home / ".cache" / "sightline"
    with suppress(OSError):  # no folder for temporary files at all
        yield Path(tempfile.gettempdir()) / f"sightline-{os.getuid()}"


def _is_private(folder: Path) -> bool:
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return False
    is_safe = stat.S_ISDIR(found.st_mode) and not found.st_mode & stat.S_IWOTH
    return is_safe and found.st_uid == os.getuid() and os.access(folder, os.W_OK | os.X_OK)
