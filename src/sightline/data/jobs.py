"""Jobs that fill a folder: claimed by one maker, done in parallel, finished by running it again."""

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol, TypeVar, runtime_checkable

from sightline.data.atomic import atomic_create_text
from sightline.data.object_tree import OBJECT_SPLITS
from sightline.data.output_links import check_links
from sightline.data.parallel import run_pieces
from sightline.data.plain_file import read_bytes
from sightline.data.plain_text import shortened
from sightline.data.problem import escaped, memory_fault
from sightline.data.progress import track

MANIFEST_NAME: Final = "sightline.json"
"""File in an output folder that says what made the others."""

RESULT_SUFFIXES: Final = (".txt", ".png")
"""Endings of result files."""

_WRITTEN_SUFFIXES = (*RESULT_SUFFIXES, ".csv", ".html", ".json", ".jsonl", ".md", ".yaml", ".yml")
# of what commands write into folders: a file of weights, for one, is never replaced
_MAX_MANIFEST_BYTES = 2**22
_MOST_DIFFERENCES = 12  # settings that an error names
_LONGEST_VALUE = 60  # characters of a setting that an error shows

Item = TypeVar("Item")


@dataclass(frozen=True, kw_only=True, slots=True)
class JobResult:
    """What a job did."""

    written: int
    skipped: int
    """Pieces whose files were there already."""

    def __str__(self) -> str:
        """For people."""
        return f"{self.written} written, {self.skipped} there already"


@runtime_checkable  # for beartype, which checks arguments under pytest
class Work(Protocol):
    """A piece of a job; picklable where workers are started afresh (macOS, Windows).

    It writes files aside and renames them, so that a job which is stopped leaves whole ones only.
    """

    def __str__(self) -> str:
        """What errors call it, e.g. "frame 7"."""
        ...

    def run(self) -> None:
        """Does it.

        Raises:
            ValueError: The data or the output folder is at fault.
            OSError: Likewise.
        """
        ...


def shard(items: Sequence[Item], index: int, count: int) -> Sequence[Item]:
    """Every `count`th item from `index` on: one of so many parts of a job.

    Raises:
        ValueError: There is no such part.
    """
    if not 0 <= index < count:
        raise ValueError(
            f"shard_index must be between 0 and num_shards - 1, got {index} of {count}"
        )
    return items[index::count]


def run_job(works: Sequence[Work], workers: int, *, description: str) -> None:
    """Does the pieces of a job, several at once.

    Args:
        works: The pieces.
        workers: Processes that work; 1 is this process alone.
        description: What happens to the pieces, for the display of progress.

    Raises:
        ValueError: There is no worker, or a piece fails: the error names it. Those before it are
            done and stay.
    """
    check_workers(workers)
    errors = run_pieces(_Attempt(works), len(works), workers)
    for error in track(errors, description=description, total=len(works)):
        if error:
            raise ValueError(error)


