"""Results of shards of frames, packed into shards: one in, one out."""

import hashlib
import warnings
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Final, Protocol, runtime_checkable

from sightline.data.datasets.kitti_depth import KittiDepthDataset
from sightline.data.datasets.sample_dataset import PosedDataset, SampleDataset
from sightline.data.datasets.sample_files import warn_of_missing_files
from sightline.data.layouts.frame_lists import GapsError
from sightline.data.layouts.kitti_trees import Part
from sightline.data.sharding import files_below, pack_files
from sightline.files.atomic import scratch_folder
from sightline.files.byte_source import url_of
from sightline.files.problem import FileError, SetupError, error_text
from sightline.files.shard_checks import is_whole
from sightline.files.shard_index import (
    FORMAT,
    MANIFEST,
    SHARD_REMEDY,
    read_index,
    read_manifest,
    tars_of,
)
from sightline.files.shard_path import data_path
from sightline.geometry.road_height import LidarPose
from sightline.jobs.crew import Driver
from sightline.jobs.output_dirs import (
    KITTI_SPLITS,
    Claim,
    acquire_output_dir,
    check_outside_dataset,
    claim_folders,
    data_name,
)
from sightline.jobs.run import JobResult, Work, check_workers, run_job, shard

_DRIVE_SPLITS: Final = ("val", "train")  # of depth trees; their drives are sorted together

_WITHOUT_GAPS: Final = (
    "shard the complete frames alone, or leave --pack out and name a list of them"
)


@runtime_checkable  # for beartype, which checks arguments under pytest
class ShardWriter(Protocol):
    """Writer of the results of frames to a folder; must be picklable."""

    @property
    def parts(self) -> Collection[Part]:
        """Parts of frames that predictions use."""

    def open(self, data: Path) -> SampleDataset:
        """Open the frames of a shard.

        Raises:
            ValueError: The data cannot be read.
        """
        ...

    def claims(self, data: Path, dataset: SampleDataset, folder: Path) -> Sequence[Claim]:
        """List the claims of a job without shards on its folders."""
        ...

    def works(self, dataset: SampleDataset, folder: Path) -> Sequence[Work]:
        """List the work on each frame, which writes its results; equal frames give equal bytes."""
        ...


def pack_results(
    writer: ShardWriter,
    data: Path,
    out: Path,
    *,
    description: str,
    workers: int = 2,
    driver: Driver = "local",
    shard_index: int = 0,
    num_shards: int = 1,
) -> JobResult:
    """Write the results of each shard of frames as a shard of the same name.

    `out` becomes a folder of shards, which commands read as if it were unpacked: the files are
    those of a job without shards, with its sightline.json in shared.tar. A shard is the unit of
    work: each worker opens one at a time, by its own index. Shards that are whole, by their
    checksum, and of the same frames, by theirs, are skipped; one that fails does not stop the
    others.

    Args:
        writer: Writer of the results.
        data: Folder of shards, or a split or drive in it.
        out: Folder for the shards of results.
        description: Description of the job for the display of progress.
        workers: Number of workers; 1 on this machine: only this process.
        driver: Kind of workers: processes of this machine, or actors of a Ray cluster.
        shard_index: Index of the part of the shards to process, from 0.
        num_shards: Number of parts, each of which can run on another machine.

    Returns:
        Numbers of shards written and skipped.

    Raises:
        ValueError: `data` are no shards, `out` holds other results, a number is invalid, or a shard
            fails: the error names it after the others are done.
    """
    check_workers(workers, driver)
    shard((), shard_index, num_shards)  # refuses an invalid one before the data are opened
    root, place, manifest = _source(data)
    check_outside_dataset(root, [out])
    frames, frames_per_shard = int(manifest["frames"]), int(manifest["frames_per_shard"])
    shared_tar, *tars = tars_of(root, frames, frames_per_shard)
    place = place or _default_split(tars)
    dataset = _first_readable(writer, tars, place)
    with scratch_folder() as folder:
        claims = writer.claims(data, dataset, folder)
        results = {
            claim.folder.relative_to(folder).as_posix(): dict(claim.settings) for claim in claims
        }
        head = {"format": FORMAT, "data": data_name(root)}
        sizes = {"frames": frames, "frames_per_shard": frames_per_shard}
        settings = head | sizes | {"results": results}
        acquire_output_dir(out, settings, results=("*.tar",), manifest_name=MANIFEST)
        claim_folders(claims)
        shared, *targets = tars_of(out, frames, frames_per_shard)
        pack_files(folder, shared, sorted(files_below(folder)))
    chosen = shard(list(zip(tars, targets, strict=True)), shard_index, num_shards)
    opened = (_quietly_opened(writer, source, place) for source, _ in chosen)
    found = (each for each in opened if each is not None)
    warn_of_missing_files(found, data, writer.parts)
    shared_sha256 = _checksum(shared_tar)
    pending = [
        (source, target, content)
        for source, target in chosen
        if not _is_done(target, content := _content(source, shared_sha256))
    ]
    pose = _common_pose(writer, dataset, tars, place, frames_per_shard) if pending else None
    works = [
        _ShardWork(writer, source, place, target, content, pose)
        for source, target, content in pending
    ]
    notes = run_job(works, workers, description=description, driver=driver, keep_going=True)
    return JobResult(written=len(works), skipped=len(chosen) - len(works), notes=notes)


