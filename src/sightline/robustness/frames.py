"""Frames of a run, with all parts needed by its cases, methods and scoring."""

import hashlib
import sys
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, Final

from sightline.corruptions.combined import hits_objects
from sightline.corruptions.suites import Case
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.datasets.sample_files import list_sample_files, refuses_gaps
from sightline.data.layouts.kitti_trees import Part, Velodyne
from sightline.data.open import open_dataset
from sightline.files.plain_file import check_regular
from sightline.files.plain_text import REMEDY
from sightline.geometry.user_warning import warn_user
from sightline.structures.sample import SENSOR_FIELDS

_INPUT_PARTS: Final[tuple[Part, ...]] = ("image", "points", "objects")
_DIGITS: Final = 16
_WORDS: Final[dict[Part, str]] = {"image": "images", "points": "sweeps"}


def open_frames(
    data: Path,
    parts: Collection[Part],
    cases: Sequence[Case],
    *,
    sample_list: str | Path | Sequence[str] | None,
    velodyne: Velodyne | None,
) -> SampleDataset:
    """Open the data set with the requested parts, and with those of the sensors that cases corrupt.

    Images, sweeps and labels are read if present, since the effect of a kind may depend on any of
    them: occlusions hit objects, and fog in an image becomes denser with the depth from a sweep. So
    every method gets the same corruptions, independent of its own inputs. A warning tells labels
    that cannot be read.

    Args:
        data: See `open_dataset`.
        parts: Parts needed by methods and scoring.
        cases: The requested cases.
        sample_list: Samples to use; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder in an object tree. None: velodyne, or else velodyne_reduced.

    Raises:
        ValueError: The data cannot be read, or lack a part; the message contains the case that
            needs it.
    """

    def opened(needs: Collection[Part], *optional: Part) -> SampleDataset:
        options: dict[str, Any] = {"sample_list": sample_list, "velodyne": velodyne}
        options["parts"] = {*needs, *optional}
        dataset = open_dataset(data, **options, needs=needs)
        return dataset if refuses_gaps(dataset) else open_dataset(data, **options)

    needed: set[Part] = set(parts)
    dataset = opened(needed)
    for sensor, part in SENSOR_FIELDS.items():
        case = next((each for each in cases if sensor in each.corruption.sensors), None)
        if case is None:
            continue
        remedy = f"leave the cases that break the {sensor} out (--cases)"
        try:
            dataset = opened(needed | {part})
        except ValueError as error:
            raise ValueError(
                f"case {case.name} needs {_WORDS[part]}: {error}; or {remedy}"
            ) from error
        if getattr(dataset[0], part) is None:  # for a drive: missing files are not always detected
            raise ValueError(
                f"case {case.name} needs {_WORDS[part]}, which {data} lacks; give another data "
                f"set, or {remedy}"
            )
        needed.add(part)
    delivered: list[Part] = []
    for each in _INPUT_PARTS:
        try:
            dataset = opened(needed, *delivered, each)
            delivered.append(each)
        except ValueError as error:
            if each == "objects" and any(hits_objects(case.corruption) for case in cases):
                warn_user(
                    f"labels are not read, so that occlusions are placed anywhere: {error}",
                )
    return dataset


def digest_files(dataset: SampleDataset) -> str:
    """Compute a digest of the names and sizes of all files of the frames, to distinguish data.

    Images, sweeps, calibrations and labels count if present, read or not, so that every method has
    the same digest: the first 16 hexadecimal digits of a SHA-256.
    """
    digest = hashlib.sha256()
    for files in list_sample_files(dataset):
        for part, path in files.items():
            size = check_regular(path, max_bytes=sys.maxsize, remedy=REMEDY)
            digest.update(f"{part}/{path.name} {size}\n".encode())
    return digest.hexdigest()[:_DIGITS]