def check_workers(workers: int) -> None:
    """Refuses a job that nobody would do.

    Raises:
        ValueError: There is no worker.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")


def claim_folder(
    folder: Path,
    settings: Mapping[str, object],
    *,
    results: Sequence[str],
    manifest_name: str = MANIFEST_NAME,
) -> None:
    """Writes what makes the files of a folder into it, or sees that the same stands there.

    Of several jobs that claim a folder at one time, on one machine or on several, one writes the
    manifest; those of the same settings share the folder, and give the same files. The claim of a
    job that was stopped stands, so that what it has left is finished and not mixed with.

    Args:
        folder: Made where it is missing.
        settings: All that the files' bytes depend on, but for which of them are asked for; plain
            values, as JSON has them.
        results: Patterns (`Path.glob`) of the files and folders that jobs write there.
        manifest_name: Name of the file that holds the settings.

    Raises:
        ValueError: Other settings stand there, or results that nobody knows the maker of; or the
            folder cannot be written to, or holds links that lead out of it (`check_links`).
    """
    if _is_claimed(folder, settings, results=results, manifest_name=manifest_name):
        return
    if not atomic_create_text(folder / manifest_name, _manifest(settings)):  # another was faster
        _is_claimed(folder, settings, results=results, manifest_name=manifest_name)


@dataclass(frozen=True, kw_only=True, slots=True)
class Claim:
    """What `claim_folder` is given."""

    folder: Path
    settings: Mapping[str, object]
    results: Sequence[str]


def claim_folders(claims: Sequence[Claim]) -> None:
    """Claims all folders of a job, or, where one is refused that could have been seen, none.

    Raises:
        ValueError: As `claim_folder`.
    """
    for claim in claims:
        _is_claimed(claim.folder, claim.settings, results=claim.results)
    for claim in claims:
        claim_folder(claim.folder, claim.settings, results=claim.results)


def _is_claimed(
    folder: Path,
    settings: Mapping[str, object],
    *,
    results: Sequence[str],
    manifest_name: str = MANIFEST_NAME,
) -> bool:
    """Whether the same settings stand there; others, and results of nobody knows whom, raise."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} is no folder; name another output folder")
    check_links(folder)
    path = folder / manifest_name
    # In this order: a job has written its manifest before its first result.
    has_results = any(next(folder.glob(pattern), None) is not None for pattern in results)
    if not path.exists():
        if has_results:
            raise ValueError(_refusal(folder, f"data without a {manifest_name}", manifest_name))
        return False
    there = _manifest_text(path)
    if there != _manifest(settings):
        raise ValueError(_refusal(folder, _difference(there, settings), manifest_name))
    return True


def _manifest_text(path: Path) -> str:
    remedy = "name another output folder, or remove the file"
    return read_bytes(path, max_bytes=_MAX_MANIFEST_BYTES, remedy=remedy).decode(errors="replace")


def _manifest(settings: Mapping[str, object]) -> str:
    return json.dumps(dict(settings), indent=2) + "\n"


def check_outputs(
    outputs: Mapping[str, Path | None],
    *,
    data: Iterable[Path | None],
    results: Iterable[Path | None] = (),
) -> None:
    """Refuses, before any work, outputs that would change what is read, or each other.

    Args:
        outputs: Files and folders by the option that names each; None: not wanted.
        data: Data sets, folders in them or files that are only read: see `check_apart`.
        results: Folders of result files, or such a file: a report may stand beside them, and
            must not take the place of one.

    Raises:
        ValueError: An output is in the data, is one of the results, is named twice, or is a folder
            in which a file lies that is read and that reports or results might replace.
    """
    taken: dict[Path, str] = {}
    places = {option: path for option, path in outputs.items() if path is not None}
    for option, path in places.items():
        other = taken.setdefault(path.resolve(), option)
        if other != option:
            raise ValueError(f"{other} and {option} both name {path}; name another place for one")
    for each in data:
        if each is not None:
            check_apart(each, places.values())
            _check_not_within(each, places)
    for folder in filter(None, results):
        for option, path in places.items():
            place = path.resolve()
            is_result = place.suffix in RESULT_SUFFIXES or place.name == MANIFEST_NAME
            is_read = place == folder.resolve() or is_result
            if is_read and place.exists() and place.is_relative_to(folder.resolve()):
                raise ValueError(
                    f"{option} {path} is among the results that are to be read, which it would "
                    "replace; name another place"
                )


def _check_not_within(file: Path, places: Mapping[str, Path]) -> None:
    if file.suffix.lower() not in _WRITTEN_SUFFIXES or file.is_dir():
        return
    for option, place in places.items():
        if not place.is_file() and file.resolve().is_relative_to(place.resolve()):
            raise ValueError(
                f"{file}, which is only read, lies in {option} {place}, whose files are written; "
                "name a copy of it elsewhere, or another place"
            )


def check_apart(data: Path, outputs: Iterable[Path]) -> None:
    """Refuses files and folders in a data set, where they would replace or become parts of it.

    Links are followed, those in the data set as well.

    Args:
        data: The data set, one of its splits or of their folders; or a file that is read.
        outputs: What is to be written.

    Raises:
        ValueError: One is the data set or file, or lies in the data set.
    """
    roots = {_root_of(data.absolute()), _root_of(data.resolve())}
    folders = {folder for root in roots for folder in (root, *(root / s for s in OBJECT_SPLITS))}
    sources = roots | {path for folder in folders for path in _targets(folder)}
    for output in outputs:
        written = Path(os.path.normpath(output.absolute())), output.resolve()
        if any(path.is_relative_to(source) for path in written for source in sources):
            raise change_of_data(data, output)
        if output.is_file() and any(_links_to(root, output.resolve()) for root in roots):
            raise change_of_data(data, output)


