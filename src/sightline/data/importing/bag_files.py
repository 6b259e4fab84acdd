"""Files of bags: their list by folder or metadata.yaml, and their readers."""

import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

from sightline.data.datasets.newer_frames import changed_at
from sightline.data.importing.bag_limits import STEP_BYTES, bounded_library, zstd_module
from sightline.files.leftovers import is_leftover
from sightline.files.plain_file import check_no_pointer, read_start
from sightline.files.plain_text import shortened
from sightline.files.plain_yaml import read_yaml
from sightline.files.problem import FileError
from sightline.files.safe_names import path_below
from sightline.geometry.user_warning import warn_user

if TYPE_CHECKING:
    from rosbags.rosbag1 import Reader as Ros1Reader
    from rosbags.rosbag2.storage_mcap import McapReader
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

    Reader = Ros1Reader | McapReader | Sqlite3Reader

SUFFIXES: Final = (".mcap", ".db3", ".bag")
"""Suffixes of bags in one file, in any case."""
_PACKED_SUFFIXES: Final = (".zstd", ".zst", ".gz", ".bz2", ".xz", ".lz4", ".zip")
_OPEN_SUFFIX: Final = ".active"  # of a bag that is being recorded, by `rosbag record`
_NOT_CLOSED_REMEDY: Final = "repair it by `mcap recover`, `ros2 bag reindex` or `rosbag reindex`"
METADATA_NAME: Final = "metadata.yaml"
_MAX_METADATA_BYTES: Final = 2**24
_MAX_COMPRESSION_RATIO: Final = 1000
"""Largest compression ratio of a whole file; for sensor data it is about 10."""
_MAX_BLOB_BYTES: Final = 2**28
_JOURNAL_MAGIC_BYTES: Final = 8
_REMEDY: Final = "import an intact bag (`ros2 bag reindex` rewrites its metadata.yaml)"
CONVERSION_REMEDY: Final = "convert it to a ROS 2 bag with messages in CDR"
_CHUNK_COMPRESSIONS: Final = ("", "lz4", "zstd")  # of MCAP


Counts = dict[tuple[str, str], int]
"""Numbers of messages that metadata.yaml counts, by topic and type."""


def files_without_metadata(folder: Path) -> list[Path]:
    """List the files of a split drive, or of a bag without metadata.yaml."""
    if not folder.is_dir() or (folder / METADATA_NAME).is_file():
        return []
    return sorted(path for path in _visible_files(folder) if is_bag_file(path))


def is_bag_file(path: Path) -> bool:
    """Whether a file has the name of a ROS bag: its ending, in any case."""
    return path.suffix.lower() in SUFFIXES


def unread_bag(path: Path) -> FileError | None:
    """Fault of a bag that is packed or not closed, or of a folder of such bags; None: no such."""
    files = [path] if path.is_file() else _visible_files(path) if path.is_dir() else []
    for each in sorted(files):
        if not is_bag_file(each.with_suffix("")):
            continue
        if each.suffix.lower() in _PACKED_SUFFIXES:
            return FileError(each, "is a packed bag", "unpack it, and import what comes out")
        if each.suffix.lower() == _OPEN_SUFFIX:
            remedy = f"{_NOT_CLOSED_REMEDY}, and rename it without {_OPEN_SUFFIX}"
            return FileError(each, "is a recording that was not closed", remedy)
    return None


def warn_of_other_parts(file: Path) -> None:
    """Warn of further files of a split bag, of which one is read alone."""
    try:
        parts = [each.name for each in _listed_files(file.parent).paths]
    except (OSError, ValueError):  # without metadata, or with another bag's
        return
    others = [name for name in parts if name != file.name]
    if others and len(others) < len(parts):
        warn_user(
            f"{file} is one of {len(parts)} files of a drive, by {METADATA_NAME} beside it; the "
            f"others, e.g. {shortened(others[0])}, are not read; give the folder {file.parent}",
        )


def describe_unread_files(bag: Path) -> tuple[str, ...]:
    """Warn of files in a bag's folder that look like further parts of it but are not read."""
    if not bag.is_dir():
        return ()
    has_metadata = (bag / METADATA_NAME).is_file()
    read = _listed_files(bag).paths if has_metadata else files_without_metadata(bag)
    known = {name for each in read for name in (each.name, _unpacked_name(each))}
    others = [
        each.name
        for each in sorted(_visible_files(bag))
        if each.name not in known
        and _unpacked_name(each) not in known
        and Path(_unpacked_name(each)).suffix.lower() in SUFFIXES
    ]
    below = [
        each.name
        for each in sorted(bag.iterdir())
        if each.is_dir()
        and not is_leftover(each.name)
        and ((each / METADATA_NAME).is_file() or files_without_metadata(each))
    ]
    notes = [
        f"warning: {len(below)} bags in folders below are not read, e.g. {shortened(name)}: a "
        "drive's files lie in one folder; import those by themselves"
        for name in below[:1]
    ]
    if not others:
        return tuple(notes)
    reason = (
        f"{METADATA_NAME} does not name them" if has_metadata else "they are packed or not closed"
    )
    remedy = (
        "`ros2 bag reindex` adds those of this drive" if has_metadata else "unpack or repair them"
    )
    return (
        *notes,
        f"warning: {len(others)} bag files in the folder are not read, e.g. "
        f"{shortened(others[0])}: {reason}; {remedy}",
    )


