"""Packing of data sets into shards, tars in webdataset's layout, and unpacking."""

import gzip
import io
import os
import re
import tarfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final
from urllib.parse import quote

from sightline.data.checks.other_layouts import BAG_SUFFIXES, source_to_import, tables_to_import
from sightline.data.checks.tree_checks import find_trees
from sightline.data.formats.image_header import IMAGE_SUFFIXES
from sightline.data.formats.point_files import CLOUD_SUFFIXES
from sightline.data.layouts.depth_trees import split_by_drives
from sightline.data.layouts.kitti_trees import list_drive
from sightline.files.atomic import (
    atomic_path,
    atomic_write_bytes,
    atomic_write_text,
    check_links,
)
from sightline.files.byte_source import url_of
from sightline.files.leftovers import is_leftover
from sightline.files.plain_file import read_bytes
from sightline.files.plain_text import shortened
from sightline.files.problem import FileError, error_text
from sightline.files.safe_names import relative_parts
from sightline.files.shard_checks import check_whole, is_whole, tar_digest
from sightline.files.shard_index import (
    FORMAT,
    MANIFEST,
    MAX_MEMBER_BYTES,
    MAX_SHARDS,
    PACKED_SUFFIX,
    SHARD_REMEDY,
    SHARED,
    Member,
    ShardIndex,
    index_path,
    read_index,
    read_manifest,
    tars_of,
)
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments
from sightline.jobs.output_dirs import (
    KITTI_SPLITS,
    acquire_output_dir,
    check_no_shards,
    data_name,
    is_split,
)
from sightline.jobs.progress import track
from sightline.jobs.read_ahead import check_threads, map_ahead

_BLOCK: Final = tarfile.BLOCKSIZE
_DRIVE: Final = re.compile(r"\d{4}_\d\d_\d\d_drive_\d{4}\w*")
_KINDS_IN_NAMES: Final = ("_velodyne_raw_", "_groundtruth_depth_")  # of the depth benchmark
_SENSOR_SUFFIXES: Final = (*IMAGE_SUFFIXES, *CLOUD_SUFFIXES)
_UNPACKED_SUFFIXES: Final = IMAGE_SUFFIXES  # they are compressed already


@dataclass(frozen=True, kw_only=True, slots=True)
class ShardReport:
    """Result of packing or unpacking; a damaged shard does not stop the others."""

    written: int
    skipped: int
    """Number of shards that were there already, whole."""
    faults: tuple[str, ...]
    """One line for each shard that failed."""

    def __str__(self) -> str:
        """Format the numbers for the user."""
        failed = f", {len(self.faults)} failed" if self.faults else ""
        return f"{self.written} written, {self.skipped} there already{failed}"


@dataclass(frozen=True, kw_only=True, slots=True)
class _Sources:
    """Files of a data set by their paths in it."""

    root: Path
    frames: tuple[tuple[str, ...], ...]
    shared: tuple[str, ...]


@named_arguments
def write_shards(
    data: Path, out: Path, *, frames_per_shard: int, compress: bool = False, workers: int = 2
) -> ShardReport:
    """Pack a data set into tars of some frames each; the same data give the same bytes.

    A frame's files are those of one name: DIR/A/B/NAME.png becomes the member DIR/NAME.A.B.png,
    where DIR is a split or drive if there is one, so webdataset reads each frame as a sample. Files
    that belong to no frame go to shared.tar, hidden ones nowhere. Each tar gets an index with its
    checksum after it is complete; shards that are whole, and of these files by their paths, lengths
    and times of change, are skipped, and one that fails does not stop the others.

    Args:
        data: Folder of a data set, or a split of KITTI's object tree.
        out: Folder of the shards.
        frames_per_shard: Number of frames in a shard.
        compress: Whether to pack all files but pictures by gzip.
        workers: Number of threads.

    Raises:
        ValueError: There are no frames, files that frames need are one folder up, a number is out
            of range, or `out` holds other shards.
    """
    if frames_per_shard < 1:
        raise ValueError(f"frames_per_shard must be at least 1, got {frames_per_shard}")
    check_threads(workers)
    _check_is_whole(data)
    sources = _find_sources(data)
    count = len(sources.frames)
    if count > MAX_SHARDS * frames_per_shard:
        raise ValueError(
            f"{count} frames in shards of {frames_per_shard} are more than {MAX_SHARDS} shards; "
            "raise --frames-per-shard"
        )
    settings = {
        "format": FORMAT,
        "data": data_name(sources.root),
        "frames": count,
        "frames_per_shard": frames_per_shard,
        "compress": compress,
    }
    acquire_output_dir(out, settings, results=("*.tar",), manifest_name=MANIFEST)
    contents = [sources.shared] + [
        tuple(path for frame in sources.frames[first : first + frames_per_shard] for path in frame)
        for first in range(0, count, frames_per_shard)
    ]
    tars = tars_of(out, count, frames_per_shard)
    jobs = [
        partial(_pack_current, sources.root, tar, files, compress=compress)
        for tar, files in zip(tars, contents, strict=True)
    ]
    report = _run(jobs, workers, "packing")
    _touch_older(out / MANIFEST, map(index_path, tars))
    return report


