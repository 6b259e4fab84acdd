"""`sightline shard` and `unshard`: data sets in tars, and back."""

from pathlib import Path
from typing import TYPE_CHECKING

from sightline.cli.output import say, warn
from sightline.files.problem import shown_place
from sightline.jobs.output_dirs import check_outputs

if TYPE_CHECKING:
    from sightline.data.sharding import ShardReport


def shard(
    data: Path,
    out: Path,
    *,
    frames_per_shard: int = 1000,
    compress: bool = False,
    workers: int = 2,
) -> int:
    """Pack a data set into shards: tars in webdataset's layout, which all commands read.

    To resume an interrupted run, or after a shard has failed, run it again: shards that are whole
    are skipped. Exit status: 0 if all shards are whole, else 1.

    Args:
        data: A recording, or a KITTI object tree, depth completion tree or raw drive.
        out: Folder for the shards.
        frames_per_shard: Number of frames in a shard.
        compress: Packs sweeps, labels and other files but pictures by gzip.
        workers: Number of threads.
    """
    check_outputs({"OUT": out}, data=[data])
    from sightline.data.sharding import write_shards

    if not data.is_dir():
        raise ValueError(f"{shown_place(data)} is no folder; give the folder of a data set")
    report = write_shards(
        data, out, frames_per_shard=frames_per_shard, compress=compress, workers=workers
    )
    return _deliver(out, report)


def unshard(shards: Path, out: Path, *, workers: int = 2) -> int:
    """Unpack shards to the data set that they were packed from.

    To resume an interrupted run, or after a shard has failed, run it again: files that are there
    are kept. Exit status: 0 if all shards are unpacked, else 1.

    Args:
        shards: Folder that `sightline shard` wrote.
        out: Folder for the data set.
        workers: Number of threads.
    """
    check_outputs({"OUT": out}, data=[shards])
    from sightline.data.sharding import unpack_shards

    return _deliver(out, unpack_shards(shards, out, workers=workers))


def _deliver(out: Path, report: "ShardReport") -> int:
    for fault in report.faults:
        warn(fault)
    say(f"{out}: shards: {report}")
    return int(bool(report.faults))
