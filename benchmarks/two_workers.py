"""Two workers against one: `python -m benchmarks.two_workers SCRATCH`, on an idle machine.

Each command over many small frames by one worker of this machine, then by two. Between the first
frames and a later number of them, wall and processor time per frame are taken. Wall times mean
nothing where other programs run: how many cores these used is noted beside. The last line is kept
in benchmarks/results/two_workers.json.
"""

import shutil
from pathlib import Path
from typing import Any, Final

import jsonargparse

from benchmarks.job_figures import FAST, Figures, beyond, jobs, measure, simulate_frames
from benchmarks.record import print_record

SPANS: Final = {
    "simulate": (4, 44),
    "shard": (200, 8_000),
    "corrupt": (50, 1_500),
    "predict": (50, 1_000),
    "perceive": (10, 120),
}
"""Numbers of frames at the begin and end of what is measured."""


def main(
    scratch: Path, works: tuple[str, ...] = tuple(SPANS), share: int = 1, seed: int = 0
) -> None:
    """Print figures, then one line of JSON.

    Args:
        scratch: Empty folder for the frames and results, which are removed.
        works: Commands to run.
        share: Divisor of the numbers of frames, for a trial.
        seed: Seed of the simulated frames.
    """
    scratch = scratch.absolute()
    spans = {name: [max(mark // share, 2) for mark in SPANS[name]] for name in works}
    data = simulate_frames(scratch, beyond(max(map(max, spans.values()))), seed=seed)
    results: list[dict[str, Any]] = []
    for name, span in spans.items():
        for workers in (1, 2):
            size = beyond(span[-1])
            job = jobs(data, scratch / "out", size=size, seed=seed, workers=workers)[name]
            row = {"work": name, "workers": workers, **_per_frame(*measure(job, span))}
            print(*row.values(), flush=True)
            results.append(row)
            shutil.rmtree(scratch / "out")
    shutil.rmtree(scratch)
    print_record({"results": results}, seed=seed, weights=FAST.values())


def _per_frame(before: Figures, after: Figures) -> dict[str, float]:
    """Compute times per frame [ms], and the cores that other programs used."""
    frames, wall_s = after.frames - before.frames, after.wall_s - before.wall_s
    return {
        "wall_ms": round(1e3 * wall_s / frames, 2),
        "processor_ms": round(1e3 * (after.processor_s - before.processor_s) / frames, 2),
        "others": round((after.others_s - before.others_s) / wall_s, 2),
    }


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
