"""Opens the frames of a run, with all that its cases, methods and scoring need of them."""

import contextlib
import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

from sightline.corruptions.corruption import Sensor
from sightline.corruptions.suites import Case
from sightline.data.jobs import data_name
from sightline.data.kitti_object import KittiObjectDataset
from sightline.data.object_tree import Part, Velodyne, list_object_frames
from sightline.data.open import NamedSubset, SampleDataset, open_dataset
from sightline.data.recording import RecordingDataset

_DELIVERED: Final[dict[Sensor, Part]] = {"camera": "image", "lidar": "points"}
_SEEN_BY_KINDS: Final[tuple[Part, ...]] = ("image", "points", "objects")
_FRAME_FILES: Final[tuple[Part, ...]] = (*_SEEN_BY_KINDS, "calibration")
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
    """The data set with the parts asked for, and with those of the sensors that cases break.

    Images, sweeps and labels are read wherever they are, since what a kind does may hang on any of
    them: occlusions strike objects, and fog on an image thickens with the depth that a sweep tells.
    So every method meets the same faults, whatever it looks at.

    Args:
        data: See `open_dataset`.
        parts: What methods and scoring need.
        cases: Those that are asked for.
        sample_list: Which samples; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder in an object tree. None: velodyne, or else velodyne_reduced.

    Raises:
        ValueError: The data cannot be read, or lack a part; names the case that needs it.
    """

    def opened(wanted: Collection[Part]) -> SampleDataset:
        given: dict[str, Any] = {"sample_list": sample_list, "velodyne": velodyne, "parts": wanted}
        dataset = open_dataset(data, **given, needs=wanted)
        if isinstance(dataset, KittiObjectDataset | RecordingDataset):
            return dataset
        # Without gaps: other data sets do not tell beforehand which frames lack what.
        return open_dataset(data, **given)

    needed: set[Part] = set(parts)
    dataset = opened(needed)
    for sensor, part in _DELIVERED.items():
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
        if getattr(dataset[0], part) is None:  # of a drive: not every one is refused by its files
            raise ValueError(
                f"case {case.name} needs {_WORDS[part]}, which {data} lacks; give another data "
                f"set, or {remedy}"
            )
        needed.add(part)
    for part in _SEEN_BY_KINDS:
        with contextlib.suppress(ValueError):
            dataset = opened(needed | {part})
            needed.add(part)
    return dataset


def digest_files(dataset: SampleDataset) -> str:
    """Digest of the names and sizes of all files of the frames: data of one name told apart.

    Images, sweeps, calibrations and labels count wherever they are, read or not, so that every
    method has the same. The first 16 hexadecimal digits of a SHA-256.
    """
    whole = dataset.dataset if isinstance(dataset, NamedSubset) else dataset
    if isinstance(whole, KittiObjectDataset):
        folder, sweeps = whole.root / whole.split, whole.velodyne
        frames: Mapping[str, Any] = list_object_frames(folder, _FRAME_FILES, sweeps)
    else:
        frames = {frame.sample_id: frame for frame in getattr(whole, "frames", ())}
    digest = hashlib.sha256()
    for name in dataset.sample_ids:
        frame = frames[name]
        for field in fields(frame):
            path = getattr(frame, field.name)
            if isinstance(path, Path):
                digest.update(f"{field.name}/{path.name} {path.stat().st_size}\n".encode())
    return digest.hexdigest()[:_DIGITS]


def name_of(dataset: SampleDataset, data: Path) -> str:
    """What records call the data: the same for a tree and for the split in it."""
    return data_name(dataset.root if isinstance(dataset, KittiObjectDataset) else data)
