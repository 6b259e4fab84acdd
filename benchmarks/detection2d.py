"""Time of 2D detection at 1242x375: `python -m benchmarks.detection2d`.

From a frame's image and sweep to its detections, projection and suppression included: the network
of Kim et al. 2018 and ours, on each requested engine, and in PyTorch also in bfloat16. Each row is
measured in a process of its own, one after the other, in one run. The last line is kept in
benchmarks/results/detection2d.json.

Networks that do not come with the package have random weights. The network's own time does not
depend on them; that of suppression does: "detections" is the number of boxes left.
"""

import multiprocessing
import tempfile
from pathlib import Path
from typing import Any, Literal

import jsonargparse
import torch
from torch import Tensor

from benchmarks.latency import count_cost, measure_latency
from benchmarks.record import print_record
from benchmarks.untrained import shipped_or_untrained
from sightline.data.open import open_dataset
from sightline.detection2d.export_graph import export_graph
from sightline.detection2d.model import Detector
from sightline.detection2d.network_task import NETWORK_TASK
from sightline.detection2d.placement import (
    Placement,
    camera_image,
    lidar_image,
    padded,
    place,
    to_detections,
    whole_strides,
)
from sightline.export.engines import build_engine
from sightline.export.names import EngineName, Precision
from sightline.files.weights_header import shipped_names
from sightline.inference.network import load_network
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.predictions import Detections2D
from sightline.structures.sample import CameraLidarSample

PAPER = "detection2d-dgfn-kitti"
_NETWORKS = (PAPER, "detection2d-best", "detection2d-fast-cpu")  # names of recipes and of weights

Device = Literal["cpu", "cuda"]


def main(
    networks: tuple[str, ...] = _NETWORKS,
    engines: tuple[str, ...] = ("torch", "onnxruntime", "openvino"),
    device: Device = "cpu",
    threads: int = 2,
    repeats: int = 20,
    paper_repeats: int = 3,
) -> None:
    """Print a table, then one line of JSON.

    Args:
        networks: Names of recipes; weights of that name are used where they are shipped.
        engines: Inference engines; PyTorch runs in float32 and in bfloat16.
        device: Device of PyTorch.
        threads: Number of CPU threads.
        repeats: Number of timed frames.
        paper_repeats: Number of timed frames of the paper's network, which is slow on a CPU.
    """
    context = multiprocessing.get_context("spawn")
    runs = [(engine, "float32") for engine in engines]
    runs[1:1] = [("torch", "bfloat16")] if "torch" in engines else []
    rows = [(name, *run) for name in networks for run in runs]
    print(
        f"{'network':<26}{'engine':<13}{'precision':<10}{'median ms':>10}{'95 %':>9}{'network':>9}"
        f"{'MiB':>7}{'GFLOP':>8}{'M':>7}"
    )
    results = []
    for name, engine, precision in rows:
        place_ = device if engine == "torch" else "cpu"
        count = paper_repeats if name == PAPER and place_ == "cpu" else repeats
        with context.Pool(1) as pool:  # memory that one row took must not hide the next one's
            row = pool.apply(_measure, (name, engine, precision, place_, threads, count))
        results.append(row)
        print(
            f"{name:<26}{engine:<13}{precision:<10}{row['median_ms']:10.1f}"
            f"{row['percentile_95_ms']:9.1f}{row['network_median_ms']:9.1f}"
            f"{row['peak_memory_mib'] or 0:7.0f}{row['gflop']:8.1f}{row['parameters'] / 1e6:7.2f}"
        )
    setting = {"threads": threads, "device": device, "frame": [375, 1242]}
    trained = [name for name in networks if name in shipped_names()]
    print_record({**setting, "results": results}, seed=0, weights=trained)


def _measure(
    name: str,
    engine: EngineName,
    precision: Precision,
    device: Device,
    threads: int,
    repeats: int,
) -> dict[str, Any]:
    torch.set_num_threads(threads)
    sample = open_dataset(PACKAGED_FRAMES, parts={"image", "points"})[0]
    with tempfile.TemporaryDirectory() as folder:
        weights = shipped_or_untrained(name, NETWORK_TASK, Path(folder))
        loaded = load_network(NETWORK_TASK, weights)
    network = loaded.network
    graph = export_graph(loaded)
    inputs, _ = _prepared(sample, network)
    cost = count_cost(network, inputs)
    run = build_engine(
        network.to(device),
        graph.example_inputs,
        engine,
        metadata=graph.metadata,
        threads=threads,
        precision=precision,
    )

    def detect() -> Detections2D:
        given, placement = _prepared(sample, network)
        outputs = {key: tensor[0].cpu() for key, tensor in run(given).items()}
        config = network.config.postprocess
        return to_detections(outputs["scores"], outputs["boxes"], placement, config)

    warm_up = min(repeats, 5)
    whole = measure_latency(detect, device=device, warm_up=warm_up, repeats=repeats)
    alone = measure_latency(lambda: run(inputs), device=device, warm_up=1, repeats=repeats)
    row = {"network": name, "trained": weights == name, "engine": engine, "precision": precision}
    row |= {"detections": len(detect().scores), "network_median_ms": alone.median_ms}
    return row | whole.to_json() | cost.to_json()


def _prepared(sample: CameraLidarSample, network: Detector) -> tuple[dict[str, Tensor], Placement]:
    """Prepare the network's inputs like `DetectionPredictor`."""
    config = network.config.input
    given, placement = place(sample, config)
    size = whole_strides(given.image_size, network.stride)
    images = {"image": camera_image(given), "lidar": lidar_image(given, config)}
    return {key: padded(images[key], size)[None] for key in network.input_names}, placement


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)
