"""What is wrong with a file, said so that it can be put right."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


def escaped(text: str) -> str:
    """Show what no screen shows as an escape: control characters, line ends, foreign bytes.

    Marks that turn the order of letters count among them.
    """
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else ascii(each)[1:-1] for each in text)


def plain_line(text: str) -> str:
    """Turn any text into one line that a terminal, a log and a page can show."""
    return escaped(" ".join(text.split()))


@dataclass(frozen=True, kw_only=True, slots=True)
class Problem:
    """One fault of a data set; `str` gives it as one line."""

    path: Path
    problem: str
    """What is wrong, after the path: "holds 17 bytes, expected .."."""
    remedy: str
    """What to do."""

    def __str__(self) -> str:
        """The file, what is wrong with it and what to do, in characters that any screen shows."""
        return plain_line(f"{self.path}: {self.problem}; {self.remedy}")


def install_command(extra: Literal["export", "pretrained", "ros", "viz"]) -> str:
    """Command that installs the packages of an extra, for hints: Sightline is on no index."""
    return f"pip install '.[{extra}]', in the folder of Sightline's source"


class FileError(ValueError):
    """A file cannot be used, for the reason and with the remedy that its fields hold."""

    def __init__(self, path: Path | str, problem: str, remedy: str) -> None:
        """Says what is wrong with which file, and what to do; as `Problem`'s fields."""
        super().__init__(path, problem, remedy)  # all three: so it survives pickling

    @property
    def problem(self) -> Problem:
        """The same as a line of a longer report."""
        path, problem, remedy = self.args
        return Problem(path=Path(path), problem=problem, remedy=remedy)

    def __str__(self) -> str:
        """The problem's line."""
        return str(self.problem)


_OUT_OF_MEMORY = (
    "can't allocate memory",  # PyTorch
    "not enough memory",
    "out of memory",  # CUDA
    "bad_alloc",  # C++
    "bad allocation",
    "Insufficient memory",  # OpenCV
    "Failed to allocate",
    "Cannot allocate memory",
    "failed to map segment",  # a library that is being loaded
    "can't start new thread",
)


def memory_fault(error: BaseException) -> str | None:
    """Say in one line that memory ran out, where that is what an error means; else None.

    Libraries raise errors of many types for it.
    """
    text = str(error)
    if not isinstance(error, MemoryError) and not any(each in text for each in _OUT_OF_MEMORY):
        return None
    return (
        "memory ran out; use fewer workers, smaller batches or frames, or a machine (a limit) with "
        "more memory"
    )
