"""Check for links that lead out of an output folder."""

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path


def check_links(folder: Path, *, files: bool = False) -> None:
    """Refuse an output folder with a broken link or a link to a folder outside.

    The folder itself may be a link, and links may lead to other places inside it. A link to a file
    is harmless for files written by `atomic_path`, which replaces the link.

    Args:
        folder: Output folder; may be missing.
        files: Whether to refuse links to files, too: for libraries, which follow them.

    Raises:
        ValueError: The folder contains such a link.
    """
    inside = os.path.realpath(folder)
    for link in _links(folder):
        leads = Path(os.path.realpath(link))
        where = f"outside {folder}" if leads.exists() else "which is not there"
        if leads.exists() and (leads.is_relative_to(inside) or (leads.is_file() and not files)):
            continue
        raise ValueError(
            f"{link} is a link to {leads}, {where}, and nothing may be written where it leads; "
            "remove the link, or name another output folder"
        )


def _links(folder: Path) -> Iterator[Path]:
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_symlink():
                yield Path(entry.path)
            elif entry.is_dir():
                yield from _links(Path(entry.path))
