"""Lists of frames, and folders with one file per frame."""

import os
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Final

from sightline.data.formats.kitti_labels import sequence_fault
from sightline.files.leftovers import is_leftover
from sightline.files.plain_file import read_bytes
from sightline.files.plain_text import read_piped_text, read_text, shortened
from sightline.files.problem import FileError, shown_place
from sightline.files.safe_names import TRUST_REMEDY, relative_parts
from sightline.files.shard_path import data_path
from sightline.geometry.arguments import wrong_type

_PACKAGED = Path(__file__).with_name("sample_lists")
_MAX_BYTES, _REMEDY = 2**24, "give result files of KITTI's"
_RENAME_REMEDY = "give names of frames; where files have this name, rename the files"
_MAX_SEARCHED = 50  # largest number of searched folders and frames
_SUFFIX = ".txt"
_RECORD_SUFFIX = ".json"
_FILE_SUFFIXES = (_SUFFIX, ".bin", ".jpg", ".npy", ".pcd", ".png")  # of frames' files
_MAX_LISTED = 4  # suffixes in a description


class GapsError(ValueError):
    """Error for frames that lack files, with the fault and the remedy as fields."""

    def __init__(self, problem: str, remedy: str) -> None:
        """Store fault and remedy."""
        super().__init__(problem, remedy)  # both, for pickling
        self.problem = problem

    def __str__(self) -> str:
        """Format one line."""
        return "; ".join(self.args)


def read_sample_list(sample_list: str | Path | Sequence[str], root: Path | str) -> tuple[str, ...]:
    """Read the frames of a list, in its order.

    Args:
        sample_list: The frames themselves; or the name, without ".txt", of a list in
            `root`/ImageSets or else in the package ("kitti-object-train": 3712 frames,
            "kitti-object-val": 3769, as commonly published); or the path of a file or a pipe with
            one frame per line. Text without a suffix or a folder is first a name: a file `val` in
            the current folder is "./val".
        root: The data set's folder.

    Raises:
        TypeError: The list has another type.
        ValueError: There is no such list, it is empty, names a frame twice, or contains an invalid
            file name.
    """
    if isinstance(sample_list, str | Path):
        path = _find(sample_list, data_path(root))
        text = _piped_text(path, path.stat().st_ino) if path.is_fifo() else read_text(path)
        lines = (line.strip() for line in text.split("\n"))
        frames, source, remedy = tuple(line for line in lines if line), str(path), TRUST_REMEDY
    else:
        if not isinstance(sample_list, Iterable):
            raise wrong_type("sample_list", sample_list, "the frames' names; give a list of text")
        frames, source, remedy = tuple(sample_list), "the list of frames", _RENAME_REMEDY
        invalid = next((frame for frame in frames if not isinstance(frame, str)), None)
        if invalid is not None:
            raise ValueError(
                f"{source} holds {invalid!r}, expected text such as '000001'; give names as text"
            )
    if not frames:
        raise ValueError(f"{source} names no frames, expected one per line; name another list")
    for number, frame in enumerate(frames, start=1):
        try:
            relative_parts(  # becomes part of files' names
                frame, source, f"frame {number}", remedy=remedy
            )
        except FileError as error:
            doubt = doubt_about_names([frame]) if "/" in frame or "\t" in frame else None
            if doubt is None:
                raise
            raise ValueError(f"{source}: {doubt}") from error
    refuse_repeated(frames, source)
    return frames


def refuse_repeated(frames: Sequence[str], source: str) -> None:
    """Refuse a list that names a frame twice.

    Raises:
        ValueError: It does.
    """
    if len(set(frames)) < len(frames):
        repeated = next(frame for frame, count in Counter(frames).items() if count > 1)
        raise ValueError(
            f"{source} names frame '{shortened(repeated)}' twice; remove one of the lines"
        )


def lasting_list(
    sample_list: str | Path | Sequence[str] | None,
) -> str | Path | Sequence[str] | None:
    """Keep the frames of an iterator, which gives them once, while a list is read several times."""
    return tuple(sample_list) if isinstance(sample_list, Iterator) else sample_list


@cache
def _piped_text(path: Path, inode: int) -> str:
    """Read a pipe, which gives its text once, while a list is read several times."""
    del inode
    return read_piped_text(path)


def _find(sample_list: str | Path, root: Path) -> Path:
    named = (root / "ImageSets" / f"{sample_list}.txt", _PACKAGED / f"{sample_list}.txt")
    file = Path(sample_list)
    is_name = sample_list == file.name and not file.suffix  # not for a `Path`
    for candidate in (*named, file) if is_name else (file, *named):
        if candidate.is_file() or candidate.is_fifo():
            return candidate
    known = sorted(path.stem for path in _PACKAGED.glob("*.txt"))
    known += sorted(path.stem for path in (root / "ImageSets").glob("*.txt"))
    raise ValueError(
        f"there is no list {str(sample_list)!r}; give the path of a file with one frame per line, "
        f"or one of {', '.join(known)}"
    )


