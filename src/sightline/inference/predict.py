"""Prediction of a whole data set to files for each sample, resumable and in parallel."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from sightline.data.datasets.newer_frames import (
    ADD_OVERWRITE,
    warn_of_gone_frames,
    warn_of_newer_frames,
)
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.datasets.sample_files import (
    SENSOR_NOUNS,
    dataset_title,
    has_file,
    sweeps_folder,
    warn_of_missing_sensors,
)
from sightline.data.formats.pixels import is_in_view
from sightline.data.layouts.kitti_trees import Part, Velodyne
from sightline.data.open import open_dataset
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments
from sightline.inference.packed import pack_results
from sightline.inference.predictor import (
    Output,
    PredictingTask,
    Predictor,
    check_predictor,
    warn_of_unversioned,
)
from sightline.jobs.crew import Driver
from sightline.jobs.output_dirs import (
    Claim,
    check_outside_dataset,
    claim_folders,
    finished_names,
)
from sightline.jobs.run import LEAVE_OUT, JobResult, check_workers, run_job, shard
from sightline.structures.sample import CameraLidarSample

Places = tuple[tuple[Output, Path], ...]
"""Outputs to write, each with its folder."""

_LACKS: Final = ".lacks"
"""Hidden folder beside the files of the first output: an empty file NAME.PART for each part that
the predictor uses and the sample did not have."""


@named_arguments
def predict(
    task: PredictingTask,
    predictor: Predictor,
    data: Path,
    out: Path,
    *,
    also: Mapping[str, Path] | None = None,
    switches: Collection[str] = (),
    sample_list: str | Path | Sequence[str] | None = None,
    velodyne: Velodyne | None = None,
    workers: int = 2,
    driver: Driver = "local",
    overwrite: bool = False,
    shard_index: int = 0,
    num_shards: int = 1,
    around: bool | None = None,
    remedy: str = ADD_OVERWRITE,
) -> JobResult:
    """Predict every sample of a recording or of one of KITTI's trees, and write files.

    Files are written atomically, and samples with existing files are skipped: to resume a stopped
    job, run it again. Each folder's sightline.json records the predictor and the data of the files;
    a folder never mixes two predictors or two data sets.

    Args:
        task: Task that defines the files.
        predictor: Predictor of the task.
        data: Folder of the data set; see `open_dataset`.
        out: Folder for the task's first output; created if missing.
        also: Folders for further outputs, by name.
        switches: Names of the task's switches that are on.
        sample_list: List of the samples; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder in an object tree. None: velodyne, or else velodyne_reduced.
        workers: Number of workers; 1 on this machine: only this process.
        driver: Kind of workers: processes of this machine, or actors of a Ray cluster.
        overwrite: Whether to replace existing files.
        shard_index: Index of the shard to process, from 0.
        num_shards: Number of shards; shards can run on different machines at the same time.
        around: Whether 3D detection searches whole turns of the LiDAR. None: as the samples say.
        remedy: What to do about kept files that are older than their samples.

    Raises:
        ValueError: The data cannot be read, a folder lies in them, contains other results or cannot
            be written to, the predictor lacks an output, there is no such switch, or the numbers of
            workers and shards are invalid. Errors about a sample name it; finished samples stay.
    """
    check_predictor(predictor)
    check_workers(workers, driver)
    shard((), shard_index, num_shards)  # refuses an invalid one before the data are opened
    places = output_places(task, predictor, out, also or {})
    check_outside_dataset(data, [folder for _, folder in places])
    changes = _changes(task, switches)
    dataset = open_dataset(
        data,
        sample_list=sample_list,
        velodyne=velodyne,
        parts=predictor.parts,
        needs=predictor.needs,
    )
    writes_maps = task.outputs[0].suffix == ".png"  # depth is completed from sparse maps
    warn_of_missing_sensors(dataset, data, predictor.parts, needs_sweeps=not writes_maps)
    indices = shard(range(len(dataset)), shard_index, num_shards)
    names = dataset.sample_ids
    finished = predicted_samples(places)
    present = finished - _completed_samples(dataset, places)
    pending = [index for index in indices if overwrite or names[index] not in present]
    title, sweeps = dataset_title(dataset, data), sweeps_folder(dataset)
    chosen = {**dict.fromkeys(changes, True), **around_entry(around=around)}
    claim_folders(output_claims(task, predictor, places, title, sweeps, chosen=chosen))
    kept = (
        (index, result_files(places, names[index]))
        for index in indices
        if not overwrite and names[index] in present
    )
    warn_of_newer_frames(dataset, kept, parts=predictor.parts, remedy=remedy)
    skipped = len(indices) - len(pending)
    warn_of_unversioned([predictor], skipped, remedy=remedy)
    warn_of_gone_frames(dataset, out, finished)
    works = [
        _SampleWork(
            dataset, index, names[index], predictor, tuple(changes.values()), places, around
        )
        for index in pending
    ]
    description = f"{task.name} by {predictor.name}"
    notes = run_job(works, workers, description=description, leave_out=LEAVE_OUT, driver=driver)
    return JobResult(written=len(pending), skipped=skipped, notes=notes)


@named_arguments
def predict_shards(
    task: PredictingTask,
    predictor: Predictor,
    data: Path,
    out: Path,
    *,
    switches: Collection[str] = (),
    velodyne: Velodyne | None = None,
    workers: int = 2,
    driver: Driver = "local",
    shard_index: int = 0,
    num_shards: int = 1,
    around: bool | None = None,
) -> JobResult:
    """Predict every sample of a folder of shards, and pack the files of each shard into one.

    The arguments are those of `predict`; see `pack_results` for `out` and the errors.
    """
    check_predictor(predictor)
    changes = _changes(task, switches)
    writer = _ShardWriter(task, predictor, tuple(changes.items()), velodyne, around)
    return pack_results(
        writer,
        data,
        out,
        description=f"shards: {task.name} by {predictor.name}",
        workers=workers,
        driver=driver,
        shard_index=shard_index,
        num_shards=num_shards,
    )


@dataclass(frozen=True, slots=True)
class _ShardWriter:
    """Writer of a task's first output."""

    task: PredictingTask
    predictor: Predictor
    changes: tuple[tuple[str, Callable[[Any], Any]], ...]
    velodyne: Velodyne | None
    around: bool | None

    @property
    def parts(self) -> Collection[Part]:
        return self.predictor.parts

    def open(self, data: Path) -> SampleDataset:
        parts, needs = self.predictor.parts, self.predictor.needs
        return open_dataset(data, velodyne=self.velodyne, parts=parts, needs=needs)

    def claims(self, data: Path, dataset: SampleDataset, folder: Path) -> list[Claim]:
        places = ((self.task.outputs[0], folder),)
        title, sweeps = dataset_title(dataset, data), sweeps_folder(dataset)
        chosen = {**{name: True for name, _ in self.changes}, **around_entry(around=self.around)}
        return output_claims(self.task, self.predictor, places, title, sweeps, chosen=chosen)

    def works(self, dataset: SampleDataset, folder: Path) -> "list[_SampleWork]":
        places, changes = ((self.task.outputs[0], folder),), tuple(each for _, each in self.changes)
        return [
            _SampleWork(dataset, index, name, self.predictor, changes, places, self.around)
            for index, name in enumerate(dataset.sample_ids)
        ]


