"""Times the street simulator: `python -m benchmarks.simulate`.

Its last line is kept in benchmarks/results/simulate.json.

- A frame and core: single streets at 1242x375 with one sample a pixel, everything included from
  the street to the files, in one process, stage by stage. Processor time, which other programs on
  the machine disturb least and which counts Embree's helper threads, too. Beside it, frame by
  frame in turns, the same with the camera left out.
- Memory: of each process of `sightline simulate` with one worker and with two, looked at while
  it runs: the most that was ever resident (VmHWM), pages that it shares with others counted in
  full, and the most of its proportional share (PSS), where each page is divided among those who
  use it. Only where the system tells (Linux).
- Two workers against one: wall time of whole runs, in turns, after a warm-up.
"""

import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import jsonargparse
import numpy as np

from benchmarks.machine import describe_machine
from sightline.jobs.pool import one_blas_thread
from sightline.simulation.camera import CameraConfig, render_camera
from sightline.simulation.generate import simulate
from sightline.simulation.labels import label_frame
from sightline.simulation.lidar import take_sweep
from sightline.simulation.raycast import Raycaster
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import (
    calibration_of,
    lidar_of,
    simulate_frame,
    simulate_street,
)
from sightline.simulation.writer import ObjectLayout

Result = TypeVar("Result")

_LOOK_S = 0.2  # between two looks at the memory


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
    config = SimulationConfig(seed=seed)
    whole, stages = Stages(), Stages()
    with tempfile.TemporaryDirectory() as folder, one_blas_thread():  # as in a worker
        layout = ObjectLayout(root=Path(folder), velodyne="velodyne")
        time_frame(config, 0, layout, Stages(), Stages())  # compiles and warms up
        for index in range(1, frames + 1):
            time_frame(config, index, layout, whole, stages)
    memory = {workers: measure_memory(config.seed, parallel_frames, workers) for workers in (1, 2)}
    speed = time_workers(config, parallel_frames, repeats)
    seconds = {**stages.seconds, **whole.seconds}
    results = {name: spread(values) for name, values in seconds.items()}
    for name, result in results.items():
        print(f"{name:<16} {result['median_s']:7.3f} s  (IQR {result['iqr_s']:.3f})")
    ratio = results["frame"]["median_s"] / results["without camera"]["median_s"]
    print(f"without the camera, {ratio:.2f} x as fast")
    for workers, processes in memory.items():
        for role, held in processes.items():
            print(
                f"memory, {role} of {workers}: {held['resident_mb']:.0f} MB resident at most, "
                f"{held['share_mb']:.0f} MB its share"
            )
    print(
        f"wall, a frame    {speed['one_worker_s']:7.3f} s with one worker, "
        f"{speed['two_workers_s']:.3f} s with two: {speed['speed_up']:.2f} x"
    )
    setting = {"image_size": config.image_size, "frames": frames, "seed": seed}
    record = {
        "machine": describe_machine(),
        **setting,
        "results": results,
        "without_camera": ratio,
        "memory": memory,
        **speed,
    }
    print(json.dumps(record))


def time_frame(
    config: SimulationConfig, index: int, layout: ObjectLayout, whole: Stages, stages: Stages
) -> None:
    """Makes a frame as `simulate` does, and once more by stages."""
    for name, camera in (("frame", True), ("without camera", False)):
        chosen = replace(config, camera=camera)
        files = replace(layout, camera=camera).frame(index)
        whole.time(name, lambda: files.write(simulate_frame(chosen, index), layout.velodyne))  # noqa: B023
    simulate_street.cache_clear()
    street = stages.time("street", lambda: simulate_street(config, index))
    scene = stages.time("scene", lambda: street.snapshot(0.0))
    raycaster = stages.time("search tree", lambda: Raycaster(scene.mesh))
    height_m = lidar_of(config).height_m
    picture = stages.time(
        "camera",
        lambda: render_camera(
            scene,
            calibration_of(config),
            config.image_size,
            rng=np.random.default_rng(0),
            config=CameraConfig(lidar_height_m=height_m),
            raycaster=raycaster,
        ),
    )
    stages.time(
        "LiDAR",
        lambda: take_sweep(scene, raycaster, rng=np.random.default_rng(0), config=lidar_of(config)),
    )
    stages.time(
        "labels", lambda: label_frame(scene, picture.owners, calibration_of(config), height_m)
    )
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


def measure_memory(seed: int, frames: int, workers: int) -> dict[str, dict[str, float]]:
    """Largest figures of the command's own process and of any of its workers."""
    most: dict[str, dict[str, float]] = {}
    if not Path("/proc/self/smaps_rollup").is_file():
        return most
    with tempfile.TemporaryDirectory() as folder:
        options = ["--frames", str(frames), "--seed", str(seed), "--workers", str(workers)]
        command = [sys.executable, "-m", "sightline", "simulate", f"{folder}/out", *options]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
            while process.poll() is None:
                for pid in (process.pid, *children_of(process.pid)):
                    role = "worker" if pid != process.pid or workers == 1 else "main process"
                    held = most.setdefault(role, {"resident_mb": 0.0, "share_mb": 0.0})
                    for name, value in memory_of(pid).items():
                        held[name] = max(held[name], value)
                time.sleep(_LOOK_S)
        if process.returncode != 0:
            raise RuntimeError(f"{' '.join(command)} failed")
    return most


def children_of(pid: int) -> Iterator[int]:
    """Processes that a process has started."""
    for folder in Path("/proc").glob("[0-9]*"):
        if facts_of(folder / "status").get("PPid", "").strip() == str(pid):
            yield int(folder.name)


def memory_of(pid: int) -> dict[str, float]:
    """What a process has held at most so far, and its share of it now; empty if it has ended."""
    folder = Path(f"/proc/{pid}")
    facts = facts_of(folder / "status") | facts_of(folder / "smaps_rollup")
    names = {"resident_mb": "VmHWM", "share_mb": "Pss"}
    return {
        name: int(facts[fact].split()[0]) * 1024 / 1e6
        for name, fact in names.items()
        if fact in facts
    }


def facts_of(path: Path) -> dict[str, str]:
    """What a file of lines `name: value` says; nothing where its process has ended."""
    try:
        lines = path.read_text().splitlines()
    except OSError:
        return {}
    return dict(line.split(":", 1) for line in lines if ":" in line)


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
