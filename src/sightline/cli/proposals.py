"""`sightline proposals`: write outputs of a first stage, to train the second or to be scored."""

from pathlib import Path
from typing import Any

from sightline.cli.output import say
from sightline.cli.parser import Device
from sightline.cli.report import named_file
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.jobs.output_dirs import check_outputs


def proposals(
    data: Path,
    out: Path,
    *,
    weights: str,
    as_results: bool = False,
    device: Device = "cpu",
    sample_list: str | None = None,
    velodyne: Velodyne | None = None,
    workers: int = 2,
    overwrite: bool = False,
    shard_index: int = 0,
    num_shards: int = 1,
) -> None:
    """Write the first stage's proposals: a cache for training the second stage, or result files.

    `sightline fit` reads the cache, which also holds points and their features, from the folder of
    --data.init_args.preparation.init_args.cache; `sightline evaluate proposals` scores result
    files. Files are written atomically; to resume an interrupted run, run it again.

    Args:
        data: A KITTI object tree.
        out: Folder for the cache, with one file per frame of 4 to 8 MB at 16,384 points, or for the
            result files.
        weights: Weights of a 3D detector, whose first stage is run: name of weights in Sightline or
            a file (.safetensors, .ckpt).
        as_results: Writes KITTI's result files instead of the cache: the proposals for inference
            that lie in the image, without refinement or suppression.
        device: Device of the network in PyTorch.
        sample_list: List of frames: kitti-object-train, kitti-object-val, a list in ImageSets or
            a text file with one name per line. Default: all.
        velodyne: Folder of the sweeps. Default: velodyne, or else velodyne_reduced.
        workers: Number of processes with one thread each.
        overwrite: Replaces existing files.
        shard_index: Index of the shard of frames to process, from 0.
        num_shards: Number of shards, each of which can run on another machine.
    """
    only_read = [data, named_file(weights), named_file(sample_list)]
    check_outputs({"OUT": out}, data=only_read)
    settings: dict[str, Any] = {
        "sample_list": sample_list,
        "velodyne": velodyne,
        "workers": workers,
        "overwrite": overwrite,
        "shard_index": shard_index,
        "num_shards": num_shards,
    }
    if as_results:
        from sightline.detection3d.predictor import ProposalPredictor
        from sightline.detection3d.registration import TASK
        from sightline.inference.predict import predict

        predictor = ProposalPredictor.load(weights, device=device, threads=1)
        result = predict(TASK, predictor, data, out, **settings)
    else:
        from sightline.detection3d.proposal_cache import cache_proposals

        result = cache_proposals(data, out, weights=weights, device=device, **settings)
    say(f"{out}: proposals of frames: {result}")
