"""Reader of bag files with a limit on the size of decompressed data."""

import bz2
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final, Protocol

from sightline.files.plain_text import shortened
from sightline.files.plain_yaml import read_yaml
from sightline.files.problem import FileError
from sightline.files.safe_names import path_below

if TYPE_CHECKING:
    from rosbags.rosbag1 import Reader as Ros1Reader
    from rosbags.rosbag2.storage_mcap import McapReader
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

    Reader = Ros1Reader | McapReader | Sqlite3Reader

SUFFIXES: Final = (".mcap", ".db3", ".bag")
"""Suffixes of bags in one file."""
METADATA_NAME: Final = "metadata.yaml"
MAX_UNPACKED_BYTES: Final = 2**29
"""Largest decompressed chunk or message: recorders write chunks of some megabytes."""

_MAX_METADATA_BYTES: Final = 2**20
_MAX_GAIN: Final = 1000
"""Largest compression ratio of a whole file; for sensor data it is about 10."""
_MAX_BLOB_BYTES: Final = 2**28
_STEP_BYTES: Final = 2**22
_REMEDY: Final = "import a bag that is whole (`ros2 bag reindex` writes its metadata.yaml anew)"


class _Unpacker(Protocol):
    """Incremental decompressor, as in `bz2`, `lz4` and `zstd`."""

    eof: bool
    needs_input: bool
    unused_data: bytes | None

    def decompress(self, data: bytes, max_length: int = -1, /) -> bytes: ...


def unpacked(new: Callable[[], Any], packed: bytes, limit: int) -> bytes:
    """Decompress within a limit.

    Args:
        new: Creates a decompressor of one frame.
        packed: One compressed frame or several.
        limit: Largest number of decompressed bytes.

    Raises:
        ValueError: The frames decompress to more, or are truncated.
    """
    parts: list[bytes] = []
    room = limit
    while packed:
        unpacker: _Unpacker = new()
        parts.append(unpacker.decompress(packed, min(room + 1, _STEP_BYTES)))
        room -= len(parts[-1])
        while room >= 0 and not unpacker.eof:
            parts.append(unpacker.decompress(b"", min(room + 1, _STEP_BYTES)))
            room -= len(parts[-1])
            if not parts[-1] and unpacker.needs_input:
                raise ValueError("compressed data are cut short")
        if room < 0:
            raise ValueError(f"compressed data unpack to more than {limit} bytes")
        packed = unpacker.unused_data or b""
    return b"".join(parts)


def unpacked_zstd(packed: bytes) -> bytes:
    """Decompress a message; errors as in `unpacked`."""
    return unpacked(_zstd().ZstdDecompressor, packed, MAX_UNPACKED_BYTES)


def lone_files(folder: Path) -> list[Path]:
    """List the files of a split drive, or of a bag without metadata.yaml."""
    if not folder.is_dir() or (folder / METADATA_NAME).is_file():
        return []
    return sorted(path for path in folder.iterdir() if path.suffix in SUFFIXES)


@contextmanager
def open_files(path: Path) -> Iterator[tuple[list["Reader"], bool]]:
    """Open the files of a bag, with limits on their decompressed size.

    Yields:
        Their readers, and whether single messages are compressed (zstd).

    Raises:
        Exception: Any error of the library for a damaged file.
    """
    from rosbags.rosbag1 import Reader as Ros1Reader
    from rosbags.rosbag2.storage_mcap import McapReader
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

    kinds: dict[str, Any] = {".mcap": McapReader, ".db3": Sqlite3Reader, ".bag": Ros1Reader}
    with ExitStack() as stack:
        stack.enter_context(_bounded_library())
        packing = ""
        paths = lone_files(path) or [path]
        if path.is_dir() and not lone_files(path):
            paths, packing = _listed_files(path)
            if packing == "file":
                folder = Path(stack.enter_context(TemporaryDirectory(prefix="sightline-bag-")))
                paths = [_unpacked_file(each, folder) for each in paths]
        readers: list[Reader] = []
        for each in paths:
            if each.suffix not in kinds:
                raise FileError(each, f"is none of {', '.join(SUFFIXES)}", _REMEDY)
            reader = kinds[each.suffix](each)
            reader.open()
            stack.callback(reader.close)
            if isinstance(reader, Sqlite3Reader) and reader.dbconn is not None:
                import apsw

                reader.dbconn.limit(apsw.SQLITE_LIMIT_LENGTH, _MAX_BLOB_BYTES)
            readers.append(reader)
        yield readers, packing == "message"


