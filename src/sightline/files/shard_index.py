"""Shards: tars of a data set's files, each with an index by which files are read out of it."""

import json
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from sightline.files.byte_source import RefusedError, read_range, read_small, url_of
from sightline.files.problem import FileError
from sightline.files.safe_names import relative_parts

MANIFEST: Final = "shards.json"
"""Manifest of a folder of shards: data set, number of frames, frames in a shard."""
SHARED: Final = "shared"
"""Name of the tar with the files that belong to no frame, such as lists and calibrations."""
FORMAT: Final = "sightline shard 1"
PACKED_SUFFIX: Final = ".gz"

MAX_MEMBER_BYTES: Final = 2**30
"""Largest length of a file in a shard, unpacked."""
_MAX_INDEX_BYTES: Final = 2**28
_MAX_MANIFEST_BYTES: Final = 2**26
MAX_SHARDS: Final = 100_000
"""Most shards of a folder: a manifest that is made up must not fill the memory with names."""
_MARK: Final = b"sightline shard"
_MARK_BYTES: Final = 64  # from the beginning of a manifest
SHARD_REMEDY: Final = "copy it again, or run the command again that packed it"
"""Advice for a shard that is damaged or missing."""
_NO_FORMAT: Final = (
    ValueError,
    TypeError,
    LookupError,
    RecursionError,
    OverflowError,  # of 1e999 as a whole number
)
_GZIP: Final = 31  # zlib's window bits for gzip's header


@dataclass(frozen=True, kw_only=True, slots=True)
class Member:
    """A file in a tar."""

    tar: Path
    name: str
    """Name in the tar; ends in `.gz` if the file is packed."""
    offset: int
    """Place of the first byte."""
    stored: int
    """Length in the tar."""
    size: int
    """Length of the file."""
    crc32: int

    def read(self) -> bytes:
        """Read the file.

        Raises:
            FileError: The tar cannot be read, or the file in it is damaged.
        """
        content = read_range(self.tar, self.offset, self.stored)
        if self.name.endswith(PACKED_SUFFIX):
            packed = zlib.decompressobj(_GZIP)
            try:  # never more than the length that the readers have accepted, and one byte
                content = packed.decompress(content, self.size + 1)
            except zlib.error:
                content = b""
        if len(content) != self.size or zlib.crc32(content) != self.crc32:
            raise FileError(
                self.tar,
                f"is damaged: {self.name} in it has another checksum",
                SHARD_REMEDY,
            )
        return content


@dataclass(frozen=True, kw_only=True, slots=True)
class ShardIndex:
    """Contents of a tar."""

    tar: Path
    sha256: str
    num_bytes: int
    files: Mapping[str, Member]
    """Files by their path in the data set."""
    source_sha256: str | None = None
    """Checksum of the shard of frames that these results are of; None: unknown, or no results."""

    def to_json(self) -> str:
        """Format the index as the text of its file."""
        rows = [
            [path, each.name, each.offset, each.stored, each.size, each.crc32]
            for path, each in self.files.items()
        ]
        head: dict[str, object] = {"format": FORMAT, "sha256": self.sha256, "bytes": self.num_bytes}
        if self.source_sha256 is not None:
            head["source_sha256"] = self.source_sha256
        lines = ",\n".join(json.dumps(row) for row in rows)
        return f'{json.dumps(head)[:-1]}, "files": [\n{lines}\n]}}\n'


def index_path(tar: Path) -> Path:
    """Path of a tar's index."""
    return tar.with_suffix(".json")


def read_index(tar: Path) -> ShardIndex | None:
    """Read the index beside a tar; None: there is none.

    Raises:
        FileError: The index is damaged, or names a file outside the data set or the tar.
    """
    path = index_path(tar)
    content = read_small(path, _MAX_INDEX_BYTES)
    if content is None:
        return None
    try:
        data = json.loads(content)
        if data["format"] != FORMAT:
            raise ValueError
        num_bytes, sha256 = int(data["bytes"]), str(data["sha256"])
        source_sha256 = data.get("source_sha256")
        rows = [(str(row[0]), _member(tar, row, num_bytes)) for row in data["files"]]
    except _NO_FORMAT as error:
        raise FileError(path, "is no index of a shard", SHARD_REMEDY) from error
    members = dict(rows)
    if len(members) != len(rows):
        raise FileError(path, "names a file twice", SHARD_REMEDY)
    for name in members:
        relative_parts(name, path, "a file's path")
    return ShardIndex(
        tar=tar,
        sha256=sha256,
        num_bytes=num_bytes,
        files=members,
        source_sha256=None if source_sha256 is None else str(source_sha256),
    )


