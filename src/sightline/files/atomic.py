"""Atomic file writes, and checks of their targets."""

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sightline.files.byte_source import check_no_address
from sightline.files.problem import SetupError
from sightline.files.shard_path import ShardPath
from sightline.files.temporary_folder import (
    final_path,
    make_locked,
    remove_locked,
    temporary_folder,
)

_DISK_FAULTS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path to write to, and rename the file to its own name once it is complete.

    The file is written to a hidden folder next to its target, under the same name (some libraries
    depend on the suffix), and renamed if the block ends without an exception. After any exception,
    Ctrl-C included, nothing is left behind and an existing file is unchanged. Missing parent
    folders are created. A symbolic link at the target is replaced, never followed; links among the
    parent folders are followed: see `check_links`. The content is on the disk before the file has
    its name, so that a crash of the machine leaves no empty or cut file behind.

    Args:
        path: Target path of the file.

    Raises:
        ValueError: The folder cannot be written to, `path` is a folder or a device, or the disk is
            full or broken.
    """
    target = _resolved(path)
    check_replaceable(target)
    with temporary_folder(target) as folder, _naming_disk_faults(target):
        yield folder / target.name
        _flush(folder / target.name)
        # Only now: the old file must survive everything up to here.
        (folder / target.name).replace(target)


def _flush(path: Path) -> None:
    """Write a file's content to the disk, where the file system can."""
    if path.is_symlink() or not path.is_file() or not path.stat().st_size:
        return
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    except OSError as error:
        if error.errno in _DISK_FAULTS:
            raise
    finally:
        os.close(file)


def _resolved(path: Path | str) -> Path:
    """Resolve the folder of a path, which must be no address."""
    path = Path(path)
    check_no_address(path)
    if path.name in ("", ".."):
        return Path(os.path.realpath(path))
    return Path(os.path.realpath(path.parent), path.name)


class DiskError(SetupError):
    """Error for a disk that is full or broken, whatever is written."""


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Create a folder in TMPDIR for intermediate files, and remove it at the end of the block.

    A killed process leaves its folder behind; the next process that needs one removes it.

    Raises:
        DiskError: No folder can be created, or its disk is full or broken.
    """
    remedy = "make room, or name another temporary folder by the variable TMPDIR"
    try:
        folder, lock = make_locked(Path(tempfile.gettempdir()))
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise DiskError(f"no temporary folder can be made: {reason}; {remedy}") from error
    try:
        yield folder
    except OSError as error:
        if error.errno not in _DISK_FAULTS:
            raise
        reason = os.strerror(error.errno).lower()
        raise DiskError(
            f"temporary folder {folder.parent} is unusable: {reason}; {remedy}"
        ) from error
    finally:
        remove_locked(folder, lock)


@contextmanager
def _naming_disk_faults(target: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        fault = disk_fault(error, target)
        if fault is None:
            raise
        raise fault from error


def disk_fault(error: OSError, target: Path) -> DiskError | None:
    """Make an error with the target of a write to a full or broken disk; None: another cause."""
    if error.errno not in _DISK_FAULTS:
        return None
    reason = os.strerror(error.errno).lower()
    path = final_path(target)
    remedy = "make room or choose another output folder"
    if tempfile.tempdir is not None and path.is_relative_to(tempfile.tempdir):
        remedy += ", or another temporary folder by the variable TMPDIR"
    return DiskError(f"{path} cannot be written: {reason}; {remedy}")


def check_replaceable(target: Path) -> None:
    """Refuse a target that exists and is not a file.

    Raises:
        ValueError: The target is a folder, a device or a pipe, or a system link to standard
            streams, such as /dev/stdout.
    """
    is_system_link = target.is_symlink() and target.parts[1:2] in (("dev",), ("proc",))
    if is_system_link or (target.exists() and not target.is_file()):
        raise ValueError(f"{target} cannot be written: it is no regular file; choose another name")


def check_writable(path: Path | str) -> None:
    """Refuse, before long work, a target that `atomic_path` could not write; creates nothing.

    Raises:
        ValueError: The target is not a file, or its nearest existing parent is not a folder or
            cannot be written to.
    """
    target = _resolved(path)
    check_replaceable(target)
    folder = next(each for each in target.parents if each.exists())
    if not folder.is_dir():
        raise ValueError(f"{target} cannot be written: {folder} is no folder; choose another name")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ValueError(
            f"{target} cannot be written: folder {folder} may not be written to; make it writable "
            "or choose another name"
        )


def check_links(folder: Path, *, files: bool = False) -> None:
    """Refuse an output folder with a broken link or a link to a folder outside.

    The folder itself may be a link, and links may lead to other places inside it. A link to a file
    is harmless for files written by `atomic_path`, which replaces the link.

    Args:
        folder: Output folder; may be missing.
        files: Whether to refuse links to files, too: for libraries, which follow them.

    Raises:
        ValueError: The folder contains such a link.
    """
    inside = os.path.realpath(folder)
    for link in _links(folder):
        target = Path(os.path.realpath(link))
        where = f"outside {folder}" if target.exists() else "which does not exist"
        if target.exists() and (target.is_relative_to(inside) or (target.is_file() and not files)):
            continue
        raise ValueError(
            f"{link} is a link to {target}, {where}, and nothing may be written there; "
            "remove the link, or name another output folder"
        )


def _links(folder: Path) -> Iterator[Path]:
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_symlink():
                yield Path(entry.path)
            elif entry.is_dir():
                yield from _links(Path(entry.path))


def atomic_write_bytes(path: Path | str, content: bytes) -> None:
    """Write a file atomically; see `atomic_path`."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def atomic_write_text(path: Path | str, text: str) -> None:
    """Write a text file atomically; see `atomic_path`.

    UTF-8, line ends as given. Bytes of another encoding, which folder names may contain, are
    written as escapes.
    """
    atomic_write_bytes(path, text.encode(errors="backslashreplace"))