def doubt_about_names(missing: Iterable[str]) -> str | None:
    """Say which line of a list is no frame's name, if that explains a missing frame; else None."""
    for name in missing:
        line = f"'{shortened(name)}' in the list"
        if name.startswith("#"):
            return f"{line} is a comment, which lists cannot hold; remove it"
        if len(name.split()) > 1:
            return f"{line} is no single name; write one frame per line"
        if name.endswith(_FILE_SUFFIXES):
            return f"{line} has the ending of a file; write {shortened(Path(name).stem)}"
    return None


def require_frame_files(
    folder: Path,
    names: Sequence[str],
    kind: str,
    remedy: str,
    suffix: str = _SUFFIX,
    *,
    other_than: Path | None = None,
) -> None:
    """Check that every frame has its file, before any is read.

    Args:
        folder: Folder with a file for each frame.
        names: Names of the frames.
        kind: Kind of the files, for errors.
        remedy: Remedy for a missing file, for errors.
        suffix: Suffix of the files, with its dot, in lower case.
        other_than: Folder of other files with the same names, which no error suggests.

    Raises:
        ValueError: There is no such folder, or frames have no file in it; contains their number.
    """
    if not folder.is_dir():
        raise ValueError(f"{shown_place(folder)} is no folder; give the folder of the {kind} files")
    present = {path.name for path in folder.iterdir()}
    missing = [name for name in names if f"{name}{suffix}" not in present]
    if missing:
        none = len(missing) == len(names)
        elsewhere = (
            locate_frame_files(folder, names, suffix, other_than=other_than) if none else None
        )
        capitals = capital_suffixes(present, missing, suffix)
        elsewhere = doubt_about_names(missing) or capitals or elsewhere
        raise ValueError(
            f"{folder} has no {kind} file for {len(missing):,} of {len(names):,} frames, the first "
            f"is {shortened(missing[0])}{suffix}: {elsewhere or remedy}"
        )


def capital_suffixes(
    present: Iterable[str], missing: Collection[str], suffix: str = _SUFFIX
) -> str | None:
    """Remedy where missing files are there with another case of the suffix; None: they are not."""
    by_name = {
        path.stem: path.name
        for path in map(Path, present)
        if path.suffix != suffix and path.suffix.lower() == suffix
    }
    found = [by_name[name] for name in sorted(by_name.keys() & set(missing))]
    if not found:
        return None
    number = f"{len(found):,} files end" if len(found) > 1 else "1 file ends"
    return f"{number} in capitals, such as {found[0]}; rename them to NAME{suffix}"


def have_equal_files(first: Path, second: Path, names: Sequence[str]) -> bool:
    """Whether two folders have identical files for each frame, or both have none."""
    if first.resolve() == second.resolve():
        return True
    pairs = ((first / f"{name}{_SUFFIX}", second / f"{name}{_SUFFIX}") for name in names)
    return all(_content(one) == _content(other) for one, other in pairs)


def list_unequal_files(first: Path, second: Path, names: Collection[str]) -> list[str]:
    """List the frames whose files in two folders, where both have one, differ in content."""
    return [
        name
        for name in names
        if (one := first / f"{name}{_SUFFIX}").is_file()
        and (other := second / f"{name}{_SUFFIX}").is_file()
        and not _is_same_file(one, other)
        and _content(one) != _content(other)
    ]


def _is_same_file(one: Path, other: Path) -> bool:
    """Test if two paths lead to the same file on disk; files in shards have no identity."""
    status = one.stat()
    return status.st_ino != 0 and os.path.samestat(status, other.stat())


def _content(path: Path) -> bytes | None:
    return read_bytes(path, max_bytes=_MAX_BYTES, remedy=_REMEDY) if path.is_file() else None


def describe_left_out(folder: Path) -> str | None:
    """Describe files with other suffixes and subfolders, with counts; None: there are none.

    Hidden files and the record of the command that wrote the results (.json) are not counted.
    """
    entries = [each for each in sorted(folder.iterdir()) if not is_leftover(each.name)]
    folders = [each for each in entries if each.is_dir()]
    files = [
        each for each in entries if each.is_file() and each.suffix not in (_SUFFIX, _RECORD_SUFFIX)
    ]
    parts = []
    for ending, count in Counter(each.suffix for each in files).most_common(_MAX_LISTED):
        first = next(each.name for each in files if each.suffix == ending)
        named = f"{shortened(ending, 12)} " if ending else ""
        kind = f"{named}file{'' if count == 1 else 's'}"
        parts.append(f"{count:,} {kind} (the first is {shortened(first)})")
    if folders:
        below = sum(1 for each in folders_below(folders) for _ in each.glob(f"*{_SUFFIX}"))
        kind = "folder" if len(folders) == 1 else "folders"
        first = shortened(folders[0].name)
        parts.append(
            f"{len(folders):,} {kind} (the first is {first}) with {below:,} {_SUFFIX} files"
        )
    return ", ".join(parts) or None