@dataclass(frozen=True, slots=True)
class _ShardWork:
    """Work item: writes the results of a shard, and packs them."""

    writer: ShardWriter
    source: Path
    place: str
    target: Path
    source_sha256: str | None
    """Digest of the shard of frames and of the files that it shares with others."""
    pose: LidarPose | None
    """Pose of the LiDAR by the frames of all shards; None: of no such data."""

    def __str__(self) -> str:
        return f"shard {self.source.name}"

    def run(self) -> str:
        notes: dict[str, None] = {}
        with scratch_folder() as folder:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # those of the first shard have been shown
                dataset = _open(self.writer, self.source, self.place)
            if isinstance(dataset, PosedDataset) and self.pose is not None:
                dataset.take_pose(self.pose)
            if dataset is not None:
                for work in self.writer.works(dataset, folder):
                    notes[_run_named(work) or ""] = None
            by_frame = sorted(files_below(folder), key=lambda path: (Path(path).stem, path))
            pack_files(folder, self.target, by_frame, source_sha256=self.source_sha256)
        return "; ".join(filter(None, notes))


def _is_done(target: Path, source_sha256: str | None) -> bool:
    """Test whether the results of a shard of frames are whole."""
    return source_sha256 is not None and is_whole(target, source_sha256=source_sha256)


def _content(tar: Path, shared_sha256: str | None) -> str | None:
    """Compute a digest of a shard of frames and its shared files; None: its index is unusable."""
    sha256 = _checksum(tar)
    return sha256 and hashlib.sha256(f"{sha256} {shared_sha256}".encode()).hexdigest()


def _checksum(tar: Path) -> str | None:
    """Read the checksum in the index of a shard; None: it has no index, or a damaged one."""
    try:
        index = read_index(tar)
    except ValueError:  # it is named when its turn comes
        return None
    return None if index is None else index.sha256


def _common_pose(
    writer: ShardWriter, dataset: SampleDataset, tars: Sequence[Path], place: str, num_frames: int
) -> LidarPose | None:
    """Estimate the LiDAR's pose by the frames that a job without shards takes for it.

    Where frames lack a sweep, a job without shards may take others nearby.

    Args:
        writer: Writer of the results.
        dataset: A shard's frames.
        tars: All shards of frames.
        place: Place in them.
        num_frames: Number of frames in each shard but the last.
    """
    if not isinstance(dataset, PosedDataset):
        return None
    opened = cache(partial(_quietly_opened, writer, place=place))
    holding = _holding(tars, place)
    ends = [opened(tar) for tar in (holding[0], holding[-1])]
    first, last = (0 if each is None else len(each) for each in ends)
    count = first if len(holding) == 1 else first + num_frames * (len(holding) - 2) + last
    frames = []
    for number in dataset.pose_places(count):
        position, row = divmod(number - first, num_frames) if number >= first else (-1, number)
        found = opened(holding[1 + position])
        if isinstance(found, PosedDataset):
            near = [*found.frames[row:], *reversed(found.frames[:row])]
            frames += [frame for frame in near if frame.points is not None][:1]
    return dataset.estimate_pose(frames) if frames else None


