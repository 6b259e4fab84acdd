"""Digests of label files, by which kept predictions and scores are matched to the labels."""

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.datasets.sample_files import LABEL_DIGEST_DIGITS, digest_labels
from sightline.data.layouts.kitti_trees import describe_absent
from sightline.files.atomic import atomic_write_text
from sightline.files.plain_text import read_text
from sightline.geometry.user_warning import warn_user

PLACED_BY: Final = "labels.json"
"""File in a case's folder of predictions: digests of the labels that occlusions were placed by."""


def digest_all_labels(dataset: SampleDataset) -> str:
    """Compute a digest of the labels of all frames; see `digest_labels`."""
    content = json.dumps(digest_labels(dataset)).encode()
    return hashlib.sha256(content).hexdigest()[:LABEL_DIGEST_DIGITS]


def check_placing_labels(dataset: SampleDataset, kept: Mapping[Path, frozenset[str]]) -> None:
    """Warn of kept predictions whose occlusions other labels placed, and record today's labels.

    Nothing is known of predictions by versions that recorded no labels.

    Args:
        dataset: Data set of the predictions.
        kept: Names of the frames with predictions, by the folder of a case that hits objects.
    """
    labels = digest_labels(dataset) if kept else {}
    others: dict[Path, set[str]] = {}
    for folder, names in kept.items():
        recorded = _recorded(folder / PLACED_BY) if names else {}
        then = {name: recorded[name] for name in names & recorded.keys()}
        other = {name for name, digest in then.items() if labels.get(name, digest) != digest}
        if other:
            others[folder] = other
        now = {name: digest for name, digest in labels.items() if name not in names} | then
        if now != recorded:
            atomic_write_text(folder / PLACED_BY, json.dumps(now, indent=2, sort_keys=True) + "\n")
    if others:
        frames = sorted(set.union(*others.values()))
        warn_user(
            f"{len(frames):,} of {len(dataset):,} frames ({describe_absent(frames)}) had other "
            "labels when predictions were made whose occlusions are placed by labels; to make "
            f"these anew, remove {', '.join(map(str, others))}",
        )


def _recorded(path: Path) -> dict[str, str]:
    """Read the digests of a folder of predictions; empty if there are none."""
    if not path.exists():
        return {}
    with suppress(ValueError, AttributeError, RecursionError):
        content = json.loads(read_text(path))
        return {str(name): str(digest) for name, digest in content.items()}
    warn_user(
        f"{path} is damaged: labels that were changed since the predictions beside it were made "
        f"are not noticed; if there may be any, remove {path.parent}",
    )
    return {}