def _root_of(data: Path) -> Path:
    """The data set of an object tree's split, or of a folder of one."""
    split = next((each for each in (data, data.parent) if each.name in OBJECT_SPLITS), None)
    return data if split is None else split.parent


def _targets(folder: Path) -> Iterator[Path]:
    """Where a folder and the links in it lead to."""
    yield folder.resolve()
    with suppress(OSError), os.scandir(folder) as entries:
        yield from (Path(entry.path).resolve() for entry in entries if entry.is_symlink())


def _links_to(root: Path, file: Path) -> bool:
    """True if a file of a data set is a link to this one."""
    paths = (Path(folder, name) for folder, _, names in os.walk(root) for name in names)
    return any(path.is_symlink() and path.resolve() == file for path in paths)


def change_of_data(data: Path, output: Path) -> ValueError:
    """Error for an output that would change the input."""
    what = "file" if data.is_file() else "data set"
    return ValueError(
        f"{output} cannot be written to, as that would change the {what} {data}, which is only "
        "read; name a place beside it"
    )


def read_claim(folder: Path, manifest_name: str = MANIFEST_NAME) -> dict[str, object] | None:
    """What the manifest of a folder says; None where there is none that can be read."""
    try:
        told = json.loads(_manifest_text(folder / manifest_name))
    except (ValueError, RecursionError):
        return None
    return told if isinstance(told, dict) else None


def data_name(data: Path) -> str:
    """What a claim calls the data that files are made from: the folder's name and its parent's.

    So trees of one name, such as a case of two corrupted data sets, are told apart, while the same
    data may be mounted elsewhere on another machine.
    """
    return escaped("/".join(data.resolve().parts[-2:]))


def _refusal(folder: Path, held: str, manifest_name: str) -> str:
    return (
        f"{folder} holds {held}, which would mix with this job; name another output folder or "
        f"empty this one, its {manifest_name} too"
    )


def _difference(there: str, settings: Mapping[str, object]) -> str:
    """What the folder's files were made with that this job is not."""
    before = None
    with suppress(ValueError, RecursionError):
        before = json.loads(there)
    if not isinstance(before, dict):
        return "a damaged manifest"
    described = list(_differences(before, json.loads(json.dumps(dict(settings)))))
    if not described:
        return "files made with the same settings, written otherwise"
    more = len(described) - _MOST_DIFFERENCES
    beyond = [f"{more} more that differ"] if more > 0 else []
    return f"files made with {', '.join(described[:_MOST_DIFFERENCES] + beyond)}"


def _differences(before: Mapping[str, object], now: Mapping[str, object]) -> Iterator[str]:
    """What differs, by name; of settings inside settings, such as a task's, those that differ."""
    for name in {**before, **now}:
        held, asked = before.get(name), now.get(name)
        if isinstance(held, dict) and isinstance(asked, dict):
            yield from (f"{name} {inner}" for inner in _differences(held, asked))
        elif held != asked:
            yield f"{shortened(name)} {_shown(held)} instead of {_shown(asked)}"


def _shown(value: object) -> str:
    if isinstance(value, dict):
        value = ", ".join(f"{name} {inner}" for name, inner in value.items())
    return "none" if value is None else shortened(str(value), _LONGEST_VALUE)


@dataclass(frozen=True, slots=True)
class _Attempt:
    """Does a piece by its number; returns the error, empty if there is none."""

    works: Sequence[Work]

    def __call__(self, position: int) -> str:
        work = self.works[position]
        try:
            work.run()
        except (ValueError, OSError) as error:
            return f"{work}: {error}"
        except Exception as error:
            if (fault := memory_fault(error)) is None:
                raise
            return f"{work}: {fault}"
        return ""