def _holding(tars: Sequence[Path], place: str) -> Sequence[Path]:
    """Shards with frames in a place, which follow each other, as frames are sorted by their paths.

    All indexes are read only where the first or the last shard has none there.
    """

    def holds(tar: Path) -> bool:
        with suppress(ValueError):  # named when its turn comes
            return (data_path(tar) / place).is_dir()
        return False

    if not place or (holds(tars[0]) and holds(tars[-1])):
        return tars
    return [tar for tar in tars if holds(tar)] or tars


def _quietly_opened(writer: ShardWriter, tar: Path, place: str) -> SampleDataset | None:
    """Open the frames of a shard; None: there are none, or they cannot be read."""
    with suppress(ValueError), warnings.catch_warnings():  # named when its turn comes
        warnings.simplefilter("ignore")
        return _open(writer, tar, place)
    return None


def _run_named(work: Work) -> str | None:
    """Run the work on a frame of a shard, and return its note; an error names the frame.

    Raises:
        ValueError: The frame cannot be read or predicted.
    """
    try:
        return work.run()
    except SetupError:
        raise
    except (ValueError, OSError) as error:
        raise ValueError(f"{work}: {error_text(error)}") from error


def _source(data: Path) -> tuple[Path, str, dict[str, Any]]:
    """Find the folder of shards, the place in it, and its manifest."""
    for root in (data, *data.parents):
        manifest = read_manifest(root)
        if manifest is not None and not _is_below_tar(data.relative_to(root)):
            place = data.relative_to(root).as_posix()
            return root, "" if place == "." else place, manifest
    raise FileError(
        data,
        "is no folder of shards",
        "pack the data by `sightline shard` first, or leave --pack out",
    )


def _is_below_tar(place: Path) -> bool:
    return any(part.endswith(".tar") for part in place.parts[:1])


def _default_split(tars: Sequence[Path]) -> str:
    """Split that an object tree opens by default; empty: other data."""
    for tar in reversed(tars):  # frames are sorted: training is among the last, if there is one
        try:
            tree = data_path(tar)
        except ValueError:  # it is named when its turn comes
            continue
        return next((split for split in KITTI_SPLITS if (tree / split).is_dir()), "")
    return ""


def _open(writer: ShardWriter, tar: Path, place: str) -> SampleDataset | None:
    """Open the frames of a shard in a place; None: it has none there."""
    if url_of(tar) is None and not tar.is_file():
        raise FileError(tar, "is missing, or no regular file", SHARD_REMEDY)
    path = data_path(tar) / place
    if place and path.parent.is_dir() and not path.is_dir():
        return None
    try:
        return writer.open(path)
    except GapsError as error:
        raise GapsError(error.problem, _WITHOUT_GAPS) from error


def _first_readable(writer: ShardWriter, tars: Sequence[Path], place: str) -> SampleDataset:
    """Open the first shard that has frames and can be read."""
    fault: ValueError | None = None
    for tar in tars:
        try:
            dataset = _open(writer, tar, place)
        except ValueError as error:
            fault = fault or error
            continue
        if dataset is None:
            continue
        if not place and isinstance(dataset, KittiDepthDataset) and dataset.split in _DRIVE_SPLITS:
            raise FileError(
                tars[0].parent, "may hold several splits", "name one, such as SHARDS/val"
            )
        return dataset
    raise fault or FileError(tars[0].parent / place, "holds no frames", "name another folder")
