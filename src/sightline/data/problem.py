"""What is wrong with a file, said so that it can be put right."""

from dataclasses import dataclass
from pathlib import Path


def one_line(text: str) -> str:
    """Text in one line without control characters: names out of data may hold any.

    Bytes of another encoding, which no terminal and no log file takes, are written in hexadecimal.
    """
    line = " ".join(text.split())
    return line if line.isprintable() else ascii(line)[1:-1]


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
        return one_line(f"{self.path}: {self.problem}; {self.remedy}")


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