@dataclass(frozen=True, slots=True)
class _SampleWork:
    """Work item: predicts a sample and writes its files."""

    dataset: SampleDataset
    index: int
    name: str
    predictor: Predictor
    changes: tuple[Callable[[Any], Any], ...]
    places: Places
    around: bool | None

    def __str__(self) -> str:
        return f"sample {self.name}"

    def run(self) -> str:
        sample = read_sample(self.dataset, self.index, around=self.around)
        prediction = self.predictor(sample)
        for change in self.changes:
            prediction = change(prediction)
        return write_prediction(self.places, sample, prediction, self.predictor.parts)


def read_sample(dataset: SampleDataset, index: int, *, around: bool | None) -> CameraLidarSample:
    """Read a frame to predict, and set whether its whole turn is searched; None: as it is.

    Warns if the image shows no point of its cloud: a calibration or cloud of this frame alone is
    not among the few frames that are checked when the data set is opened.
    """
    sample = dataset[index]
    if sample.points is not None and len(sample.points):
        points, matrix = sample.points.numpy(), sample.calibration.image_from_lidar.numpy()
        if not is_in_view(points, matrix, sample.image_size).any():
            warn_user(
                f"sample {sample.sample_id}: none of its {len(points):,} points falls into the "
                "image; check its calibration and point cloud by `sightline check`",
            )
    return sample if around is None else replace(sample, all_around=around)


def around_entry(*, around: bool | None) -> dict[str, bool]:
    """Entry of a manifest for a chosen field of 3D detection."""
    return {} if around is None else {"around": around}