TIMES_NAME: Final = "times.txt"
"""File with the times of a recording's frames."""
_NOTES: Final = ("classes", "labels", "license", "notes", "readme")


def is_note(name: str) -> bool:
    """Test if a text beside labels, by its name without the suffix, is none: classes, readme, .."""
    return name.lower() in _NOTES


LABEL_PLACES: Final = ("training/label_2", "label_2", "labels")
"""Folders of labels in data sets, whose calibrations have the same names."""


def locate_frame_files(
    folder: Path, names: Sequence[str], suffix: str = _SUFFIX, *, other_than: Path | None = None
) -> str | None:
    """Remedy for a folder without files of the frames: their folder, or the names found.

    Args:
        folder: The folder.
        names: Names of the frames.
        suffix: Suffix of the files.
        other_than: Folder of other files with the same names, such as labels for results.
    """
    entries = [each for each in sorted(folder.iterdir()) if not is_leftover(each.name)]
    places = [folder / place for place in LABEL_PLACES]
    for below in (each for each in places if not _is_same(each, other_than)):
        if any((below / f"{name}{suffix}").is_file() for name in names[:_MAX_SEARCHED]):
            return f"they are probably in {below}; name that folder"
    found = [
        below
        for below in folders_below(entries)
        if not _is_same(below, other_than)
        and any((below / f"{name}{suffix}").is_file() for name in names[:_MAX_SEARCHED])
    ]
    if len(found) > 1:
        listed = ", ".join(
            shortened(str(below.relative_to(folder))) for below in found[:_MAX_LISTED]
        )
        more = ", .." * (len(found) > _MAX_LISTED)
        return f"{len(found)} of its folders hold some ({listed}{more}); name one of them"
    if found:
        writer = ", as KITTI's own program writes them" * (found[0].name == "data")
        return f"they are in {found[0]}{writer}; name that folder"
    shown = [each for each in entries if each.is_file()]
    files = [each for each in shown if each.name.lower() != TIMES_NAME and not is_note(each.stem)]
    others = [each for each in files if each.suffix == suffix]
    if others and (fault := sequence_fault(others[0])) is not None:
        return f"{shortened(others[0].name)}, {fault[0]}; {fault[1]}"
    renamed = _same_frame(others, names)
    if renamed is not None:
        return (
            f"it holds {len(others):,} files with other names, such as "
            f"{shortened(others[0].name)}; rename them as {renamed}{suffix}"
        )
    if others:
        return (
            f"it holds {len(others):,} files of other frames, such as {shortened(others[0].name)}; "
            "name a list of those frames, or another folder"
        )
    stems = [each.stem for each in files]
    if capitals := capital_suffixes((each.name for each in files), names or stems, suffix):
        return capitals
    if files:
        return (
            f"it holds {len(files):,} files of another format, such as {shortened(files[0].name)}; "
            f"write one NAME{suffix} for each frame"
        )
    return None


def _is_same(folder: Path, other: Path | None) -> bool:
    return other is not None and folder.resolve() == other.resolve()


def folders_below(entries: Sequence[Path]) -> list[Path]:
    """List some folders among the entries of a folder, and some of the folders in those."""
    folders = [each for each in entries if each.is_dir()][:_MAX_SEARCHED]
    deeper = [
        below
        for each in folders
        for below in sorted(each.iterdir())[:_MAX_SEARCHED]
        if below.is_dir()
    ]
    return [*folders, *deeper]


def _same_frame(files: Sequence[Path], names: Sequence[str]) -> str | None:
    """Find the frame that the first of all files names in another form; None: it names none.

    Such names have another number of digits (15 for 000015), a prefix or a second suffix. Every
    file must name a frame of its own.
    """
    by_number = {frame_number(name): name for name in names}
    if None in by_number or len(by_number) < len(names):
        return None
    found = [by_number.get(frame_number(each.stem)) for each in files]
    return found[0] if found and None not in found and len(set(found)) == len(found) else None


def frame_number(name: str) -> int | None:
    """Parse the only number in a name; None: it has none, or several."""
    numbers = re.findall("[0-9]+", name)
    return int(numbers[0]) if len(numbers) == 1 else None
