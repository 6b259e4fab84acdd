"""Files that are either whole or not there."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sightline.data.aside import final_place, folder_beside

_DISK_FAULTS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
_NO_HARD_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK)
_OTHER_DISK = errno.EXDEV


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Gives a path to write to; the file appears under its own name only once it is whole.

    The file is written aside in a hidden folder next to its place, under the same name (so that a
    library which goes by the suffix is content), and renamed when the block ends well. When it
    ends with any exception, Ctrl-C included, nothing is left behind and an older file stays as it
    was. Parent folders are made where they are missing. A symbolic link in the file's own place is
    replaced and never followed, so that nothing is written where it leads; those among the folders
    above it are: see `check_links`. A crash of the whole machine is not guarded against: nothing is
    flushed to the disk.

    Args:
        path: Where the file shall stand.

    Raises:
        ValueError: The folder cannot be written to, `path` is a folder or a device, or the disk is
            full or broken.
    """
    target = _place(path)
    check_replaceable(target)
    with folder_beside(target) as aside, _naming_disk_faults(target):
        yield aside / target.name
        # Only now: a file of the old content must survive everything up to here.
        (aside / target.name).replace(target)


def _place(path: Path | str) -> Path:
    """The file's place by its real folder."""
    path = Path(path)
    if path.name in ("", ".."):
        return Path(os.path.realpath(path))
    return Path(os.path.realpath(path.parent), path.name)


@contextmanager
def _naming_disk_faults(target: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        fault = disk_fault(error, target)
        if fault is None:
            raise
        raise fault from error


def disk_fault(error: OSError, target: Path) -> ValueError | None:
    """The error that names what was being written to a disk that is full or broken; else None."""
    if error.errno not in _DISK_FAULTS:
        return None
    reason = os.strerror(error.errno).lower()
    return ValueError(
        f"{final_place(target)} cannot be written: {reason}; make room or choose another output "
        "folder"
    )


def check_replaceable(target: Path) -> None:
    """Refuses a place where something else than a file stands.

    Raises:
        ValueError: It is a folder, a device or a pipe, or a link of the system's to one's own
            streams, such as /dev/stdout.
    """
    is_system_link = target.is_symlink() and target.parts[1:2] in (("dev",), ("proc",))
    if is_system_link or (target.exists() and not target.is_file()):
        raise ValueError(f"{target} cannot be written: it is no regular file; choose another name")


def check_writable(path: Path | str) -> None:
    """Refuses, before long work for it, a place where `atomic_path` could not write; makes nothing.

    Raises:
        ValueError: Something else than a file stands there, or its folder, or the nearest above it
            where that is missing, is none or cannot be written to.
    """
    target = _place(path)
    check_replaceable(target)
    folder = next(each for each in target.parents if each.exists())
    if not folder.is_dir():
        raise ValueError(f"{target} cannot be written: {folder} is no folder; choose another name")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ValueError(
            f"{target} cannot be written: folder {folder} may not be written to; make it writable "
            "or choose another name"
        )


def atomic_write_bytes(path: Path | str, content: bytes) -> None:
    """Writes a whole file or none, as `atomic_path` does."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def atomic_write_text(path: Path | str, text: str) -> None:
    """Writes a whole text file or none, as `atomic_path` does.

    UTF-8, line ends as given. Bytes of another encoding, which a folder's name may hold, are
    written as escapes.
    """
    atomic_write_bytes(path, text.encode(errors="backslashreplace"))


def atomic_link(path: Path | str, source: Path | str) -> None:
    """Gives a file a second name that takes no room, by a hard link; elsewhere makes a whole copy.

    Elsewhere is another disk, or one without hard links. Whatever rewrites one of the two names as
    `atomic_path` does leaves the other as it was; what writes into the file in place changes both.

    Args:
        path: The new name; a file there is replaced.
        source: The file; of a symbolic link, what it leads to.

    Raises:
        ValueError: As `atomic_path`.
        OSError: The source cannot be read.
    """
    original = os.path.realpath(source)
    with atomic_path(path) as temporary:
        try:
            os.link(original, temporary)
        except OSError as error:
            if error.errno not in (*_NO_HARD_LINKS, _OTHER_DISK):
                raise
            shutil.copyfile(original, temporary)


def atomic_create_text(path: Path | str, text: str) -> bool:
    """Writes a text file (UTF-8) that is not there yet, whole at once.

    Of several processes that do so at one time, on one machine or on several, one succeeds.

    Returns:
        Whether this call wrote it; False where there is such a file already, which stays.

    Raises:
        ValueError: As `atomic_path`.
    """
    target = _place(path)
    check_replaceable(target)
    with folder_beside(target) as aside, _naming_disk_faults(target):
        (aside / target.name).write_bytes(text.encode())
        try:
            os.link(aside / target.name, target)
        except FileExistsError:
            return False
        except OSError as error:
            if error.errno not in _NO_HARD_LINKS:
                raise
            return _create_exclusively(target, text)
        return True


def _create_exclusively(target: Path, text: str) -> bool:
    """The same on a disk without hard links (exFAT, say): for a moment the file is there empty."""
    try:
        file = target.open("xb")
    except FileExistsError:
        return False
    try:
        with file:
            file.write(text.encode())
    except BaseException:
        target.unlink(missing_ok=True)  # a part of it would stand for the whole
        raise
    return True
