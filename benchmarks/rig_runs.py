"""Runs of networks over the frames of a rig, kept in a folder: results, times, memory."""

import json
import multiprocessing
import time
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, TypedDict

import numpy as np
import torch

from benchmarks.record import digest
from sightline.data.layouts.kitti_trees import Part
from sightline.data.open import open_dataset
from sightline.evaluation.held_out_frame import dense_truth_in_reach
from sightline.export.names import EngineName
from sightline.files.atomic import atomic_write_text
from sightline.files.weights_header import find_weights
from sightline.jobs.progress import track
from sightline.structures.predictions import DepthMap
from sightline.structures.sample import CameraLidarSample
from sightline.tasks import choose_task, find_task

DEPTH: Final = "depth-completion"
_STATUS: Final = Path("/proc/self/status")
_KIB_PER_MIB: Final = 1024


class Network(NamedTuple):
    """A network, or a method without training."""

    name: str
    """Name in the tables."""
    weights: str
    """Name or file of weights, or name of a method."""
    task: str
    is_method: bool

    def folder(self, cache: Path) -> Path:
        """Folder of the network's results: the method's, or by the content of the weights."""
        return cache / (self.weights if self.is_method else digest(find_weights(self.weights))[:16])


class FrameSet(NamedTuple):
    """Frames that are scored together."""

    name: str
    group: str
    """Name of their data set among the results."""
    data: Path
    labels: Path
    frames: tuple[str, ...]
    difficulty: Literal["moderate", "hard"] = "moderate"
    has_depth: bool = False
    """Whether frames have dense true depth."""


class Run(TypedDict):
    """Time, memory and scores of depth of a network over a set of frames."""

    ms: dict[str, float]
    """Processor time of each frame."""
    peak_mib: float | None
    """Peak memory of the whole process; None where the system does not report it."""
    depth: dict[str, dict[str, float]]
    """Scores of each frame; empty for detectors."""


def named_network(text: str) -> Network:
    """Read NAME=WEIGHTS.

    Raises:
        ValueError: There is no name, or there are no such weights.
    """
    name, _, weights = text.partition("=")
    if not name or not weights:
        raise ValueError(f"--networks {text}: give NAME=WEIGHTS, e.g. best=detection2d-best")
    if weights in find_task(DEPTH).methods:
        return Network(name, weights, DEPTH, is_method=True)
    return Network(name, weights, choose_task(None, weights).name, is_method=False)


def run_network(network: Network, frames: FrameSet, cache: Path, engine: EngineName) -> Run:
    """Run a network over a set in a process of its own, or read the results of an earlier run."""
    path = network.folder(cache) / f"{frames.group}-{frames.name}-{len(frames.frames)}.json"
    if not path.is_file():
        context = multiprocessing.get_context("forkserver")  # so that memory is its own
        context.set_forkserver_preload([__name__])
        with context.Pool(1) as pool:
            run = pool.apply(_run, (network, frames, network.folder(cache), engine))
        atomic_write_text(path, json.dumps(run))
    kept: Run = json.loads(path.read_text())
    return kept


def _run(network: Network, frames: FrameSet, folder: Path, engine: EngineName) -> Run:
    torch.set_num_threads(1)
    task = find_task(network.task)
    chosen: dict[str, Any] = {"method" if network.is_method else "weights": network.weights}
    predictor = task.predictor(**chosen, engine=engine, threads=1)
    parts: tuple[Part, ...] = ("image", "points")
    if frames.has_depth and network.task == DEPTH:
        parts = (*parts, "depth")
    dataset = open_dataset(frames.data, sample_list=frames.frames, parts=parts)
    predictor(dataset[0])  # starts the engine for images of this size
    run = Run(ms={}, peak_mib=None, depth={})
    for index in track(range(len(dataset)), description=f"{network.name}, {frames.name}"):
        sample = dataset[index]
        start = time.process_time()
        found = predictor(sample)
        run["ms"][sample.sample_id] = 1000 * (time.process_time() - start)
        if network.task == DEPTH:
            run["depth"][sample.sample_id] = score_depth(sample, found)
        else:
            path = folder / frames.group / f"{sample.sample_id}.txt"
            task.outputs[0].write(path, sample, found)
    run["peak_mib"] = _peak_mib()
    return run


def score_depth(sample: CameraLidarSample, found: DepthMap) -> dict[str, float]:
    """Score a map by the dense truth in reach; pixels without a depth count as 0 m."""
    truth_m = dense_truth_in_reach(sample).numpy()
    is_scored = truth_m > 0
    depth_m = found.depth_m.numpy()[is_scored].astype(np.float64)
    error_mm = 1e3 * np.abs(depth_m - truth_m[is_scored])
    return {
        "rmse_mm": float(np.sqrt(np.mean(error_mm**2))),
        "mae_mm": float(error_mm.mean()),
        "median_mm": float(np.median(error_mm)),
        "coverage": float((depth_m > 0).mean()),
    }


def _peak_mib() -> float | None:
    """Peak resident memory of this process; Linux only."""
    if not _STATUS.is_file():
        return None
    for line in _STATUS.read_text().splitlines():
        if line.startswith("VmHWM:"):
            return round(int(line.split()[1]) / _KIB_PER_MIB, 1)
    return None
