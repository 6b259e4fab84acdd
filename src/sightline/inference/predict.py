"""Runs a task over a whole data set: files out for each sample, resumable and in parallel."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sightline.data.jobs import (
    Claim,
    JobResult,
    check_apart,
    check_workers,
    claim_folders,
    data_name,
    run_job,
    shard,
)
from sightline.data.object_tree import Velodyne
from sightline.data.open import SampleDataset, open_dataset, sweeps_folder
from sightline.inference.predictor import AnsweringTask, Output, Predictor
from sightline.structures.sample import CameraLidarSample

Places = tuple[tuple[Output, Path], ...]
"""What is written of each answer, and into which folder."""


def predict(
    task: AnsweringTask,
    predictor: Predictor,
    data: Path,
    out: Path,
    *,
    also: Mapping[str, Path] | None = None,
    switches: Collection[str] = (),
    sample_list: str | Path | Sequence[str] | None = None,
    velodyne: Velodyne | None = None,
    workers: int = 2,
    overwrite: bool = False,
    shard_index: int = 0,
    num_shards: int = 1,
) -> JobResult:
    """Answers every sample of a recording or of one of KITTI's trees, and writes files.

    A file appears whole or not at all, and samples whose files are there are skipped, so a job
    that was stopped goes on where it was: run it again. Each folder's sightline.json says what made
    the files, and from which data; those of two makers, or of two data sets, never share one.

    Args:
        task: Says which files there are.
        predictor: Answers; the task's own.
        data: Folder of the data set; see `open_dataset`.
        out: Folder for the task's first output; made where it is missing.
        also: Folders for further outputs, by name.
        switches: Names of those of the task's switches that are on.
        sample_list: Which samples; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder in an object tree. None: velodyne, or else velodyne_reduced.
        workers: Processes that work; 1 is this process alone.
        overwrite: Whether to make files anew that are there already.
        shard_index: Which part of the samples to do, from 0.
        num_shards: Number of parts; each part can be done on another machine, at the same time.

    Raises:
        ValueError: The data cannot be read, a folder lies in them, holds what something else made
            or cannot be written to, the predictor does not give an output, there is no such switch,
            or the numbers of workers and shards make no sense. Errors about a sample name it;
            samples done before stay done.
    """
    check_workers(workers)
    shard((), shard_index, num_shards)  # refuses a wrong one before the data is opened
    places = output_places(task, predictor, out, also or {})
    check_apart(data, [folder for _, folder in places])
    changes = _changes(task, switches)
    dataset = open_dataset(
        data,
        sample_list=sample_list,
        velodyne=velodyne,
        parts=predictor.parts,
        needs=predictor.needs,
    )
    indices = shard(range(len(dataset)), shard_index, num_shards)
    names = dataset.sample_ids
    present = answered_samples(places)
    pending = [index for index in indices if overwrite or names[index] not in present]
    sweeps = sweeps_folder(dataset)
    claim_folders(claims_of(task, predictor, places, data, sweeps, switches=changes))
    works = [
        _SampleWork(dataset, index, names[index], predictor, tuple(changes.values()), places)
        for index in pending
    ]
    run_job(works, workers, description=f"{task.name} by {predictor.name}")
    return JobResult(written=len(pending), skipped=len(indices) - len(pending))


@dataclass(frozen=True, slots=True)
class _SampleWork:
    """Answers a sample and writes its files."""

    dataset: SampleDataset
    index: int
    name: str
    predictor: Predictor
    changes: tuple[Callable[[Any], Any], ...]
    places: Places

    def __str__(self) -> str:
        return f"sample {self.name}"

    def run(self) -> None:
        sample = self.dataset[self.index]
        answer = self.predictor(sample)
        for change in self.changes:
            answer = change(answer)
        write_answer(self.places, sample, answer)


def _changes(task: AnsweringTask, switches: Collection[str]) -> dict[str, Callable[[Any], Any]]:
    """What the switches that are on do to an answer, by their names, in the task's order."""
    by_name = {switch.name: switch.change for switch in task.switches}
    for name in switches:
        if name not in by_name:
            known = ", ".join(by_name) or "none"
            raise ValueError(f"{task.name} has no switch {name}; it has {known}")
    return {name: change for name, change in by_name.items() if name in switches}


def output_places(
    task: AnsweringTask, predictor: Predictor, out: Path, also: Mapping[str, Path]
) -> Places:
    """Each output that is asked for with its folder.

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
                f"{predictor.name} gives no {name} to write to {folder}; name weights of a network "
                f"that does, or leave the {name} out"
            )
        places.append((by_name[name], folder))
    taken: dict[Path, Output] = {}
    for output, folder in places:
        other = taken.setdefault(folder.resolve(), output)
        if other is not output:
            raise ValueError(
                f"{folder} cannot hold both {other.name} and {output.name}, whose files have the "
                "same names; name another folder for one of them"
            )
    return tuple(places)


def claims_of(
    task: AnsweringTask,
    predictor: Predictor,
    places: Places,
    data: Path,
    velodyne: Velodyne,
    *,
    switches: Collection[str] = (),
) -> list[Claim]:
    """For each folder what says that the predictor makes its files of the data, and how."""
    made_from = {"data": data_name(data), "velodyne": velodyne}
    made_by = {
        "sightline": version("sightline"),
        **predictor.made_by,
        **dict.fromkeys(switches, True),
    }
    claims = []
    for output, folder in places:
        what = {"task": task.name, "output": output.name, "method": predictor.name}
        settings = what | made_from | made_by
        claims.append(Claim(folder=folder, settings=settings, results=(f"*{output.suffix}",)))
    return claims


def write_answer(places: Places, sample: CameraLidarSample, answer: object) -> None:
    """Writes the files of one answer."""
    for output, folder in places:
        output.write(folder / f"{sample.sample_id}{output.suffix}", sample, answer)


def answered_samples(places: Places) -> set[str]:
    """Names of the samples all of whose files are there."""
    return set.intersection(
        *({path.stem for path in folder.glob(f"*{output.suffix}")} for output, folder in places)
    )