def _touch_older(manifest: Path, indexes: Iterable[Path]) -> None:
    """Touch a manifest older than an index, also of a killed job: open shards are read anew."""
    packed_ns = [path.stat().st_mtime_ns for path in indexes if path.is_file()]
    if max(packed_ns, default=0) > manifest.stat().st_mtime_ns:
        manifest.touch()


def unpack_shards(shards: Path, out: Path, *, workers: int = 2) -> ShardReport:
    """Unpack a folder of shards to the tree that they were packed from.

    The checksum of each shard is compared first. Files that are there already are kept if they are
    the same, and a shard that fails does not stop the others.

    Args:
        shards: Folder that `write_shards` wrote.
        out: Folder for the tree.
        workers: Number of threads.

    Raises:
        ValueError: `shards` is no such folder, or `out` holds shards, files that are not in these
            shards, or a link that leads outside.
    """
    check_threads(workers)
    check_links(out)
    check_no_shards(out)
    manifest = None if url_of(shards) is not None else read_manifest(shards)
    if manifest is None:
        if (shards / MANIFEST).is_file():
            raise FileError(shards / MANIFEST, "is no manifest of shards", SHARD_REMEDY)
        raise FileError(
            shards, f"holds no {MANIFEST}", "give a folder on this machine that shard wrote"
        )
    tars = tars_of(shards, int(manifest["frames"]), int(manifest["frames_per_shard"]))
    _check_no_others(tars, out)
    return _run([partial(_unpack, tar, out) for tar in tars], workers, "unpacking")


def _check_no_others(tars: Sequence[Path], out: Path) -> None:
    """Refuse a folder with files that are not in the shards, such as other results.

    Raises:
        FileError: There is such a file.
    """
    if next(files_below(out), None) is None:
        return
    known: set[str] = set()
    for tar in tars:
        try:
            index = read_index(tar)
        except ValueError:
            index = None
        if index is None:  # named when it is unpacked
            return
        known.update(index.files)
    other = next((path for path in files_below(out) if path not in known), None)
    if other is not None:
        raise FileError(out, f"holds {other}, which is not in these shards", "name an empty folder")


def _run(jobs: Sequence[Callable[[], bool | None]], workers: int, description: str) -> ShardReport:
    results = map_ahead(_attempt, jobs, workers=workers)
    outcomes = list(track(results, description=description, total=len(jobs)))
    return ShardReport(
        written=outcomes.count(True),
        skipped=outcomes.count(False),
        faults=tuple(each for each in outcomes if isinstance(each, str)),
    )


def _attempt(job: Callable[[], bool | None]) -> bool | str | None:
    """Run the job of a shard: whether it was written, or its fault; None: it is empty."""
    try:
        return job()
    except (ValueError, OSError) as error:
        return error_text(error)


def _check_is_whole(data: Path) -> None:
    """Refuse data to import, and a drive or depth tree's split that needs files above it."""
    tables = tables_to_import(data)
    if tables is not None and not find_trees(data):
        raise FileError(tables.path, tables.problem, tables.remedy)
    by_drives = split_by_drives(data)
    if by_drives is not None:
        root, split = by_drives
        raise FileError(
            data,
            f"is the split {split} of a depth completion tree without its raw drives, which are "
            "one folder up",
            f"pack the whole tree, {root}; commands read its split from OUT/{split}",
        )
    drive = list_drive(data)
    day = drive.calibration
    if drive.frames and day is not None and day != data:
        raise FileError(
            data,
            "is a raw drive without its calibration, which is one folder up",
            f"pack the folder of its day, {day.absolute()}, or copy calib_*.txt of "
            "that into the drive",
        )


