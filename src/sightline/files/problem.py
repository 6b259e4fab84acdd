"""Problems of files, each with a remedy."""

import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, TypeVar

Content = TypeVar("Content")

Extra = Literal["app", "export", "pretrained", "ray", "remote", "ros", "simulate", "train", "viz"]
"""Optional libraries, as `pyproject.toml` names them."""

_ADDRESS: Final = re.compile(r"([a-zA-Z][a-zA-Z0-9+.-]+):/+(.+)", re.DOTALL)
"""Address as pathlib keeps it, which joins its slashes."""
GIVE_ACCESS: Final = "give this user access to it and its folder"
"""Remedy for a file or folder without permission, whose contents are unknown."""
_MAX_SUBJECT_WORDS: Final = 2
"""Largest number of words of a file or frame without folders, such as "sample 000042"."""


def escaped(text: str) -> str:
    """Escape invisible characters: control characters, line ends, invalid bytes.

    Marks that change the direction of text are escaped, too.
    """
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else ascii(each)[1:-1] for each in text)


def plain_line(text: str) -> str:
    """Turn any text into one line for terminals, logs and pages."""
    return escaped(" ".join(text.split()))


def address(path: Path | str) -> str | None:
    """Address such as s3://bucket/shards of a path that pathlib made of it; None: it is none."""
    match = _ADDRESS.fullmatch(str(path))
    if match is None:
        return None
    scheme = match[1].lower()
    return f"{scheme}:{'///' if scheme == 'file' else '//'}{match[2]}"


def shown_place(path: Path | str) -> str:
    """Path, or address without the user's name and password, for messages."""
    url = address(path)
    return str(path) if url is None else re.sub("(?<=://)[^/]*@", "", url)


def markdown_text(text: str) -> str:
    """Escape text for Markdown, so that it ends no cell and begins no tag or link."""
    return plain_line(text).replace("|", "\\|").replace("<", "&lt;").replace("](", "]\\(")


def kind_of_message(text: str) -> str:
    """Remove the file or frame before ": ", and all digits: messages of one kind become equal."""
    subject, _, rest = text.partition(": ")
    is_name = "/" in subject or len(subject.split()) <= _MAX_SUBJECT_WORDS
    return re.sub(r"\d+", "", rest if rest and is_name else text)


@dataclass(frozen=True, kw_only=True, slots=True)
class Problem:
    """Fault of a data set; `str` formats it as one line."""

    path: Path
    problem: str
    """Description of the fault, after the path: "holds 17 bytes, expected .."."""
    remedy: str
    """Action for the user."""

    def __str__(self) -> str:
        """Format file, fault and remedy in printable characters."""
        return plain_line(f"{shown_place(self.path)}: {self.problem}; {self.remedy}")


def install_command(extra: Extra) -> str:
    """Format the command that installs the packages of an extra: Sightline is on no index."""
    return f"pip install '.[{extra}]', in the folder of Sightline's source"


class FileError(ValueError):
    """Error for an unusable file, with the reason and the remedy as fields."""

    def __init__(self, path: Path | str, problem: str, remedy: str) -> None:
        """Store file, fault and remedy; see `Problem`."""
        super().__init__(path, problem, remedy)  # all three, for pickling

    @property
    def problem(self) -> Problem:
        """Convert the error to a problem of a report."""
        path, problem, remedy = self.args
        return Problem(path=Path(path), problem=problem, remedy=remedy)

    def __str__(self) -> str:
        """Format the problem's line."""
        return str(self.problem)


def read_or_note(
    reader: Callable[[Path], Content], path: Path | None, problems: list[Problem]
) -> Content | None:
    """Read a file; if the reader refuses it, add a problem and return None."""
    if path is None:
        return None
    try:
        return reader(path)
    except FileError as error:
        problems.append(error.problem)
        return None


REMAKE: Final = "remove it and run the same command again"
"""Remedy for a damaged file that the running command made itself."""


@contextmanager
def remaking(folder: Path | None) -> Iterator[None]:
    """Replace the remedies for damaged files in a folder whose files the command makes itself.

    Args:
        folder: The folder; None: the user's own files, which keep their remedies.
    """
    try:
        yield
    except FileError as error:
        path, problem, _ = error.args
        if folder is None or not Path(path).is_relative_to(folder):
            raise
        raise FileError(path, problem, REMAKE) from error


def error_text(error: Exception) -> str:
    """Format an error; a lack of permission with a remedy, where no reader has foreseen it."""
    if isinstance(error, PermissionError) and error.filename is not None:
        path = plain_line(os.fsdecode(error.filename))
        return f"{path}: {(error.strerror or str(error)).lower()}; {GIVE_ACCESS}"
    return str(error)


def refuse_without_effect(place: str, **is_given: bool) -> None:
    """Refuse options that would be ignored.

    Args:
        place: End of the sentence: "on nuScenes".
        is_given: Whether each option is given, by its name in Python.

    Raises:
        ValueError: One is given.
    """
    flags = [f"--{name.replace('_', '-')}" for name, given in is_given.items() if given]
    if flags:
        one, it = ("has", "it") if len(flags) == 1 else ("have", "them")
        raise ValueError(f"{' and '.join(flags)} {one} no effect {place}; leave {it} out")


class SetupError(ValueError):
    """Error of the process or the machine, whatever its input is: no piece of a job is to blame."""


_OUT_OF_MEMORY = (
    "can't alloc",  # PyTorch (can't allocate memory), OpenVINO
    "not enough memory",
    "out of memory",  # CUDA
    "bad_alloc",  # C++
    "bad allocation",
    "Insufficient memory",  # OpenCV
    "Failed to allocate",
    "Cannot allocate memory",
    "failed to map segment",  # a library that is being loaded
)
_OUT_OF_THREADS = (
    "can't start new thread",
    "Resource temporarily unavailable",  # C's text for it, also of a process
)


def memory_fault(error: BaseException) -> str | None:
    """Make a one-line message for an error caused by lack of memory or threads; else None.

    Libraries raise errors of many types for it.
    """
    text = str(error)
    if any(each in text for each in _OUT_OF_THREADS):
        return (
            "no further thread or process can be started; use fewer workers, or raise the limits "
            "of processes (ulimit -u, or a container's) and memory"
        )
    if not isinstance(error, MemoryError) and not any(each in text for each in _OUT_OF_MEMORY):
        return None
    return (
        "memory ran out; use fewer workers, smaller batches or frames, or a machine (a limit) with "
        "more memory"
    )