def _unpacked_name(path: Path) -> str:
    """Name of a file without the suffix of a packed or unclosed bag."""
    is_wrapped = path.suffix.lower() in (*_PACKED_SUFFIXES, _OPEN_SUFFIX)
    return path.stem if is_wrapped else path.name


def _visible_files(folder: Path) -> list[Path]:
    return [each for each in folder.iterdir() if each.is_file() and not each.name.startswith(".")]


def size_of_bag(path: Path) -> int:
    """Total size of a bag's files, as they are on the disk [bytes]."""
    return sum(each.stat().st_size for each in _files_of(path).paths)


def bag_changed_at(path: Path) -> float:
    """Time of the last modification of a bag's files [s]."""
    return max(map(changed_at, _files_of(path).paths))


@contextmanager
def open_files(path: Path) -> Iterator[tuple[list["Reader"], Counts]]:
    """Open the files of a bag, with limits on their decompressed size.

    Yields:
        Their readers, and the numbers of messages by metadata.yaml; empty: there is none.

    Raises:
        ValueError: A file cannot be read; the error names it.
    """
    from rosbags.rosbag1 import Reader as Ros1Reader
    from rosbags.rosbag2.storage_mcap import McapReader
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

    kinds: dict[str, Any] = {".mcap": McapReader, ".db3": Sqlite3Reader, ".bag": Ros1Reader}
    with ExitStack() as stack:
        stack.enter_context(bounded_library())
        files = _files_of(path)
        paths = files.paths
        if files.are_packed and not all(map(is_bag_file, paths)):  # some may be unpacked by hand
            folder = stack.enter_context(_temporary_folder(path))
            paths = [
                each if is_bag_file(each) else _decompressed_file(each, folder) for each in paths
            ]
        readers: list[Reader] = []
        for each in paths:
            if not is_bag_file(each):
                raise FileError(each, f"is none of {', '.join(SUFFIXES)}", _REMEDY)
            check_no_pointer(each)
            _refuse_journal(each)
            kind = kinds[each.suffix.lower()]
            # It puts the path into a URL, in which #, ? and % have meanings.
            place = os.path.realpath(each)
            quoted = quote(os.fsencode(place))
            reader = kind(Path(quoted) if kind is Sqlite3Reader else each)
            try:
                reader.open()
                stack.callback(reader.close)
                for chunk in reader.chunks if isinstance(reader, McapReader) else ():
                    if chunk.compression not in _CHUNK_COMPRESSIONS:
                        raise ValueError(f"unsupported chunk compression {chunk.compression!r}")
            except Exception as error:
                reason = one_line(error).replace(quoted, place)
                raise ValueError(
                    f"{each} cannot be read as a ROS bag: {reason.rstrip('.')}; {_remedy(reason)}"
                ) from error
            if isinstance(reader, Sqlite3Reader) and reader.dbconn is not None:
                import apsw

                reader.dbconn.limit(apsw.SQLITE_LIMIT_LENGTH, _MAX_BLOB_BYTES)
            readers.append(reader)
        yield readers, files.counts


def _refuse_journal(database: Path) -> None:
    """Refuse a sqlite3 file whose journal holds messages: the recorder did not end.

    `rosbags` opens the file as one that nothing changes, without its journal.
    """
    for ending in ("-wal", "-journal"):
        journal = Path(f"{os.path.realpath(database)}{ending}")  # where sqlite writes it
        if journal.is_file() and any(_start_of(journal)):  # one of zeros is done with
            raise FileError(
                database,
                f"has a journal beside it, {journal.name}: the recorder did not end, and messages "
                "may be in it alone",
                "merge it in, on a copy of both: sqlite3 FILE.db3 'PRAGMA journal_mode=DELETE'",
            )


def _start_of(path: Path) -> bytes:
    return read_start(path, _JOURNAL_MAGIC_BYTES, max_bytes=sys.maxsize, remedy=_REMEDY)


