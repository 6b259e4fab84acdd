"""Job that runs a first stage over a data set and saves its output."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from sightline.data.object_tree import Part, Velodyne
from sightline.data.open import SampleDataset, open_dataset
from sightline.detection3d.network_task import NETWORK_TASK
from sightline.detection3d.predictor import network_sweep
from sightline.detection3d.proposal_cache import (
    FORMAT,
    SUFFIX,
    first_stage_identity,
    read_record,
    write_record,
)
from sightline.detection3d.runners import StageRunners
from sightline.detection3d.sweeps import at_kitti_height
from sightline.inference.network import load_network
from sightline.jobs.output_dirs import acquire_output_dir, check_outside_dataset
from sightline.jobs.run import JobResult, check_workers, run_job, shard


def cache_proposals(
    data: Path,
    out: Path,
    *,
    weights: str | Path,
    device: str = "cpu",
    sample_list: str | Path | Sequence[str] | None = None,
    velodyne: Velodyne | None = None,
    workers: int = 2,
    overwrite: bool = False,
    shard_index: int = 0,
    num_shards: int = 1,
) -> JobResult:
    """Save a first stage's points, features and proposals; see `proposal_cache`.

    Files are written atomically, and frames with existing files are skipped, so running a stopped
    job again finishes it.

    Args:
        data: Folder of the data set; see `open_dataset`.
        out: Folder of the cache; made where it is missing.
        weights: Name or file of a detector's weights. Its second stage, if any, is not used.
        device: Device for PyTorch.
        sample_list: Which samples; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder in an object tree. None: velodyne, or else velodyne_reduced.
        workers: Number of processes; 1 is this process alone.
        overwrite: Whether to replace existing files.
        shard_index: Which part of the samples to do, from 0.
        num_shards: Number of parts.

    Raises:
        ValueError: The data or the weights cannot be read, or the folder holds the output of
            another first stage, or its first existing file was made from another sweep.
    """
    check_workers(workers)
    shard((), shard_index, num_shards)  # checks the shard before the data is opened
    check_outside_dataset(data, [out])
    loaded = load_network(NETWORK_TASK, weights)
    identity = first_stage_identity(loaded.network)
    parts: tuple[Part, ...] = ("points",)
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne, parts=parts)
    settings = {
        "task": NETWORK_TASK.name,
        "output": "proposal cache",
        "format": FORMAT,
        "first_stage": identity,
        "sightline": version("sightline"),
    }
    acquire_output_dir(out, settings, results=(f"*{SUFFIX}",))
    there = set() if overwrite else {path.stem for path in out.glob(f"*{SUFFIX}")}
    indices = shard(range(len(dataset)), shard_index, num_shards)
    done = [index for index in indices if dataset.sample_ids[index] in there]
    if done:
        read_record(out, dataset[done[0]], training=False)  # raises for a cache of another data set
    pending = [index for index in indices if dataset.sample_ids[index] not in there]
    stages = StageRunners(loaded, device=device, threads=1)  # threads of each worker
    works = [_FrameWork(dataset, index, stages, identity, out) for index in pending]
    run_job(works, workers, description=f"proposals by {loaded.name}")
    return JobResult(written=len(pending), skipped=len(done))


@dataclass(frozen=True, slots=True)
class _FrameWork:
    """Runs the first stage on a frame and writes its file."""

    dataset: SampleDataset
    index: int
    stages: StageRunners
    identity: str
    out: Path

    def __str__(self) -> str:
        return f"sample {self.dataset.sample_ids[self.index]}"

    def run(self) -> None:
        sample = self.dataset[self.index]
        points = network_sweep(at_kitti_height(sample), self.stages.detector.config.input)
        proposed, training_proposed = self.stages.propose_both(points)
        features = proposed.features
        if features is None:  # a sweep without points, or a stage without features
            features = points.new_zeros(len(points), self.stages.detector.first.feature_channels)
        write_record(
            self.out,
            sample,
            made_by=self.identity,
            points=points,
            features=features,
            proposed=proposed,
            training_proposed=training_proposed,
        )
