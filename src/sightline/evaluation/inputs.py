"""Check of the inputs of an evaluation."""

import os
from pathlib import Path


def check_apart(results: Path | str, truth: Path | str, noun: str) -> None:
    """Refuse to score results against themselves.

    Args:
        results: File or folder of results.
        truth: File or folder that they are scored against.
        noun: Name of the latter in the error.

    Raises:
        ValueError: Both are the same file or folder.
    """
    if os.path.realpath(results) == os.path.realpath(truth):
        raise ValueError(
            f"{results} is named both as the results and as {noun}, so every score would be "
            "perfect; name the two apart"
        )
