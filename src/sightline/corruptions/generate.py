"""Corrupted data sets on disk: resumable, parallel and reproducible to the byte."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Final

import torch

from sightline.corruptions.corruption import Corrupted, Corruption, Record, everywhere
from sightline.corruptions.suites import Case, Suite, find_suite
from sightline.data.checks.lidar_mount import record_pose
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.datasets.newer_frames import warn_of_newer_frames
from sightline.data.formats.kitti_files import write_image, write_points
from sightline.data.formats.map_png import read_mask_png, write_mask_png
from sightline.data.layouts.frame_lists import list_unequal_files
from sightline.data.layouts.kitti_trees import (
    CORRUPTED,
    ObjectFrame,
    Part,
    Velodyne,
    describe_absent,
    list_files,
    list_object_frames,
    part_folder,
)
from sightline.data.open import open_dataset
from sightline.files.atomic import atomic_link, atomic_write_text
from sightline.files.shard_path import stored_file
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments
from sightline.jobs.crew import Driver
from sightline.jobs.output_dirs import (
    acquire_output_dir,
    check_outside_dataset,
    data_change_error,
    data_name,
)
from sightline.jobs.run import LEAVE_OUT, JobResult, check_workers, run_job, shard
from sightline.structures.sample import SENSOR_FIELDS

PARTS: Final[tuple[Part, ...]] = ("image", "points", "calibration", "objects", "depth")
"""Parts of a frame that a case's tree also contains, if the input does."""

_RECORDS = CORRUPTED
_MASKS = ("camera_mask", "lidar_mask")
_LISTS = "ImageSets"


@dataclass(frozen=True, kw_only=True, slots=True)
class CaseTree:
    """KITTI's object tree of one case, with a record of each frame's corruption.

    `SPLIT/corruption/N.json` holds the record; `SPLIT/{camera_mask,lidar_mask}/N.png`, if
    requested, the pixels that may have changed. Unchanged files are hard links to the input's
    files, or copies if such links are not supported. `SPLIT/lidar_mount.json` holds the LiDAR's
    pose over the road in the input, which broken clouds do not show.
    """

    root: Path
    split: str
    velodyne: Velodyne
    masks: bool

    def finished(self, originals: dict[str, ObjectFrame]) -> set[str]:
        """Find the names of frames with all their files; an existing file is complete."""
        folder = self.root / self.split
        there = list_object_frames(folder, PARTS, self.velodyne)
        noted = set(list_files(folder / _RECORDS, (".json",)))
        for mask_folder in _MASKS if self.masks else ():
            noted &= set(list_files(folder / mask_folder, (".png",)))
        return {
            name
            for name in noted & there.keys() & originals.keys()
            if all(
                getattr(there[name], part) is not None
                for part in PARTS
                if getattr(originals[name], part) is not None
            )
        }

    def write(self, corrupted: Corrupted, original: ObjectFrame) -> None:
        """Write or link all parts of a frame atomically."""
        folder, name = self.root / self.split, original.sample_id
        sample, changed = corrupted.sample, set[Part]()
        if "camera" in corrupted.record.sensors and sample.image is not None:
            write_image(folder / part_folder("image") / f"{name}.png", sample.image)
            changed.add("image")
        if "lidar" in corrupted.record.sensors and sample.points is not None:
            points = folder / part_folder("points", self.velodyne) / f"{name}.bin"
            write_points(points, sample.points)
            changed.add("points")
        for part in PARTS:
            path: Path | None = getattr(original, part)
            if path is not None and part not in changed:
                atomic_link(folder / part_folder(part, self.velodyne) / path.name, path)
        if self.masks:
            masks = (corrupted.camera_mask, corrupted.lidar_mask)
            for mask_folder, mask in zip(_MASKS, masks, strict=True):
                write_mask_png(folder / mask_folder / f"{name}.png", mask.numpy())
        record = json.dumps(corrupted.record.to_json(), indent=2) + "\n"
        atomic_write_text(self.record(name), record)

    def record(self, name: str) -> Path:
        """File with the record of a frame, which is written last."""
        return self.root / self.split / _RECORDS / f"{name}.json"

    def link_lists(self, data: Path) -> None:
        """Link the input's lists of frames."""
        for path in list_files(data / _LISTS, (".txt",)).values():
            atomic_link(self.root / _LISTS / path.name, path)


