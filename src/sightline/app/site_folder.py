"""Folder of an exported page: written aside, and renamed when it is whole."""

import fcntl
import os
import shutil
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

from sightline.files.atomic import atomic_link, atomic_write_bytes
from sightline.files.temporary_folder import is_temporary
from sightline.jobs.output_dirs import (
    MANIFEST_NAME,
    acquire_output_dir,
    is_finished,
    read_claim,
)

_OWN_NAMES: Final = {
    MANIFEST_NAME, "files", "index.html", "setup.json", "states", "static", "timelines.json",
}  # fmt: skip


class SiteFolder:
    """Folder `.NAME.part` beside the one that it becomes, for one process at a time.

    An interrupted one stays and is gone on with. Files of an older export under the same settings
    are taken over.
    """

    made_by: Final = "sightline serve --export"

    def __init__(self, site: Path, settings: Mapping[str, object]) -> None:
        """Check the place.

        Args:
            site: The folder to be; may be missing, empty, or an older export.
            settings: Everything that the content of states depends on, as JSON, with `made_by`.

        Raises:
            ValueError: The folder holds anything else, or its name cannot be used.
        """
        self._site = Path(os.path.realpath(site))
        if not self._site.name:
            raise ValueError(f"{site} is no place for an export; name a new folder")
        is_current = Path.cwd().is_relative_to(self._site)
        if is_current or self._site.is_mount():  # it is replaced as a whole
            what = "the current folder" if is_current else "a mount point"
            raise ValueError(
                f"{site} is {what}, which an export cannot replace; name a folder in it"
            )
        self._aside = self._site.with_name(f".{self._site.name}.part")
        self._older = self._site.with_name(f".{self._site.name}.old")
        self._settings = dict(settings)
        for each in (self._site, self._aside, self._older):
            _check_own(each)

    def __enter__(self) -> "SiteFolder":  # noqa: PYI034 - beartype refuses Self
        """Claim the folder aside; one of other settings is emptied.

        Raises:
            ValueError: It cannot be written, or another export writes it now.
        """
        try:
            self._aside.mkdir(parents=True, exist_ok=True)
            self._lock = os.open(self._aside, os.O_RDONLY)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise ValueError(
                f"{self._aside} cannot be written: {reason}; name another place"
            ) from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(self._lock)
            raise ValueError(
                f"{self._site} is being exported by another process; wait for its end"
            ) from error
        except OSError:  # a file system without locks
            pass
        if read_claim(self._aside) not in (None, self._settings):
            for each in self._aside.iterdir():
                shutil.rmtree(each) if each.is_dir() else each.unlink()
        acquire_output_dir(self._aside, self._settings, results=["files", "states"])
        return self

    def __exit__(self, *error: object) -> None:
        """Release the lock; the folder stays."""
        os.close(self._lock)

    def has(self, place: str) -> bool:
        """Test whether the new export holds a file, or can take it over from the older one."""
        if is_finished(self._aside / place):
            return True
        if not self._is_like_older() or not is_finished(self._site / place):
            return False
        atomic_link(self._aside / place, self._site / place)
        return True

    def read(self, place: str) -> bytes | None:
        """Read a file that is there or can be taken over; None: there is none."""
        return (self._aside / place).read_bytes() if self.has(place) else None

    def write(self, place: str, content: bytes) -> None:
        """Write a file, whole or not at all."""
        atomic_write_bytes(self._aside / place, content)

    def finish(self, expected: Collection[str]) -> int:
        """Remove all but the expected files, and give the folder its name.

        Returns:
            Size of the files [bytes].
        """
        kept = {self._aside / place for place in (*expected, MANIFEST_NAME)}
        for path in sorted(self._aside.rglob("*"), reverse=True):  # files before their folders
            if path.is_dir():
                with suppress(OSError):  # not empty
                    path.rmdir()
            elif path not in kept:
                path.unlink()
        shutil.rmtree(self._older, ignore_errors=True)
        if self._site.exists():
            self._site.rename(self._older)
        self._aside.rename(self._site)
        shutil.rmtree(self._older, ignore_errors=True)
        return sum(path.stat().st_size for path in self._site.rglob("*") if path.is_file())

    def _is_like_older(self) -> bool:
        return read_claim(self._site) == self._settings


def _check_own(folder: Path) -> None:
    if not folder.exists():
        return
    if not folder.is_dir():
        raise ValueError(f"{folder} is no folder; name another place for the export")
    names = {each.name for each in folder.iterdir()}
    claim = read_claim(folder)
    is_own = claim is not None and claim.get("made_by") == SiteFolder.made_by
    foreign = sorted(name for name in names if not is_temporary(name))
    if is_own:
        foreign = [name for name in foreign if name not in _OWN_NAMES]
    if foreign:
        raise ValueError(
            f"{folder} holds {foreign[0]}, which no export wrote; name a new or empty folder"
        )
