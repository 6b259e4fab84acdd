"""Cost of Ray beside a process of this machine: `python -m benchmarks.ray_overhead SCRATCH`.

`predict` over few and over many small frames, by one process and by one actor of a Ray cluster on
this machine. Processor time counts the command and all workers of the cluster; the difference of
both runs is the cost of a frame, the rest is fixed. The cluster's own processes are seen before:
they take some of a core also while nothing runs. The last line is kept in
benchmarks/results/ray_overhead.json.
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
_START_S: Final = 120.0
_IDLE_S: Final = 10.0
_STARTS: Final = 5
"""Number of attempts: on a loaded machine Ray gives up waiting for its own processes."""


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
        mib, idle = sum(map(memory_mib_of, family_of(cluster))), _cores_used(cluster)
        for driver in ("local", "ray"):
            few_s, many_s = (
                _processor_s(data, scratch / f"{driver}-{size}", driver, cluster)
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
    process = _started(str(Path(sys.executable).with_name("ray")))
    try:
        yield process.pid
    finally:
        process.terminate()
        process.wait()


def _started(ray: str) -> "subprocess.Popen[bytes]":
    """Start a cluster, and wait until it is ready."""
    words = [ray, "start", "--head", "--block", "--num-cpus", "2", "--port", str(_PORT)]
    words += ["--include-dashboard", "false"]
    quiet = subprocess.DEVNULL
    for _ in range(_STARTS):
        process = subprocess.Popen(words, stdout=quiet, stderr=quiet)
        until_s = time.monotonic() + _START_S
        while process.poll() is None and time.monotonic() < until_s:
            time.sleep(1)
            if any("raylet" in _name(each) for each in family_of(process.pid)):
                time.sleep(_IDLE_S)  # it may still give up
                status = [ray, "status", "--address", os.environ["RAY_ADDRESS"]]
                if not subprocess.run(status, check=False, stdout=quiet, stderr=quiet).returncode:
                    return process
        process.terminate()
        process.wait()
    raise ValueError(f"no Ray cluster has started in {_STARTS} attempts")


def _processor_s(data: Path, out: Path, driver: str, cluster: int) -> float:
    """Processor time of a command and of the cluster's workers."""
    workers_s: dict[int, float] = {}

    def look() -> None:
        for each in family_of(cluster):
            if _name(each).startswith("ray::") and "Agent" not in _name(each):
                workers_s[each] = processor_s_of(each)

    look()
    before_s = sum(workers_s.values())
    job = jobs(data, out, size=0, seed=0, workers=1)["predict"]
    figures = measure_whole([*job.words, "--driver", driver], frames=0, look=look)
    return figures.processor_s + sum(workers_s.values()) - before_s


def _cores_used(cluster: int) -> float:
    before_s = sum(map(processor_s_of, family_of(cluster)))
    time.sleep(_IDLE_S)
    return (sum(map(processor_s_of, family_of(cluster))) - before_s) / _IDLE_S


def _name(process: int) -> str:
    try:
        return Path(f"/proc/{process}/cmdline").read_text()
    except OSError:
        return ""


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
