"""Shards compared with their indexes."""

import hashlib
from collections.abc import Iterator
from pathlib import Path

from sightline.files.byte_source import url_of
from sightline.files.problem import FileError, Problem
from sightline.files.shard_index import SHARD_REMEDY, SHARED, ShardIndex, read_index
from sightline.files.shard_path import shared_tar, tar_lengths


def is_whole(tar: Path, *, source_sha256: str | None = None) -> bool:
    """Test whether a shard is whole: tar and index exist, and the checksum is the index's.

    One of results must also be of the given shard of frames, unless that is None.
    """
    try:
        index = read_index(tar)
        return (
            index is not None
            and source_sha256 in (None, index.source_sha256)
            and _fault(index) is None
        )
    except ValueError:
        return False


def _fault(index: ShardIndex) -> str | None:
    """Difference of a tar to its index; None: it is whole."""
    try:
        if not index.tar.is_file():  # a device, say, may have no end
            return "is missing, or no regular file"
        length = index.tar.stat().st_size
        if length != index.num_bytes:
            return f"is {length} bytes long, expected {index.num_bytes}"
        digest, _ = tar_digest(index.tar)
    except OSError as error:
        return f"cannot be read: {(error.strerror or str(error)).lower()}"
    return None if digest == index.sha256 else "is damaged: it has another checksum"


def shared_problem(data: Path) -> Problem | None:
    """Problem of the tar of files that belong to no frame; None: it is whole, or not in use.

    On this machine its checksum is compared; at an address, each of its files is read.

    Raises:
        FileError: The shards are damaged or cannot be read.
    """
    tar = shared_tar(data)
    index = None if tar is None else read_index(tar)
    if index is None:
        return None
    try:
        if url_of(index.tar) is None:
            check_whole(index)
        else:
            for member in index.files.values():
                member.read()
    except FileError as error:
        return error.problem
    return None


def longer_tars(data: Path) -> Iterator[Problem]:
    """Yield a problem for each tar of frames that is longer than its index tells.

    Nothing is read: the tars of other lengths fail where a file in them is read.

    Raises:
        FileError: The shards are damaged or cannot be read.
    """
    for tar, expected in tar_lengths(data).items():
        try:
            length = 0 if url_of(tar) is not None else tar.stat().st_size
        except OSError:  # told where a file in it is read
            continue
        if length > expected and tar.stem != SHARED:
            problem = f"is {length} bytes long, expected {expected} by its index"
            yield Problem(path=tar, problem=problem, remedy=SHARD_REMEDY)


def check_whole(index: ShardIndex) -> None:
    """Refuse a shard whose tar differs from its index.

    Raises:
        FileError: It is missing, damaged or cannot be read.
    """
    fault = _fault(index)
    if fault is not None:
        raise FileError(index.tar, fault, SHARD_REMEDY)


def tar_digest(tar: Path) -> tuple[str, int]:
    """Checksum (SHA-256) and length of a file."""
    with tar.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest(), file.tell()