def _member(tar: Path, row: Any, num_bytes: int) -> Member:  # noqa: ANN401 - any JSON
    _, name, offset, stored, size, crc32 = row
    numbers = [int(each) for each in (offset, stored, size, crc32)]
    if min(numbers) < 0 or numbers[2] > MAX_MEMBER_BYTES or numbers[0] + numbers[1] > num_bytes:
        raise ValueError
    if not str(name).endswith(PACKED_SUFFIX) and numbers[1] != numbers[2]:
        raise ValueError
    return Member(
        tar=tar,
        name=str(name),
        offset=numbers[0],
        stored=numbers[1],
        size=numbers[2],
        crc32=numbers[3],
    )


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Read the manifest of a folder of shards; None: it is no such folder.

    Raises:
        FileError: The manifest is damaged, or does not count the shards beside it.
    """
    content = read_small(folder / MANIFEST, _MAX_MANIFEST_BYTES)
    if content is None or _MARK not in content[:_MARK_BYTES]:  # another file of this name
        return None
    try:
        data = json.loads(content)
        numbers = int(data["frames"]), int(data["frames_per_shard"])
        if data["format"] != FORMAT or min(numbers) < 1 or not isinstance(data["data"], str):
            raise ValueError
    except _NO_FORMAT as error:
        raise FileError(folder / MANIFEST, "is no manifest of shards", SHARD_REMEDY) from error
    count = -(-numbers[0] // numbers[1])
    if count > MAX_SHARDS:
        problem = f"counts {count} shards, expected at most {MAX_SHARDS}"
        raise FileError(folder / MANIFEST, problem, SHARD_REMEDY)
    following = folder / f"{count:06d}.json"
    if _is_there(following):
        problem = f"counts {count} shards, but there is {following.name}"
        raise FileError(folder / MANIFEST, problem, SHARD_REMEDY)
    return dict(data)


def _is_there(path: Path) -> bool:
    if url_of(path) is None:
        return path.is_file()
    try:
        return read_small(path, _MAX_INDEX_BYTES) is not None
    except RefusedError:  # a store without listing answers so for what is not there
        return False


def tars_of(folder: Path, frames: int, frames_per_shard: int) -> tuple[Path, ...]:
    """Tars of a folder of shards: that of the shared files, and one for each shard."""
    count = -(-frames // frames_per_shard)
    return (
        folder / f"{SHARED}.tar",
        *(folder / f"{position:06d}.tar" for position in range(count)),
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class ShardTree:
    """Files of one or more tars as the tree that they were packed from."""

    files: Mapping[str, Member]
    folders: Mapping[str, tuple[str, ...]]
    """Names in each folder, sorted; the root is the empty path."""
    lengths: Mapping[Path, int]
    """Length of each tar by its index."""


def open_tree(root: Path) -> ShardTree | None:
    """Open a folder of shards, or a single tar with its index; None: `root` is neither.

    Raises:
        FileError: A shard's index is missing or damaged.
    """
    if url_of(root) is not None:
        return _read_tree(root)
    if root.suffix == ".tar":
        if not root.is_file() or not index_path(root).is_file():
            return None
        shared = index_path(root.with_name(f"{SHARED}.tar"))
        return _kept_tree(root.absolute(), (_stamp(index_path(root)), _stamp(shared)))
    manifest, shared = root / MANIFEST, index_path(root / f"{SHARED}.tar")
    if not manifest.is_file():
        return None
    return _kept_tree(root.absolute(), (_stamp(manifest), _stamp(shared)))


def _stamp(path: Path) -> tuple[int, ...]:
    """Identity of a file's content; empty: there is no such file."""
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_mtime_ns, status.st_size, status.st_ino


@lru_cache(maxsize=16)
def _kept_tree(root: Path, stamps: tuple[tuple[int, ...], ...]) -> ShardTree | None:
    del stamps  # another one means that the shards were made anew
    return _read_tree(root)


def _read_tree(root: Path) -> ShardTree | None:
    if root.suffix == ".tar":
        indexes = [read_index(root)]
        if indexes[0] is not None:
            indexes.append(read_index(root.with_name(f"{SHARED}.tar")))
    else:
        manifest = read_manifest(root)
        if manifest is None:
            return None
        tars = tars_of(root, int(manifest["frames"]), int(manifest["frames_per_shard"]))
        indexes = [_required(tar) for tar in tars]
    found = [each for each in indexes if each is not None]
    files: dict[str, Member] = {}
    for index in found:
        both = files.keys() & index.files.keys()
        if both:
            problem = f"names {min(both)}, which another shard holds, too"
            raise FileError(index_path(index.tar), problem, SHARD_REMEDY)
        files |= index.files
    lengths = {index.tar: index.num_bytes for index in found}
    return ShardTree(files=files, folders=_folders(files), lengths=lengths) if found else None


def _required(tar: Path) -> ShardIndex:
    index = read_index(tar)
    if index is None:
        path = index_path(tar)
        raise FileError(path, "is missing: the shard is not whole", SHARD_REMEDY)
    return index


def _folders(files: Mapping[str, Member]) -> dict[str, tuple[str, ...]]:
    names: dict[str, set[str]] = {"": set()}
    for path in files:
        for folder, name in _places(path):
            names.setdefault(folder, set()).add(name)
    return {folder: tuple(sorted(each)) for folder, each in names.items()}


def _places(path: str) -> Iterator[tuple[str, str]]:
    while path:
        folder, _, name = path.rpartition("/")
        yield folder, name
        path = folder