def atomic_link(path: Path | str, source: Path | str) -> None:
    """Create a second name of a file by a hard link, or a copy if links are not possible.

    Links are not possible to another disk, or on disks without hard links. An atomic rewrite of one
    name leaves the other unchanged; a write in place changes both.

    Args:
        path: The new name; an existing file is replaced.
        source: The file; a symbolic link is resolved, a file in shards is copied.

    Raises:
        ValueError: See `atomic_path`.
        OSError: The source cannot be read.
    """
    if isinstance(source, ShardPath):
        atomic_write_bytes(path, source.read_bytes())
        return
    original = os.path.realpath(source)
    with atomic_path(path) as temporary:
        try:
            os.link(original, temporary)
        except OSError as error:
            if error.errno in _DISK_FAULTS:
                raise
            shutil.copyfile(original, temporary)


def atomic_create_text(path: Path | str, text: str) -> bool:
    """Write a new text file (UTF-8) atomically, if it does not exist.

    Of several concurrent processes, on one machine or on several, exactly one succeeds.

    Returns:
        Whether this call wrote the file; False: it already existed and is unchanged.

    Raises:
        ValueError: See `atomic_path`.
    """
    target = _resolved(path)
    check_replaceable(target)
    with temporary_folder(target) as folder, _naming_disk_faults(target):
        (folder / target.name).write_bytes(text.encode())
        _flush(folder / target.name)
        try:
            os.link(folder / target.name, target)
        except FileExistsError:
            return False
        except OSError as error:
            if error.errno in _DISK_FAULTS:
                raise
            return _create_exclusively(target, text)
        return True


def _create_exclusively(target: Path, text: str) -> bool:
    """Create the file on a disk without hard links, such as exFAT; it is briefly visible empty.

    File systems refuse links with various errors: EPERM, EXDEV, EACCES, EINVAL, ..
    """
    try:
        file = target.open("xb")
    except FileExistsError:
        return False
    try:
        with file:
            file.write(text.encode())
    except BaseException:
        target.unlink(missing_ok=True)  # a partial file would count as complete
        raise
    return True
