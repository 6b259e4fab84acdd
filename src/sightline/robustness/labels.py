"""Digests of label files, by which kept predictions and scores are matched to the labels."""

import hashlib
import json
import warnings
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Final

from sightline.data.kitti_labels import MAX_LABEL_BYTES
from sightline.data.sample_dataset import SampleDataset
from sightline.data.sample_files import label_file
from sightline.files.atomic import atomic_write_text
from sightline.files.plain_file import read_bytes
from sightline.files.plain_text import REMEDY, read_text
from sightline.files.shard_path import stored_file

PLACED_BY: Final = "labels.json"
"""File in a folder of predictions: digests of the labels that occlusions were placed by."""
_DIGITS: Final = 16


def digest_labels(dataset: SampleDataset) -> dict[str, str]:
    """Compute a digest of each frame's label file, by the frame's name; "" for no labels.

    Frames in shards on a server are left out, as each would be a request.

    Raises:
        FileError: A label file cannot be read.
    """
    files = {name: label_file(dataset, index) for index, name in enumerate(dataset.sample_ids)}
    return {
        name: ""
        if path is None
        else _digest(read_bytes(path, max_bytes=MAX_LABEL_BYTES, remedy=REMEDY))
        for name, path in files.items()
        if path is None or stored_file(path) is not None
    }


def digest_all_labels(dataset: SampleDataset) -> str:
    """Compute a digest of the labels of all frames; see `digest_labels`."""
    return _digest(json.dumps(digest_labels(dataset)).encode())


def check_placing_labels(
    folder: Path, dataset: SampleDataset, kept: Mapping[str, Collection[str]]
) -> None:
    """Warn of kept predictions whose occlusions other labels placed, and record today's labels.

    Args:
        folder: Folder of a method's predictions.
        dataset: Data set of the predictions.
        kept: Names of the frames with predictions by case, of the cases that hit objects.
    """
    labels, recorded = digest_labels(dataset), _recorded(folder / PLACED_BY)
    frames = {name for names in kept.values() for name in names}
    then = {name: digest for name, digest in recorded.items() if name in frames}
    other = {name for name in then.keys() & labels.keys() if then[name] != labels[name]}
    if other:
        cases = [str(folder / case) for case, names in kept.items() if other.intersection(names)]
        warnings.warn(
            f"{folder}: of {len(frames):,} frames with kept predictions whose occlusions are "
            f"placed by labels, {len(other):,} had other labels then, the first is {min(other)}; "
            f"to make them anew, remove {', '.join(cases)}",
            stacklevel=3,
        )
    unknown = frames - then.keys()  # predictions of an older version
    now = {name: digest for name, digest in labels.items() if name not in unknown} | then
    if now != recorded:
        atomic_write_text(folder / PLACED_BY, json.dumps(now, indent=2) + "\n")


def _recorded(path: Path) -> dict[str, str]:
    """Read the digests of a folder of predictions; empty if there are none, or they are damaged."""
    try:
        content = json.loads(read_text(path))
        return {str(name): str(digest) for name, digest in content.items()}
    except (ValueError, AttributeError, RecursionError):
        return {}


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:_DIGITS]
