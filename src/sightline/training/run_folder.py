"""Lock of a run's folder for one training at a time."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sightline.files.atomic import check_links

_CLAIM = ".claim"


def check_name(folder: Path) -> None:
    """Refuse a folder whose name TensorBoard's library cannot write to: one that is not UTF-8.

    Raises:
        ValueError: The path holds bytes of another encoding.
    """
    try:
        str(folder).encode()
    except UnicodeEncodeError as error:
        raise ValueError(
            f"{folder}: the name is not UTF-8, and TensorBoard's files cannot be written there; "
            "rename the folder, or change into it and give a relative --run_folder"
        ) from error


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Lock a folder against other trainings until the block or the process ends.

    The operating system holds the lock, on a file that stays; nothing needs cleaning up.

    Raises:
        ValueError: Another process is training in the folder, it cannot be written to, or a link in
            it leads outside.
    """
    check_links(folder, files=True)  # Lightning and TensorBoard follow them
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / _CLAIM).open("a+")
    except OSError as error:
        raise ValueError(
            f"{folder} cannot be written to ({error.strerror}); name another with --run_folder"
        ) from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            file.seek(0)
            raise ValueError(
                f"another training (process {file.read().strip()}) is running in {folder}; wait "
                "for its end, or name another folder with --run_folder"
            ) from error
        # A worker process that outlives this one for a moment must not hold the lock.
        os.register_at_fork(after_in_child=file.close)
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield
