"""Cost of a frame as a job goes on: `python -m benchmarks.growth SCRATCH FILE`.

Commands over many small frames, each in a process of its own that is looked at from outside: after
so many frames, its processor time, memory, open files and bytes written are noted. A frame's time
is the difference of two such moments, divided by the frames between them: processor time, since
the machine is shared. `evaluate` has no such moments, so it runs to its end for each number of
frames. `perceive-full-size` is `perceive` on frames of KITTI's size, with the bytes of such a frame
in shards. Kept in benchmarks/results/growth.json; `--works` measures some commands anew.
"""

import io
import json
import shutil
from collections.abc import Sequence
from contextlib import redirect_stdout
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import jsonargparse

from benchmarks.job_figures import (
    FAST,
    Figures,
    Job,
    beyond,
    copy_frames,
    jobs,
    measure,
    measure_whole,
    perceive_job,
    run,
    simulate_frames,
)
from benchmarks.record import print_record
from sightline.simulation.packaged import PACKAGED_FRAMES

MARKS: Final = {
    "shard": (1, 100, 1_000, 10_000),
    "evaluate": (100, 1_000, 10_000),
    "predict": (1, 100, 1_000, 10_000),
    "perceive": (1, 100, 1_000, 10_000),
    "simulate": (1, 100, 1_000, 10_000),
    "perceive-full-size": (1, 4, 20),
    "corrupt": (1, 100, 1_000, 10_000),
}
"""Numbers of frames at which figures are noted; the first one gives the cost of the start."""
_REPEATS: Final = 2  # of `evaluate`
_COMMAND: Final = "python -m benchmarks.growth SCRATCH growth.json"
_SCORE: Final = " 0.90\n"

Row = dict[str, Any]


def main(
    scratch: Path,
    into: Path,
    works: tuple[str, ...] = tuple(MARKS),
    share: int = 1,
    seed: int = 0,
) -> None:
    """Print figures, and write the record into a list of records.

    Args:
        scratch: Empty folder for the frames and results, which are removed.
        into: JSON file with a list of records; their rows of the same commands are removed.
        works: Commands to run.
        share: Divisor of the numbers of frames, for a trial.
        seed: Seed of the simulated frames.
    """
    scratch = scratch.absolute()
    marks = {name: [max(mark // share, 1) for mark in MARKS[name]] for name in works}
    data = simulate_frames(scratch, beyond(max(map(max, marks.values()))), seed=seed)
    results: list[Row] = []
    for name, numbers in marks.items():
        out = scratch / name
        if name == "evaluate":
            noted = evaluations(data, out, numbers)
        elif name == "perceive-full-size":
            noted = measure(perceive_full_size(out, beyond(numbers[-1])), numbers)
        else:
            size = beyond(numbers[-1])
            noted = measure(jobs(data, out, size=size, seed=seed, workers=1)[name], numbers)
        results += rows(name, noted)
        if name == "perceive-full-size":
            results[-1]["frame_bytes"] = shard_bytes(out) // beyond(numbers[-1])
        shutil.rmtree(out)
    shutil.rmtree(scratch)
    merge(results, into, seed=seed)


def rows(name: str, noted: Sequence[Figures]) -> list[Row]:
    """Give figures between each two moments, and print them."""
    found = []
    for before, after in pairwise(noted):
        frames = after.frames - before.frames
        row = {
            "work": name,
            "frames": after.frames,
            "processor_ms": round(1e3 * (after.processor_s - before.processor_s) / frames, 3),
            "start_processor_s": round(noted[0].processor_s, 2),
            "mib": round(after.mib),
            "open_files": after.open_files,
            "bytes": round((after.num_bytes - before.num_bytes) / frames),
            "others": round((after.others_s - before.others_s) / (after.wall_s - before.wall_s), 2),
        }
        print(*row.values(), flush=True)
        found.append(row)
    return found


def evaluations(data: Path, out: Path, marks: Sequence[int]) -> list[Figures]:
    """Score results for each number of frames: the least processor time and peak memory.

    The results are the labels with a score.
    """
    labels, found = data / "training" / "label_2", out / "found"
    found.mkdir(parents=True)
    names = sorted(path.stem for path in labels.iterdir())
    for name in names[: marks[-1]]:
        lines = (labels / f"{name}.txt").read_text().splitlines()
        (found / f"{name}.txt").write_text("".join(line + _SCORE for line in lines))
    noted = []
    for mark in marks:
        listed = out / f"{mark}.txt"
        listed.write_text("\n".join(names[:mark]))
        words = ["evaluate", "objects", found, labels, "--sample-list", listed]
        words += ["--json", out / f"{mark}.json"]
        runs = [measure_whole(words, frames=mark) for _ in range(_REPEATS)]
        best = min(runs, key=lambda figures: figures.processor_s)
        noted.append(best._replace(num_bytes=(out / f"{mark}.json").stat().st_size))
    return noted


def perceive_full_size(out: Path, size: int) -> Job:
    """Give the job over frames of KITTI's size."""
    copy_frames(PACKAGED_FRAMES, out / "data", size)
    return perceive_job(out / "data", out / "found")


def shard_bytes(out: Path) -> int:
    """Pack the frames of KITTI's size into one shard, and give its size."""
    run(["shard", out / "data", out / "shards"])
    return (out / "shards" / "000000.tar").stat().st_size


def merge(results: Sequence[Row], into: Path, *, seed: int) -> None:
    """Add rows to a file of records, in place of earlier rows of the same commands.

    Rows of one commit, date, seed and machine make one record.
    """
    printed = io.StringIO()
    with redirect_stdout(printed):
        print_record({"results": results}, seed=seed, weights=FAST.values())
    records = json.loads(into.read_text()) if into.is_file() else []
    measured = {row["work"] for row in results}
    merged: list[dict[str, Any]] = []
    for record in records:
        record["results"] = [row for row in record["results"] if row["work"] not in measured]
    for record in [*records, json.loads(printed.getvalue())]:
        equal = [each for each in merged if _origin(each) == _origin(record)]
        if equal:
            equal[0]["results"] += record["results"]
        else:
            merged.append(record)
    kept = [record for record in merged if record["results"]]
    for record in kept:
        names = dict.fromkeys(row["work"] for row in record["results"])
        record["command"] = f"{_COMMAND} --works [{','.join(names)}]"
    lines = ",\n".join(json.dumps(record) for record in kept)
    into.write_text(f"[\n{lines}\n]\n")


def _origin(record: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in record.items() if key not in ("command", "results")}


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
