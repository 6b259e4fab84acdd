"""Cost of Ray beside a process of this machine: `python -m benchmarks.ray_overhead SCRATCH`.

`predict` over few and over many small frames, by one process and by one actor of a Ray cluster on
this machine. Processor time counts the command and all processes of the cluster, less what these
take while idle; the difference of both runs is the cost of a frame, the rest is fixed. The last
line is kept in benchmarks/results/ray_overhead.json.
"""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import jsonargparse

from benchmarks.job_figures import (
    FAST,
    family_of,
    jobs,
    measure_whole,
    memory_mib_of,
    processor_s_of,
    simulate_frames,
)
from benchmarks.record import print_record

_PORT: Final = 6399
_SETTLE_S: Final = 15.0
"""Time for actors to end, and for a look at the idle cluster."""


def main(scratch: Path, sizes: tuple[int, int] = (100, 700), seed: int = 0) -> None:
    """Print figures, then one line of JSON.

    Args:
        scratch: Empty folder for the frames and results, which are removed.
        sizes: Numbers of frames.
        seed: Seed of the simulated frames.
    """
    scratch = scratch.absolute()
    folders = {size: simulate_frames(scratch / f"{size}", size, seed=seed) for size in sizes}
    results: list[dict[str, Any]] = []
    with ray_cluster() as cluster:
        _processor_s(folders[sizes[0]], scratch / "first", "ray", cluster, 0.0)  # starts much else
        mib, idle = sum(map(memory_mib_of, family_of(cluster))), _cores_used(cluster)
        for driver in ("local", "ray"):
            few_s, many_s = (
                _processor_s(data, scratch / f"{driver}-{size}", driver, cluster, idle)
                for size, data in folders.items()
            )
            frame_s = (many_s - few_s) / (sizes[1] - sizes[0])
            row = {
                "driver": driver,
                "processor_ms": round(1e3 * frame_s, 2),
                "fixed_processor_s": round(few_s - frame_s * sizes[0], 2),
            }
            print(*row.values(), flush=True)
            results.append(row)
    shutil.rmtree(scratch)
    record = {
        "ray": metadata.version("ray"),
        "sizes": sizes,
        "idle_cores": round(idle, 3),
        "idle_mib": round(mib),
        "results": results,
    }
    print_record(record, seed=seed, weights=[FAST["detection2d"]])


@contextmanager
def ray_cluster() -> Iterator[int]:
    """Start a cluster of this machine alone, and yield the number of its first process."""
    os.environ |= {
        "RAY_ADDRESS": f"127.0.0.1:{_PORT}",
        "RAY_AUTH_MODE": "disabled",
        "RAY_USAGE_STATS_ENABLED": "0",
    }
    ray = str(Path(sys.executable).with_name("ray"))
    words = [ray, "start", "--head", "--block", "--num-cpus", "2", "--port", str(_PORT)]
    words += ["--include-dashboard", "false"]
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process.pid
    finally:
        process.terminate()
        process.wait()


def _processor_s(data: Path, out: Path, driver: str, cluster: int, idle: float) -> float:
    """Processor time of a command and of the cluster during it."""
    before_s, begun_s = _total_s(cluster), time.monotonic()
    job = jobs(data, out, size=0, seed=0, workers=1)["predict"]
    figures = measure_whole([*job.words, "--driver", driver], frames=0)
    if driver == "local":
        return figures.processor_s
    time.sleep(_SETTLE_S)
    of_cluster_s = _total_s(cluster) - before_s
    return figures.processor_s + of_cluster_s - idle * (time.monotonic() - begun_s)


def _cores_used(cluster: int) -> float:
    before_s = _total_s(cluster)
    time.sleep(_SETTLE_S)
    return (_total_s(cluster) - before_s) / _SETTLE_S


def _total_s(cluster: int) -> float:
    return sum(map(processor_s_of, family_of(cluster)))


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
