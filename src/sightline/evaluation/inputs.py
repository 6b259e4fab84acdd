"""Check of the inputs of an evaluation."""

import os
import warnings
from pathlib import Path

from sightline.data.recording_files import is_recording
from sightline.files.byte_source import url_of
from sightline.files.shard_path import data_path
from sightline.jobs.output_dirs import data_name, is_split, read_claim


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


def warn_of_other_data(results: Path, truth: Path) -> None:
    """Warn of results whose sightline.json names another data set than that of the truth.

    A truth on a server, or outside a recording and a KITTI object tree, is not compared.
    """
    if url_of(truth) is not None:
        return
    folder = data_path(truth.absolute()).parent
    if not is_split(folder) and not is_recording(folder):
        return
    made_from = (read_claim(data_path(results)) or {}).get("data")
    if made_from not in (None, data_name(folder), data_name(folder.parent)):
        data = folder.parent if is_split(folder) else folder
        warnings.warn(
            f"{results} was made from {made_from}, not from {data}; check that frames with the "
            "same name are the same",
            stacklevel=2,
        )