def read_corrupted(
    root: Path, name: str, corruption: Corruption, velodyne: Velodyne
) -> Corrupted | None:
    """Read a labelled frame of a case's tree, with its masks; None without any sensor file.

    Args:
        root: Root of the tree.
        name: Name of the frame.
        corruption: Corruption of the case. Its drawn values are not read.
        velodyne: The sweeps' folder.

    Raises:
        ValueError: A file is damaged; the message contains its name.
    """
    split: Final = "training"
    if name not in list_object_frames(root / split, ("image", "points"), velodyne):
        return None
    parts: tuple[Part, ...] = ("image", "points", "objects")
    frames = KittiObjectDataset(
        root, split, sample_list=(name,), velodyne=velodyne, parts=parts, needs=()
    )
    sample = frames[0]
    camera_mask, lidar_mask = (
        torch.from_numpy(read_mask_png(path)) if path.is_file() else everywhere(sample)
        for path in (root / split / folder / f"{name}.png" for folder in _MASKS)
    )
    record = Record(kind=corruption.kind, sensors=corruption.sensors, parameters={})
    return Corrupted(sample=sample, record=record, camera_mask=camera_mask, lidar_mask=lidar_mask)


@named_arguments
def corrupt_dataset(
    data: Path,
    out: Path,
    *,
    suite: str,
    seed: int = 0,
    cases: Sequence[str] | None = None,
    sample_list: str | Path | Sequence[str] | None = None,
    velodyne: Velodyne | None = None,
    masks: bool = False,
    workers: int = 2,
    driver: Driver = "local",
    shard_index: int = 0,
    num_shards: int = 1,
) -> JobResult:
    """Write the cases of a suite, each as an object tree `out`/CASE; see `CaseTree`.

    The input is only read. Files are written atomically and existing files are skipped, so a
    stopped job can be resumed; more cases or another list extend the data set. A frame's corruption
    depends only on the seed, its name and the kind.

    Args:
        data: KITTI's object tree, or one of its splits.
        out: Output folder for the cases; its sightline.json records the settings.
        suite: Name of the suite.
        seed: Another seed draws other boxes, discs and noise.
        cases: Names of the cases to write. None: all.
        sample_list: Frames to write; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder. None: velodyne, or else velodyne_reduced.
        masks: Whether to write the pixels that may have changed, too.
        workers: Number of workers; 1 on this machine uses this process alone.
        driver: Kind of workers: processes of this machine, or actors of a Ray cluster.
        shard_index: Part of the frames to write, from 0.
        num_shards: Number of parts; parts can run on separate machines at the same time.

    Returns:
        Frames written and skipped, each counted once per case.

    Raises:
        ValueError: There is no such suite or case, the data are not a readable object tree, `out`
            is inside the data or holds other output, or a number is invalid. Errors about a frame
            contain its name; finished frames are kept.
    """
    chosen = find_suite(suite)
    requested = chosen.cases if cases is None else chosen.select(cases)
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}")
    check_workers(workers, driver)
    shard((), shard_index, num_shards)  # rejects invalid values before the data is opened
    dataset = _open(data, sample_list, velodyne)
    _check_apart(dataset.root, out, requested)
    velodyne = dataset.velodyne
    originals = list_object_frames(dataset.root / dataset.split, PARTS, velodyne)
    _check_parts(dataset, originals, requested)
    trees = [
        CaseTree(root=out / case.name, split=dataset.split, velodyne=velodyne, masks=masks)
        for case in requested
    ]
    acquire_output_dir(
        out,
        case_settings(dataset, chosen, seed),
        results=("*/training", "*/testing", "*/ImageSets"),
    )
    finished = [tree.finished(originals) for tree in trees]
    works = []
    for index in shard(range(len(dataset)), shard_index, num_shards):
        name = dataset.sample_ids[index]
        pending = tuple(
            (case, tree)
            for case, tree, done in zip(requested, trees, finished, strict=True)
            if name not in done
        )
        works.append(_FrameWork(dataset, index, originals[name], seed, pending))
    kept = (
        (
            work.index,
            [
                tree.record(work.original.sample_id)
                for tree, done in zip(trees, finished, strict=True)
                if work.original.sample_id in done
            ],
        )
        for work in works
    )
    remedy = f"to make them anew, remove {out}"
    warn_of_newer_frames(dataset, kept, parts=PARTS, remedy=remedy)
    names = {work.original.sample_id for work in works}
    kept_names = ((tree, done & names) for tree, done in zip(trees, finished, strict=True))
    _warn_of_other_labels(dataset, kept_names, remedy)
    for tree in trees:
        tree.link_lists(dataset.root)
        record_pose(tree.root / tree.split, dataset.pose)
    run_job(
        [work for work in works if work.pending],
        workers,
        description=f"corrupting by {suite}",
        leave_out=LEAVE_OUT,
        driver=driver,
    )
    written = sum(len(work.pending) for work in works)
    return JobResult(written=written, skipped=len(works) * len(requested) - written)


