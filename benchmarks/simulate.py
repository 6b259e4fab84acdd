"""Times the street simulator: `python -m benchmarks.simulate`.

Its last line is kept in benchmarks/results/simulate.json.

- A frame and core: single streets at 1242x375 with one sample a pixel, everything included from
  the street to the files, in one process, stage by stage. Processor time, which other programs on
  the machine disturb least and which counts Embree's helper threads, too.
- Memory: the peak of that process, what it holds in all and what is its own: libraries that are
  mapped from files are shared by all workers.
- Two workers against one: wall time of whole runs, in turns, after a warm-up.
"""

import json
import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import jsonargparse
import numpy as np
import torch

from benchmarks.machine import describe_machine
from sightline.simulation.camera import CameraConfig, render_camera
from sightline.simulation.generate import simulate
from sightline.simulation.labels import label_frame
from sightline.simulation.lidar import take_sweep
from sightline.simulation.raycast import Raycaster
from sightline.simulation.simulator import SimulationConfig, simulate_frame, simulate_street
from sightline.simulation.writer import ObjectLayout

Result = TypeVar("Result")


class Stages:
    """Processor time of each stage, frame by frame."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = {}

    def time(self, name: str, work: Callable[[], Result]) -> Result:
        """Does the work and notes how long it took."""
        start = time.process_time()
        result = work()
        self.seconds.setdefault(name, []).append(time.process_time() - start)
        return result


def main(frames: int = 12, parallel_frames: int = 24, repeats: int = 3, seed: int = 11) -> None:
    """Prints a table, then one line of JSON."""
    torch.set_num_threads(1)
    config = SimulationConfig(seed=seed)
    whole, stages = Stages(), Stages()
    with tempfile.TemporaryDirectory() as folder:
        layout = ObjectLayout(root=Path(folder), velodyne="velodyne")
        time_frame(config, 0, layout, Stages(), Stages())  # compiles and warms up
        for index in range(1, frames + 1):
            time_frame(config, index, layout, whole, stages)
    memory = {"peak_mb": peak_mb(), "own_mb": own_mb()}
    held = f"{memory['peak_mb']:.0f} MB at most, {memory['own_mb']:.0f} MB its own"
    speed = time_workers(config, parallel_frames, repeats)
    seconds = {**stages.seconds, "frame": whole.seconds["frame"]}
    results = {name: spread(values) for name, values in seconds.items()}
    for name, result in results.items():
        print(f"{name:<16} {result['median_s']:7.3f} s  (IQR {result['iqr_s']:.3f})")
    print(f"memory           {held}")
    print(
        f"wall, a frame    {speed['one_worker_s']:7.3f} s with one worker, "
        f"{speed['two_workers_s']:.3f} s with two: {speed['speed_up']:.2f} x"
    )
    setting = {"image_size": config.image_size, "frames": frames, "seed": seed}
    record = {"machine": describe_machine(), **setting, "results": results, **memory, **speed}
    print(json.dumps(record))


def time_frame(
    config: SimulationConfig, index: int, layout: ObjectLayout, whole: Stages, stages: Stages
) -> None:
    """Makes a frame as `simulate` does, and once more by stages."""

    def make() -> None:
        layout.frame(index).write(simulate_frame(config, index), layout.velodyne)

    whole.time("frame", make)
    simulate_street.cache_clear()
    street = stages.time("street", lambda: simulate_street(config, index))
    scene = stages.time("scene", lambda: street.snapshot(0.0))
    raycaster = stages.time("search tree", lambda: Raycaster(scene.mesh))
    height_m = config.lidar_config.height_m
    picture = stages.time(
        "camera",
        lambda: render_camera(
            scene,
            config.calibration,
            config.image_size,
            rng=np.random.default_rng(0),
            config=CameraConfig(lidar_height_m=height_m),
            raycaster=raycaster,
        ),
    )
    stages.time(
        "LiDAR",
        lambda: take_sweep(
            scene, raycaster, rng=np.random.default_rng(0), config=config.lidar_config
        ),
    )
    stages.time("labels", lambda: label_frame(scene, picture, config.calibration, height_m))
    frame = simulate_frame(config, index)
    stages.time("files", lambda: layout.frame(index).write(frame, layout.velodyne))


def time_workers(config: SimulationConfig, frames: int, repeats: int) -> dict[str, float]:
    """Wall time a frame with one worker and with two."""
    seconds: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(repeats):
        for workers, times in seconds.items():
            with tempfile.TemporaryDirectory() as folder:
                start = time.perf_counter()
                simulate(Path(folder), frames=frames, config=config, workers=workers)
                times.append((time.perf_counter() - start) / frames)
    one, two = (min(seconds[workers]) for workers in (1, 2))
    return {"one_worker_s": one, "two_workers_s": two, "speed_up": one / two}


def spread(values: list[float]) -> dict[str, float]:
    """Median and distance between the quartiles."""
    low, median, high = statistics.quantiles(values, n=4)
    return {"median_s": median, "iqr_s": high - low}


def peak_mb() -> float:
    """The most memory that this process ever held."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def own_mb() -> float:
    """Of the peak, what is not mapped from files; the peak where the system does not tell."""
    status = Path("/proc/self/status")
    if not status.is_file():
        return peak_mb()
    lines = dict(line.split(":", 1) for line in status.read_text().splitlines() if ":" in line)
    return peak_mb() - int(lines["RssFile"].split()[0]) * 1024 / 1e6


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
