"""Time and memory of the street simulator: `python -m benchmarks.simulate`.

Its last line is kept in benchmarks/results/simulate.json.

- A frame and core: single streets at 1242x375 with one sample a pixel, everything included from
  the street to the files, in one process, stage by stage. Processor time, which other programs on
  the machine disturb least and which counts Embree's helper threads, too. In turns with it, frame
  by frame, the same without the camera.
- Memory: of each process of `sightline simulate` with one worker and with two, sampled while it
  runs: the peak resident memory (VmHWM), which counts shared pages in full, and the peak of the
  proportional share (PSS), in which each page is divided among its users. Linux only.
- Two workers against one: wall time of whole runs, in turns, after a warm-up.
"""

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

from benchmarks.record import print_record
from sightline.jobs.pool import one_blas_thread
from sightline.simulation.camera.camera import CameraConfig, render_camera
from sightline.simulation.generate import ObjectLayout, simulate
from sightline.simulation.labels import label_frame
from sightline.simulation.lidar import take_sweep
from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import calibration_of, lidar_of, simulate_frame, simulate_street

Result = TypeVar("Result")

_LOOK_S = 0.2  # between two looks at the memory


class Stages:
    """Processor time of each stage, frame by frame."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = {}

    def time(self, name: str, work: Callable[[], Result]) -> Result:
        """Do the work and record its time."""
        start = time.process_time()
        result = work()
        self.seconds.setdefault(name, []).append(time.process_time() - start)
        return result


def main(frames: int = 12, parallel_frames: int = 24, repeats: int = 3, seed: int = 11) -> None:
    """Print a table, then one line of JSON."""
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
    setting = {"image_size": config.image_size, "frames": frames}
    figures = {"results": results, "without_camera": ratio, "memory": memory, **speed}
    print_record({**setting, **figures}, seed=seed)


def time_frame(
    config: SimulationConfig, index: int, layout: ObjectLayout, whole: Stages, stages: Stages
) -> None:
    """Make a frame as `simulate` does, and once more by stages."""
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
    """Measure the wall time of a frame with one worker and with two."""
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
    """Compute the median and the interquartile range."""
    low, median, high = statistics.quantiles(values, n=4)
    return {"median_s": median, "iqr_s": high - low}


def measure_memory(seed: int, frames: int, workers: int) -> dict[str, dict[str, float]]:
    """Measure the peak of the command's own process and of any of its workers."""
    peaks: dict[str, dict[str, float]] = {}
    if not Path("/proc/self/smaps_rollup").is_file():
        return peaks
    with tempfile.TemporaryDirectory() as folder:
        options = ["--frames", str(frames), "--seed", str(seed), "--workers", str(workers)]
        command = [sys.executable, "-m", "sightline", "simulate", f"{folder}/out", *options]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
            while process.poll() is None:
                for pid in (process.pid, *child_pids(process.pid)):
                    role = "worker" if pid != process.pid or workers == 1 else "main process"
                    held = peaks.setdefault(role, {"resident_mb": 0.0, "share_mb": 0.0})
                    for name, value in read_memory(pid).items():
                        held[name] = max(held[name], value)
                time.sleep(_LOOK_S)
        if process.returncode != 0:
            raise RuntimeError(f"{' '.join(command)} failed")
    return peaks


def child_pids(pid: int) -> Iterator[int]:
    """List the processes that a process has started."""
    for folder in Path("/proc").glob("[0-9]*"):
        if read_fields(folder / "status").get("PPid", "").strip() == str(pid):
            yield int(folder.name)


def read_memory(pid: int) -> dict[str, float]:
    """Read a process's peak memory so far, and its share now; empty if it has ended."""
    folder = Path(f"/proc/{pid}")
    fields = read_fields(folder / "status") | read_fields(folder / "smaps_rollup")
    names = {"resident_mb": "VmHWM", "share_mb": "Pss"}
    return {
        name: int(fields[field].split()[0]) * 1024 / 1e6
        for name, field in names.items()
        if field in fields
    }


def read_fields(path: Path) -> dict[str, str]:
    """Read a file of lines `name: value`; empty where its process has ended."""
    try:
        lines = path.read_text().splitlines()
    except OSError:
        return {}
    return dict(line.split(":", 1) for line in lines if ":" in line)


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
