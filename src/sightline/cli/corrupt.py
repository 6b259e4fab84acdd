"""`sightline corrupt`: simulate sensor faults on a data set."""

from pathlib import Path

from sightline.cli.output import say
from sightline.cli.report import named_file
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.jobs.crew import Driver
from sightline.jobs.output_dirs import check_outputs


def corrupt(
    data: Path,
    out: Path,
    *,
    suite: str = "dgfn7",
    seed: int = 0,
    cases: tuple[str, ...] | None = None,
    sample_list: str | None = None,
    velodyne: Velodyne | None = None,
    masks: bool = False,
    workers: int = 2,
    driver: Driver = "local",
    shard_index: int = 0,
    num_shards: int = 1,
) -> None:
    """Corrupt the sensors of a data set: write a KITTI object tree for each case of a suite.

    OUT/CASE is valid data for every other command. The same settings give the same files for any
    number of workers; to resume an interrupted run, run it again. Unchanged files of a case become
    hard links to those of DATA, which is never changed.

    Args:
        data: A KITTI object tree.
        out: Folder for the cases, not within DATA.
        suite: Set of cases: dgfn7, the seven of Kim et al. 2018; dgfn7-figure, with noise as in
            their picture; core, some twenty kinds at five severities (lidar_fog-3); all, every
            kind; or a single kind, or several together (camera_fog+lidar_fog).
        seed: Seed of the random boxes, discs and noise.
        cases: Cases of the suite to write; a kind (lidar_fog) selects its five. Default: all.
        sample_list: List of frames: kitti-object-train, kitti-object-val, a list in ImageSets or
            a text file with one name per line. Default: all.
        velodyne: Folder of the sweeps. Default: velodyne, or else velodyne_reduced.
        masks: Also writes masks of the pixels of each sensor that may have changed.
        workers: Number of processes.
        driver: Kind of workers: processes of this machine (local), or of a Ray cluster (ray),
            one CPU each, by pip install '.[ray]'; docs/guides/scale.md tells how.
        shard_index: Index of the shard of frames to process, from 0.
        num_shards: Number of shards, each of which can run on another machine.
    """
    check_outputs({"OUT": out}, data=[data, named_file(sample_list)])
    from sightline.corruptions.generate import corrupt_dataset

    result = corrupt_dataset(
        data,
        out,
        suite=suite,
        seed=seed,
        cases=cases,
        sample_list=sample_list,
        velodyne=velodyne,
        masks=masks,
        workers=workers,
        driver=driver,
        shard_index=shard_index,
        num_shards=num_shards,
    )
    say(f"{out}: frames of suite {suite}: {result}")
