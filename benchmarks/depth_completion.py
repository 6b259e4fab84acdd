"""Times depth completion at 1216x352: `python -m benchmarks.depth_completion`.

From a sparse map and an image to a dense map, as `DepthPredictor.complete` does it, pre-fill
included: the network of Yu and Kee 2021, ours and the methods without training, on every engine
that is asked for. Each row is measured in a process of its own, one after the other, in one run.
The last line is kept in benchmarks/results/depth_completion.json.

The paper's network has weights drawn at random: its time does not depend on them.
"""

import json
import multiprocessing
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import jsonargparse
import torch

from benchmarks.latency import count_cost, measure_latency
from benchmarks.machine import describe_machine
from sightline.data.open import open_dataset
from sightline.depth_completion.config import DepthCompletionConfig
from sightline.depth_completion.export_graph import example_inputs
from sightline.depth_completion.method_names import Method
from sightline.depth_completion.methods import complete_depth
from sightline.depth_completion.model import DepthCompletionNet
from sightline.depth_completion.predictor import DepthPredictor
from sightline.depth_completion.registration import TASK
from sightline.export.names import EngineName
from sightline.files.weights import write_weights
from sightline.geometry.projection import sparse_depth_map
from sightline.inference.network import load_network
from sightline.simulation.packaged import PACKAGED_FRAMES

SIZE = (352, 1216)
_METHODS: tuple[Method, ...] = ("linear", "classical", "adaptive")
_PAPER = "depth-shiftconv (untrained)"
_NETWORKS = (_PAPER, "depth-best", "depth-fast-cpu")

Device = Literal["cpu", "cuda"]


def main(
    device: Device = "cpu",
    engines: tuple[str, ...] = ("torch", "onnxruntime", "openvino"),
    threads: int = 2,
    repeats: int = 20,
) -> None:
    """Prints a table, then one line of JSON.

    Args:
        device: Where networks run; methods without training run on the CPU.
        engines: What runs the networks that are shipped; the paper's runs in PyTorch only.
        threads: Of the CPU.
        repeats: Calls timed.
    """
    context = multiprocessing.get_context("spawn")
    rows = [(name, "none", "cpu") for name in _METHODS] + [(_PAPER, "torch", device)]
    rows += [(name, engine, device) for name in _NETWORKS[1:] for engine in engines]
    print(f"{'method':<30}{'engine':<14}{'median ms':>10}{'95 %':>8}{'MiB':>8}{'GFLOP':>8}{'M':>8}")
    results = []
    for name, engine, place in rows:
        with context.Pool(1) as pool:  # memory that one row took must not hide the next one's
            row = pool.apply(_measure, (name, engine, place, threads, repeats))
        results.append(row)
        print(
            f"{name:<30}{engine:<14}{row['median_ms']:10.1f}{row['percentile_95_ms']:8.1f}"
            f"{row['peak_memory_mib'] or 0:8.0f}{row.get('gflop', 0):8.1f}"
            f"{row.get('parameters', 0) / 1e6:8.3f}"
        )
    setting = {"size": list(SIZE), "threads": threads, "device": device}
    print(json.dumps({"machine": describe_machine(), **setting, "results": results}))


def _measure(
    name: str, engine: EngineName, device: Device, threads: int, repeats: int
) -> dict[str, Any]:
    torch.set_num_threads(threads)
    sample = open_dataset(PACKAGED_FRAMES, parts={"image", "points"})[0]
    assert sample.points is not None
    assert sample.image is not None
    sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
    sparse = sparse[-SIZE[0] :, : SIZE[1]].contiguous()
    image = sample.image[:, -SIZE[0] :, : SIZE[1]].contiguous()
    row: dict[str, Any] = {"method": name, "engine": engine}
    method = next((each for each in _METHODS if each == name), None)
    if method is not None:
        latency = measure_latency(lambda: complete_depth(sparse, method), repeats=repeats)
        return row | latency.to_json()
    with tempfile.TemporaryDirectory() as folder:
        weights = _untrained(Path(folder)) if name == _PAPER else name
        predictor = DepthPredictor.load(weights, engine=engine, device=device, threads=threads)
        is_slow = name == _PAPER and device == "cpu"
        latency = measure_latency(
            lambda: predictor.complete(sparse, image),
            device=device,
            warm_up=1 if is_slow else 10,
            repeats=min(repeats, 3) if is_slow else repeats,
        )
        loaded = load_network(TASK, weights)
    inputs = {
        input_name: torch.rand(1, planes.shape[1], *SIZE)
        for input_name, planes in example_inputs(loaded.network).items()
    }
    return row | latency.to_json() | count_cost(loaded.network, inputs).to_json()


def _untrained(folder: Path) -> Path:
    torch.manual_seed(0)
    network = DepthCompletionNet(DepthCompletionConfig())
    path = folder / "paper.safetensors"
    config = json.loads(json.dumps(asdict(network.config)))
    tensors = dict(network.state_dict())
    write_weights(path, tensors, task="depth-completion", config=config, provenance={})
    return path


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)