def _warn_of_other_labels(
    dataset: KittiObjectDataset, kept: Iterable[tuple[CaseTree, set[str]]], remedy: str
) -> None:
    """Warn of kept frames with other labels than the input's, also with older files."""
    place = Path(dataset.split) / part_folder("objects")
    if stored_file(dataset.root / place) is None:  # each label would be a request to a server
        return
    others = sorted(
        {
            name
            for tree, names in kept
            for name in list_unequal_files(dataset.root / place, tree.root / place, names)
        }
    )
    if others:
        warn_user(
            f"the labels of {len(others):,} kept frames ({describe_absent(others)}) are others in "
            f"{dataset.root / place} now; {remedy}",
        )


@dataclass(frozen=True, slots=True)
class _FrameWork:
    """Job that reads a frame once and writes it for each case."""

    dataset: KittiObjectDataset
    index: int
    original: ObjectFrame
    seed: int
    pending: tuple[tuple[Case, CaseTree], ...]

    def __str__(self) -> str:
        return f"frame {self.original.sample_id}"

    def run(self) -> None:
        sample = self.dataset[self.index]
        for case, tree in self.pending:
            tree.write(case.corrupt(sample, self.seed), self.original)


def _open(
    data: Path, sample_list: str | Path | Sequence[str] | None, velodyne: Velodyne | None
) -> KittiObjectDataset:
    parts: tuple[Part, ...] = ("image", "points", "objects")
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne, parts=parts, needs=())
    if not isinstance(dataset, KittiObjectDataset):
        raise ValueError(
            f"{data} is not an object tree; give a folder that "
            "contains training/{image_2,velodyne,calib,label_2} (sightline robustness takes "
            "recordings, too)"
        )
    return dataset


def _check_apart(data: Path, out: Path, cases: Sequence[Case]) -> None:
    """Refuse an output folder that would change the input."""
    check_outside_dataset(data, [out])
    written = [out.resolve() / case.name for case in cases]
    if any(data.resolve().is_relative_to(folder) for folder in written):
        raise data_change_error(data, out)


def _check_parts(
    dataset: KittiObjectDataset, originals: dict[str, ObjectFrame], cases: Sequence[Case]
) -> None:
    """Refuse data without a sensor that a case corrupts."""
    for sensor, part in SENSOR_FIELDS.items():
        breaking = [case.name for case in cases if sensor in case.corruption.sensors]
        lacking = [name for name in dataset.sample_ids if getattr(originals[name], part) is None]
        if breaking and lacking:
            raise ValueError(
                f"{dataset.root} has no {part} of frame {lacking[0]} for case {breaking[0]}; "
                "choose cases of the other sensor, or a list of complete frames"
            )


def case_settings(dataset: KittiObjectDataset, suite: Suite, seed: int) -> dict[str, object]:
    """Collect all settings of a data set's cases, except the requested frames and cases."""
    return {
        "sightline": version("sightline"),
        "data": data_name(dataset.root),
        "split": dataset.split,
        "velodyne": dataset.velodyne,
        "suite": suite.name,
        "seed": seed,
        "cases": {case.name: case.corruption.described() for case in suite.cases},
    }