def _changes(task: PredictingTask, switches: Collection[str]) -> dict[str, Callable[[Any], Any]]:
    """Changes of the prediction by active switches, by name, in the task's order."""
    by_name = {switch.name: switch.change for switch in task.switches}
    for name in switches:
        if name not in by_name:
            known = ", ".join(by_name) or "none"
            raise ValueError(f"{task.name} has no switch {name}; it has {known}")
    return {name: change for name, change in by_name.items() if name in switches}


def output_places(
    task: PredictingTask, predictor: Predictor, out: Path, also: Mapping[str, Path]
) -> Places:
    """Assign a folder to each requested output.

    Raises:
        ValueError: The task or the predictor has no such output, or two would share a folder.
    """
    by_name = {output.name: output for output in task.outputs}
    first = task.outputs[0]
    places = [(first, out)]
    for name, folder in also.items():
        if name not in by_name or name == first.name:
            others = ", ".join(output.name for output in task.outputs[1:]) or "none"
            raise ValueError(f"{task.name} has no further output {name}; it has {others}")
        if name not in predictor.gives:
            raise ValueError(
                f"{predictor.name} gives no {name} to write to {folder}; give weights of a "
                f"network that does, or leave the {name} out"
            )
        places.append((by_name[name], folder))
    taken: dict[Path, Output] = {}
    for output, folder in places:
        other = taken.setdefault(folder.resolve(), output)
        if other is not output:
            raise ValueError(
                f"{folder} cannot hold both {other.name} and {output.name}, whose files have the "
                "same names; give another folder for one of them"
            )
    return tuple(places)


def output_claims(
    task: PredictingTask,
    predictor: Predictor,
    places: Places,
    title: str,
    velodyne: Velodyne,
    *,
    chosen: Mapping[str, object] | None = None,
) -> list[Claim]:
    """Create the claims on the output folders for predictor, data's title and chosen options."""
    made_from = {"data": title, "velodyne": velodyne}
    made_by = {
        "sightline": version("sightline"),
        **predictor.made_by,
        **(chosen or {}),
    }
    claims = []
    for output, folder in places:
        identity = {"task": task.name, "output": output.name, "method": predictor.name}
        settings = identity | made_from | made_by
        claims.append(Claim(folder=folder, settings=settings, results=(f"*{output.suffix}",)))
    return claims


def write_prediction(
    places: Places, sample: CameraLidarSample, prediction: object, parts: Collection[str]
) -> str:
    """Write the files of one prediction, and return the remark on it; empty: none.

    Args:
        places: Outputs with their folders.
        sample: The sample.
        prediction: Its prediction.
        parts: Parts that the predictor uses; those that the sample lacks are noted, so that the
            files are made again once the data have them.

    Raises:
        ValueError: The writer of an output leaves no file of the given name.
    """
    notes = {part: places[0][1] / _LACKS / f"{sample.sample_id}.{part}" for part in SENSOR_NOUNS}
    lacking = [part for part in notes if part in parts and getattr(sample, part) is None]
    for part in lacking:
        notes[part].parent.mkdir(parents=True, exist_ok=True)
        notes[part].touch()
    for output, folder in places:
        path = folder / f"{sample.sample_id}{output.suffix}"
        output.write(path, sample, prediction)
        if not path.is_file():
            raise ValueError(
                f"the writer of the output {output.name} wrote no {path.name}; write exactly the "
                "given file (np.save, for one, adds .npy to other suffixes)"
            )
    for part in notes.keys() - lacking:
        notes[part].unlink(missing_ok=True)
    remarks = (output.remark(prediction) for output, _ in places if output.remark is not None)
    return "; ".join(filter(None, remarks))


def result_files(places: Places, name: str) -> list[Path]:
    """Files of a sample's prediction."""
    return [folder / f"{name}{output.suffix}" for output, folder in places]


def _completed_samples(dataset: SampleDataset, places: Places) -> set[str]:
    """Names of the samples whose files were made without a part that the data now have."""
    noted = {path.name for path in (places[0][1] / _LACKS).glob("*")}
    return {
        name
        for index, name in enumerate(dataset.sample_ids if noted else ())
        for part in SENSOR_NOUNS
        if f"{name}.{part}" in noted and has_file(dataset, index, part)
    }


def predicted_samples(places: Places) -> set[str]:
    """Names of the samples with all files."""
    return set.intersection(
        *(set(finished_names(folder, output.suffix)) for output, folder in places)
    )
