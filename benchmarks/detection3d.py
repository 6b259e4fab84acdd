"""Time of 3D detection on 64 beams: `python -m benchmarks.detection3d`.

From a frame's sweep to its detections, searches, pooling and suppression included: the published
network of two stages at full size and ours, on each requested engine. Each row is measured in a
process of its own, one after the other, in one run.
The last line is kept in benchmarks/results/detection3d.json.

Networks that do not come with the package have random weights. Those of points propose as many
boxes as trained ones, those of pillars hardly any, so that nothing is left to refine: "proposals"
is their number.
"""

import multiprocessing
import tempfile
from pathlib import Path
from typing import Any

import jsonargparse
import torch

from benchmarks.latency import count_cost, measure_latency
from benchmarks.record import print_record
from benchmarks.untrained import shipped_or_untrained
from sightline.data.open import open_dataset
from sightline.detection3d.export_graph import export_graphs
from sightline.detection3d.network_task import NETWORK_TASK
from sightline.detection3d.predictor import StageRunners
from sightline.detection3d.sweeps import network_sweep
from sightline.export.names import EngineName
from sightline.files.weights_header import shipped_names
from sightline.inference.network import load_network
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.predictions import Detections3D

FULL_SIZE = "detection3d-baseline-kitti"
_NETWORKS = (FULL_SIZE, "detection3d-points-street", "detection3d-best", "detection3d-fast-cpu")


def main(
    networks: tuple[str, ...] = _NETWORKS,
    engines: tuple[EngineName, ...] = ("torch", "onnxruntime", "openvino"),
    threads: int = 2,
    repeats: int = 20,
    full_size_repeats: int = 5,
) -> None:
    """Print a table, then one line of JSON.

    Args:
        networks: Names of recipes; weights of that name are used where they are shipped.
        engines: Inference engines of the networks.
        threads: Number of CPU threads.
        repeats: Number of timed sweeps.
        full_size_repeats: Number of timed sweeps of the network at full size.
    """
    context = multiprocessing.get_context("spawn")
    print(
        f"{'network':<28}{'engine':<13}{'median ms':>10}{'95 %':>9}{'stage 1':>9}{'proposals':>10}"
        f"{'MiB':>7}{'GFLOP':>14}{'M':>7}"
    )
    results = []
    for name, engine in ((name, engine) for name in networks for engine in engines):
        count = full_size_repeats if name == FULL_SIZE else repeats
        with context.Pool(1) as pool:  # memory that one row took must not hide the next one's
            row = pool.apply(_measure, (name, engine, threads, count))
        results.append(row)
        gflop = " + ".join(f"{stage['gflop']:.1f}" for stage in row["stages"])
        print(
            f"{name:<28}{engine:<13}{row['median_ms']:10.1f}{row['percentile_95_ms']:9.1f}"
            f"{row['first_stage_median_ms']:9.1f}{row['proposals']:10d}"
            f"{row['peak_memory_mib'] or 0:7.0f}{gflop:>14}"
            f"{sum(stage['parameters'] for stage in row['stages']) / 1e6:7.2f}"
        )
    trained = [name for name in networks if name in shipped_names()]
    print_record({"threads": threads, "results": results}, seed=0, weights=trained)


def _measure(name: str, engine: EngineName, threads: int, repeats: int) -> dict[str, Any]:
    torch.set_num_threads(threads)
    sample = open_dataset(PACKAGED_FRAMES, parts={"points"})[0]
    with tempfile.TemporaryDirectory() as folder:
        weights = shipped_or_untrained(name, NETWORK_TASK, Path(folder))
        loaded = load_network(NETWORK_TASK, weights)
    costs = [count_cost(graph.module, graph.example_inputs) for graph in export_graphs(loaded)]
    runners = StageRunners(loaded, engine=engine, threads=threads)
    settings = loaded.network.config.input

    def detect() -> Detections3D:
        sweep = network_sweep(sample, settings)
        return runners.refine(sweep, runners.propose(sweep))

    warm_up = min(repeats, 5)
    whole = measure_latency(detect, warm_up=warm_up, repeats=repeats)
    sweep = network_sweep(sample, settings)
    first = measure_latency(lambda: runners.propose(sweep), warm_up=1, repeats=repeats)
    row: dict[str, Any] = {"network": name, "trained": weights == name, "engine": engine}
    row |= {"points": len(sweep), "proposals": len(runners.propose(sweep).boxes)}
    row |= {"detections": len(detect().scores), "first_stage_median_ms": first.median_ms}
    return row | whole.to_json() | {"stages": [cost.to_json() for cost in costs]}


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)
