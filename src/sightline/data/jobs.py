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
from sightline.data.parallel import run_pieces
from sightline.data.plain_text import shortened
from sightline.data.progress import track

MANIFEST_NAME: Final = "sightline.json"
"""File in an output folder that says what made the others."""

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
            folder cannot be written to.
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
    path = folder / manifest_name
    # In this order: a job has written its manifest before its first result.
    has_results = any(next(folder.glob(pattern), None) is not None for pattern in results)
    if not path.exists():
        if has_results:
            raise ValueError(_refusal(folder, f"data without a {manifest_name}", manifest_name))
        return False
    there = path.read_text(errors="replace")
    if there != _manifest(settings):
        raise ValueError(_refusal(folder, _difference(there, settings), manifest_name))
    return True


def _manifest(settings: Mapping[str, object]) -> str:
    return json.dumps(dict(settings), indent=2) + "\n"


def check_apart(data: Path, folders: Iterable[Path]) -> None:
    """Refuses output folders in a data set, whose files would be taken for parts of it.

    Links are followed, those of the splits of an object tree as well.

    Raises:
        ValueError: A folder is the data set's or lies in it.
    """
    root = data.absolute()
    root = root.parent if root.name in OBJECT_SPLITS else root
    sources = {root, root.resolve(), *((root / split).resolve() for split in OBJECT_SPLITS)}
    for folder in folders:
        written = Path(os.path.normpath(folder.absolute())), folder.resolve()
        if any(path.is_relative_to(source) for path in written for source in sources):
            raise change_of_data(data, folder)


def change_of_data(data: Path, folder: Path) -> ValueError:
    """What is said of an output folder that would change the input."""
    return ValueError(
        f"{folder} cannot be written to, as that would change the data set {data}, which is only "
        "read; name an output folder beside it"
    )


def read_claim(folder: Path, manifest_name: str = MANIFEST_NAME) -> dict[str, object] | None:
    """What the manifest of a folder says; None where there is none that can be read."""
    try:
        told = json.loads((folder / manifest_name).read_text(errors="replace"))
    except (OSError, ValueError, RecursionError):
        return None
    return told if isinstance(told, dict) else None


def data_name(data: Path) -> str:
    """What a claim calls the data that files are made from: the folder's name and its parent's.

    So trees of one name, such as a case of two corrupted data sets, are told apart, while the same
    data may be mounted elsewhere on another machine.
    """
    return "/".join(data.resolve().parts[-2:])


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
    described = _differences(before, json.loads(json.dumps(dict(settings))))
    return f"files made with {', '.join(described) or 'the same settings, written otherwise'}"


def _differences(before: Mapping[str, object], now: Mapping[str, object]) -> Iterator[str]:
    """What differs, by name; of settings inside settings, such as a task's, those that differ."""
    for name in {**before, **now}:
        held, asked = before.get(name), now.get(name)
        if isinstance(held, dict) and isinstance(asked, dict):
            yield from (f"{name} {inner}" for inner in _differences(held, asked))
        elif held != asked:
            yield f"{name} {_shown(held)} instead of {_shown(asked)}"


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
        return ""