def _remedy(reason: str) -> str:
    """Remedy for a file that its library refuses, by the library's message."""
    if "end magic" in reason or "not indexed" in reason or "ndex looks damaged" in reason:
        return f"the recording was not closed or is cut short: {_NOT_CLOSED_REMEDY}"
    if "malformed" in reason:
        return (
            "the recording was not closed or is cut short: save what is left by `sqlite3 OLD.db3 "
            ".recover | sqlite3 NEW.db3`"
        )
    if "rofile" in reason:
        return f"only MCAP files of ROS 2 are read: {CONVERSION_REMEDY}"
    if "ompression '" in reason:
        return "write it anew with chunks that are compressed by zstd, by lz4 or not at all"
    if "empty" in reason or "missing tables" in reason:
        return "nothing was recorded, or this is no bag: import another"
    return "give a folder with metadata.yaml, or an intact .mcap, .db3 or .bag file"


def one_line(error: Exception) -> str:
    """Return a library's error as one line for a terminal."""
    if isinstance(error, MemoryError):
        return "reading it takes more memory than there is, or a damaged length claims so"
    text = " ".join(str(error).split())
    if len(text.split()) < 2:  # KeyError(7)
        text = f"{type(error).__name__} {text}".rstrip()
    return shortened(text, 200)


@dataclass(frozen=True, slots=True)
class _BagFiles:
    """Files of a bag, as its folder or metadata.yaml lists them."""

    paths: list[Path]
    are_packed: bool = False
    """The files are compressed as a whole, by zstd."""
    counts: Counts = field(default_factory=dict)


def _files_of(bag: Path) -> _BagFiles:
    """List the files of a bag."""
    if not bag.is_dir():
        return _BagFiles([bag])
    files = files_without_metadata(bag)
    return _BagFiles(files) if files else _listed_files(bag)


def _listed_files(folder: Path) -> _BagFiles:
    """Read a bag's files from metadata.yaml."""
    path = folder / METADATA_NAME
    content = read_yaml(path, _REMEDY, max_bytes=_MAX_METADATA_BYTES)
    match content:
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
        forms = (each, each.with_name(_unpacked_name(each)))  # of a file unpacked by hand
        present = next(filter(Path.is_file, forms), None)
        if present is None:
            raise FileError(path, f"names {each}, which does not exist", _REMEDY)
        paths.append(present)
    mode = str(about.get("compression_mode") or "").lower()
    kind = str(about.get("compression_format") or "")
    if mode in ("", "none"):
        return _BagFiles(paths, counts=_counts(about))
    if mode not in ("file", "message") or kind != "zstd":
        problem = (
            f"declares compression {shortened(mode, 20)} by {shortened(kind, 20)!r}, expected zstd"
        )
        raise FileError(path, problem, "convert the bag (`ros2 bag convert`)")
    return _BagFiles(paths, mode == "file", _counts(about))


def _counts(about: dict[str, Any]) -> Counts:
    """Read the numbers of messages; entries of another form are left out."""
    counts: Counts = {}
    topics = about.get("topics_with_message_count")
    for each in topics if isinstance(topics, list) else ():
        match each:
            case {
                "topic_metadata": {"name": str(name), "type": str(kind)},
                "message_count": int(count),
            }:
                counts[name, kind] = counts.get((name, kind), 0) + count
    return counts


@contextmanager
def _temporary_folder(bag: Path) -> Iterator[Path]:
    """Folder for a bag's decompressed files, in TMPDIR.

    Raises:
        FileError: No temporary folder can be made.
    """
    try:
        holder = TemporaryDirectory(prefix="sightline-bag-")
    except OSError as error:
        raise _no_room(bag, error) from error
    with holder as folder:
        yield Path(folder)


def _decompressed_file(path: Path, folder: Path) -> Path:
    """Decompress a file into a folder, under its name without the last suffix."""
    target = folder / path.stem
    room = path.stat().st_size * _MAX_COMPRESSION_RATIO
    with path.open("rb") as compressed, zstd_module().open(compressed, "rb") as source:
        while block := source.read(STEP_BYTES):
            room -= len(block)
            if room < 0:
                problem = f"decompresses to more than {_MAX_COMPRESSION_RATIO} times its size"
                raise FileError(path, problem, _REMEDY)
            try:
                with target.open("ab") as file:
                    file.write(block)
            except OSError as error:
                raise _no_room(path, error, folder) from error
    return target


def _no_room(path: Path, error: OSError, folder: Path | None = None) -> FileError:
    place = "" if folder is None else f" {folder.parent}"
    return FileError(
        path,
        f"is compressed and cannot be unpacked into the temporary folder{place}: "
        f"{(error.strerror or 'it has none').lower()}",
        "set TMPDIR to a folder with room, or unpack the bag (`ros2 bag convert`)",
    )