def _listed_files(folder: Path) -> tuple[list[Path], str]:
    """Read a bag's files and kind of compression ("", "message", "file") from metadata.yaml."""
    path = folder / METADATA_NAME
    said = read_yaml(path, _REMEDY, max_bytes=_MAX_METADATA_BYTES)
    match said:
        case {"rosbag2_bagfile_information": {"relative_file_paths": [*names]} as about} if names:
            pass
        case _:
            problem = "lacks relative_file_paths in rosbag2_bagfile_information"
            raise FileError(path, problem, _REMEDY)
    paths = []
    for number, name in enumerate(names, start=1):
        # Old recorders wrote names with the bag's folder.
        plain = name.rpartition("/")[2] if isinstance(name, str) else name
        each = path_below(folder, plain, path, f"relative_file_paths: entry {number}")
        if not each.is_file():
            raise FileError(path, f"names {each}, which is not there", _REMEDY)
        paths.append(each)
    mode = str(about.get("compression_mode") or "").lower()
    kind = str(about.get("compression_format") or "")
    if mode in ("", "none"):
        return paths, ""
    if mode not in ("file", "message") or kind != "zstd":
        problem = (
            f"says compression {shortened(mode, 20)} by {shortened(kind, 20)!r}, expected zstd"
        )
        raise FileError(path, problem, "convert the bag (`ros2 bag convert`)")
    return paths, mode


def _unpacked_file(path: Path, folder: Path) -> Path:
    """Decompress a file into a folder, under its name without the last suffix."""
    target = folder / path.stem
    room = path.stat().st_size * _MAX_GAIN
    with path.open("rb") as packed, _zstd().open(packed, "rb") as source, target.open("wb") as file:
        while block := source.read(_STEP_BYTES):
            room -= len(block)
            if room < 0:
                problem = f"unpacks to more than {_MAX_GAIN} times its size"
                raise FileError(path, problem, _REMEDY)
            file.write(block)
    return target


@contextmanager
def _bounded_library() -> Iterator[None]:
    """Make `rosbags` decompress chunks within limits, and ignore quality of service.

    `rosbags` has no limit of its own: a chunk of 10 MB may decompress to any size. Quality of
    service is YAML in each topic that is not needed here; any fault in it would make the bag
    unreadable.
    """
    from lz4.frame import LZ4FrameDecompressor
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import storage_mcap, storage_sqlite3

    zstd = _zstd().ZstdDecompressor
    chunks = {
        "": lambda data, _: data,
        "lz4": lambda data, size: unpacked(LZ4FrameDecompressor, data, _announced(size)),
        "zstd": lambda data, size: unpacked(zstd, data, _announced(size)),
    }
    old_chunks = {
        "none": lambda data: data,
        "bz2": lambda data: unpacked(bz2.BZ2Decompressor, data, MAX_UNPACKED_BYTES),
        "lz4": lambda data: unpacked(LZ4FrameDecompressor, data, MAX_UNPACKED_BYTES),
    }
    changes: list[tuple[Any, str, object]] = [
        (storage_mcap, "DECOMPRESSORS", chunks),
        (ros1, "decompressors", old_chunks),
        (storage_mcap, "parse_qos", lambda _: []),
        (storage_sqlite3, "parse_qos", lambda _: []),
    ]
    before = [(module, name, getattr(module, name)) for module, name, _ in changes]
    try:
        for module, name, value in changes:
            setattr(module, name, value)
        yield
    finally:
        for module, name, value in before:
            setattr(module, name, value)


def _announced(size: int) -> int:
    if size > MAX_UNPACKED_BYTES:
        raise ValueError(f"a chunk announces {size} bytes, expected up to {MAX_UNPACKED_BYTES}")
    return size


def _zstd() -> Any:  # noqa: ANN401 - a module
    """Module with which `rosbags` decompresses; from Python's library since 3.14."""
    from rosbags.rosbag2 import storage_mcap

    return vars(storage_mcap)["zstd"]