def _find_sources(data: Path) -> _Sources:
    root, below = data, ""
    split = next(filter(is_split, (data, data.resolve())), None)  # either may be a link's name
    if split is not None:  # readers know a split by its folder's name
        root, below = split.parent, split.name
    frames: dict[tuple[str, str], list[str]] = {}
    others: list[str] = []
    for path in files_below(root, below):
        relative_parts(path, root, "a file's path", remedy="rename the file")
        frame = _frame_of(path)
        if frame is None:
            others.append(path)
        else:
            frames.setdefault(frame, []).append(path)
    if below:
        others += files_below(root, "ImageSets")
    kept = {key: files for key, files in frames.items() if any(map(_is_sensor, files))}
    if not kept:
        if (data / MANIFEST).is_file():
            raise FileError(data, "holds shards already", "use them as they are, or unshard them")
        source = source_to_import(data)  # such as a bag; beside drives it is no matter
        if source is not None:
            raise FileError(source.path, source.problem, source.remedy)
        raise FileError(data, "holds no frames", "give the folder of a data set")
    shared = [path for key, files in frames.items() if key not in kept for path in files]
    bags = [path for path in (*others, *shared) if path.lower().endswith(BAG_SUFFIXES)]
    if bags:
        warn_user(
            f"{data}: {len(bags)} bags, e.g. {shortened(bags[0])}, are no part of the data and "
            "are not packed",
        )
    return _Sources(
        root=root,
        frames=tuple(tuple(sorted(kept[key])) for key in sorted(kept)),
        shared=tuple(sorted({*others, *shared}.difference(bags))),
    )


def files_below(root: Path, folder: str = "", above: frozenset[str] = frozenset()) -> Iterator[str]:
    """Yield the paths of all files that are not hidden; links are followed, but in no circle.

    Folders of systems and network drives (`is_leftover`) hold no data.
    """
    place = root / folder
    real = os.path.realpath(place)
    if real in above or not place.is_dir():
        return
    entries = sorted(place.iterdir())
    suffixes = {entry.suffix for entry in entries if _is_sensor(entry.name) and entry.is_file()}
    for entry in entries:
        if entry.name.startswith(".") or (is_leftover(entry.name) and entry.is_dir()):
            continue
        path = f"{folder}/{entry.name}" if folder else entry.name
        if entry.is_dir() and entry.suffix not in suffixes:
            yield from files_below(root, path, above | {real})
        else:  # a folder in a cloud's place, a pipe or a link to nothing is named when it is read
            yield path


def _frame_of(path: str) -> tuple[str, str] | None:
    """Split or drive, and name of the frame that a file may belong to; None: a file of the root."""
    folder, _, name = path.rpartition("/")
    if not folder:
        return None
    stem = Path(name).stem
    for kind in _KINDS_IN_NAMES:
        stem = stem.replace(kind, "_image_")
    return _group(folder.split("/"))[0], stem


def _group(folders: Sequence[str]) -> tuple[str, int]:
    """Split or drive among the folders of a path, and the number of folders up to it."""
    for number, each in enumerate(folders, start=1):
        if each in KITTI_SPLITS or _DRIVE.fullmatch(each):
            return each, number
    return "", 0


def _is_sensor(path: str) -> bool:
    return path.lower().endswith(_SENSOR_SUFFIXES)


def _member_name(path: str) -> str:
    """Name of a frame's file in webdataset's layout: up to the first dot, it is the sample's."""
    *folders, name = path.split("/")
    _, number = _group(folders)
    stem, suffix = Path(name).stem, Path(name).suffix
    parts = [_without_dots(each) for each in (stem, *folders[number:])]
    return "/".join([*folders[:number], ".".join(parts) + suffix])


def _without_dots(name: str) -> str:
    return quote(name, safe=" !#$&'()*+,:;=@[]~", encoding="utf-8").replace(".", "%2E")


def _pack_current(root: Path, tar: Path, files: Sequence[str], *, compress: bool) -> bool:
    """Write a tar and its index, unless they are there, whole, and of these files as they are."""
    if not _is_of(tar, root, files):
        index_path(tar).unlink(missing_ok=True)
    return pack_files(root, tar, files, compress=compress)


