"""What is wrong with a file, said so that it can be put right."""

from dataclasses import dataclass
from pathlib import Path

_REMEDY = "extract or write it again"


@dataclass(frozen=True, kw_only=True, slots=True)
class Problem:
    """One fault of a data set; `str` gives it as one line."""

    path: Path
    problem: str
    remedy: str

    def __str__(self) -> str:
        """The file, what is wrong with it and what to do."""
        return " ".join(f"{self.path}: {self.problem}; {self.remedy}".split())


def problem_from_error(path: Path, error: Exception) -> Problem:
    """The problem that a reader's error tells of: "PATH what; remedy"."""
    text = str(error).removeprefix(str(path)).lstrip(":, ")
    problem, semicolon, remedy = text.rpartition("; ")
    if not semicolon:
        problem, remedy = text, _REMEDY
    return Problem(path=path, problem=problem, remedy=remedy)