def _is_of(tar: Path, root: Path, files: Sequence[str]) -> bool:
    """Test whether an index lists these files: none has another length, or changed after it."""
    try:
        index = read_index(tar)
        if index is None or list(index.files) != list(files):
            return False
        packed_ns = index_path(tar).stat().st_mtime_ns
        statuses = [(root / path).stat() for path in files]
    except (ValueError, OSError):  # a file that cannot be read is named when it is packed
        return False
    lengths = [each.size for each in index.files.values()]
    return [each.st_size for each in statuses] == lengths and all(
        each.st_ctime_ns <= packed_ns
        for each in statuses  # mtime may be set, even to the future
    )


def pack_files(
    root: Path,
    tar: Path,
    files: Sequence[str],
    *,
    compress: bool = False,
    source_sha256: str | None = None,
) -> bool:
    """Write a tar and its index, unless they are there and whole.

    Args:
        root: Folder of the files.
        tar: The tar; its files are named as frames' are, those of shared.tar by their paths.
        files: Paths of the files below the folder, in the order of the tar.
        compress: Whether to pack all files but pictures by gzip.
        source_sha256: Checksum of the shard of frames that the files are results of.

    Returns:
        Whether it was written.

    Raises:
        FileError: A file cannot be read.
        ValueError: The tar cannot be written.
    """
    if is_whole(tar, source_sha256=source_sha256):
        return False
    index_path(tar).unlink(missing_ok=True)
    members: dict[str, Member] = {}
    with atomic_path(tar) as temporary:
        # Members have neither times nor owners, so that the bytes depend on the data alone.
        with tarfile.open(temporary, "w", format=tarfile.PAX_FORMAT) as archive:
            for path in files:
                name = path if tar.stem == SHARED else _member_name(path)
                members[path] = _add(archive, root / path, tar, name, compress=compress)
        sha256, num_bytes = tar_digest(temporary)
    index = ShardIndex(
        tar=tar,
        sha256=sha256,
        num_bytes=num_bytes,
        files=members,
        source_sha256=source_sha256,
    )
    atomic_write_text(index_path(tar), index.to_json())
    return True


def _add(archive: tarfile.TarFile, source: Path, tar: Path, name: str, *, compress: bool) -> Member:
    content = read_bytes(source, max_bytes=MAX_MEMBER_BYTES, remedy="leave the file out")
    stored = content
    if compress and source.suffix.lower() not in _UNPACKED_SUFFIXES:
        stored, name = gzip.compress(content, mtime=0), f"{name}{PACKED_SUFFIX}"
    info = tarfile.TarInfo(name)
    info.size = len(stored)
    archive.addfile(info, io.BytesIO(stored))
    return Member(
        tar=tar,
        name=name,
        offset=archive.offset - -(-len(stored) // _BLOCK) * _BLOCK,
        stored=len(stored),
        size=len(content),
        crc32=zlib.crc32(content),
    )


def _check_members(index: ShardIndex) -> None:
    """Refuse an index that does not list exactly the files of its tar."""
    listed = [(each.name, each.offset, each.stored) for each in index.files.values()]
    try:
        with tarfile.open(index.tar, "r:") as archive:
            held = [(each.name, each.offset_data, each.size) for each in archive if each.isreg()]
            is_plain = len(held) == len(archive.getmembers())
    except tarfile.TarError:
        held, is_plain = [], not listed
    names_fit = all(
        each.name.removesuffix(PACKED_SUFFIX) in (path, _member_name(path))
        or each.name in (path, _member_name(path))
        for path, each in index.files.items()
    )
    if not (is_plain and names_fit and sorted(held) == sorted(listed)):
        raise FileError(
            index_path(index.tar),
            f"lists other files than {index.tar.name} holds",
            "copy both again, or run the command again that packed them",
        )


def _unpack(tar: Path, out: Path) -> bool | None:
    """Write the files of a tar, except those that are there and the same; None: it has none."""
    index = read_index(tar)
    if index is None:
        raise FileError(index_path(tar), "is missing", SHARD_REMEDY)
    check_whole(index)
    _check_members(index)
    is_written = False
    for path, member in index.files.items():
        target = out.joinpath(*relative_parts(path, index_path(tar), "a file's path"))
        content = member.read()
        if target.is_file():
            if target.read_bytes() != content:
                raise FileError(target, "holds something else", "name an empty folder")
            continue
        atomic_write_bytes(target, content)
        is_written = True
    return is_written if index.files else None
