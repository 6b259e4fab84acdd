"""Cost of a frame as a job goes on: `python -m benchmarks.growth SCRATCH`.

Commands over many small frames, each in a process of its own that is looked at from outside: after
so many frames, its processor time, memory, open files and bytes written are noted. A
frame's time is the difference of two such moments, divided by the frames between them: processor
time, since the machine is shared. Frames are few simulated ones under many names. At the end a few
frames of KITTI's size, the bytes of a frame in shards, too.
"""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

import jsonargparse

from benchmarks.record import print_record
from sightline.simulation.packaged import PACKAGED_FRAMES

FAST: Final = {
    "depth-completion": "depth-fast-cpu",
    "detection2d": "detection2d-fast-cpu",
    "detection3d": "detection3d-fast-cpu",
}
_SIMULATED: Final = ("--image-size", "310,94", "--focal-px", "180", "--lidar", "vlp-16")
_FEW: Final = 10
_FULL_SIZE: Final = 20
_SHARD: Final = 10  # frames
_SIMULATED_SHARE: Final = 10
_POLL_S: Final = 0.1
_TICKS: Final = os.sysconf("SC_CLK_TCK")

Figures = dict[str, float]


class Job(NamedTuple):
    """A command, and the files by which its progress is seen."""

    words: Sequence[object]
    out: Path
    pattern: str
    """Pattern of the files that are finished last."""
    per_file: int = 1
    """Number of frames of such a file."""
    share: int = 1
    """Divisor of the marks, for frames that take long."""


def main(
    scratch: Path,
    marks: tuple[int, ...] = (100, 1000),
    works: tuple[str, ...] = ("simulate", "shard", "corrupt", "predict", "perceive"),
    by_two: tuple[str, ...] = ("corrupt", "predict"),
    seed: int = 0,
) -> None:
    """Print a table, then one line of JSON.

    Args:
        scratch: Empty folder for the frames and results, which are removed.
        marks: Numbers of frames at which figures are noted, ascending; a tenth for `simulate`.
        works: Commands to run by one worker.
        by_two: Commands to run by two workers, too.
        seed: Seed of the simulated frames.
    """
    scratch = scratch.absolute()
    first, data = scratch / "first", scratch / "data"
    _run(["simulate", first, "--frames", _FEW, "--seed", seed, *_SIMULATED, "--workers", 2])
    size = marks[-1] + marks[-1] // 20 + _FEW  # so that the last mark is not the end
    copy_frames(first, data, size)
    results: list[dict[str, Any]] = []
    for workers, names in ((1, works), (2, by_two)):
        for name in names:
            job = jobs(data, scratch / f"by-{workers}", size, seed)[name]
            results += rows(name, workers, measure(job, [_FEW, *marks], workers=workers))
    record = {"marks": marks, "results": results, "full_size": full_size(scratch)}
    shutil.rmtree(scratch)
    print_record(record, seed=seed, weights=FAST.values())


def jobs(data: Path, out: Path, size: int, seed: int) -> dict[str, Job]:
    """Commands by their names."""
    street, shards, cases = out / "street", out / "shards", out / "corrupted"
    found, together = out / "found", out / "all"
    frames = size // _SIMULATED_SHARE
    simulate = ["simulate", street, "--frames", frames, "--seed", seed, *_SIMULATED]
    pack = ["shard", data, shards, "--frames-per-shard", _SHARD]
    corrupt = ["corrupt", data, cases, "--cases", "camera_blank", "lidar_blank"]
    predict = ["predict", "detection2d", data, found, "--weights", FAST["detection2d"]]
    return {
        "simulate": Job(simulate, street, "training/calib/*.txt", share=_SIMULATED_SHARE),
        "shard": Job(pack, shards, "0*.json", _SHARD),
        "corrupt": Job(corrupt, cases, "lidar_blank/training/velodyne/*.bin"),
        "predict": Job(predict, found, "*.txt"),
        "perceive": Job(["perceive", data, together, *_tasks()], together, "lines/*.json"),
    }


def _tasks() -> list[str]:
    return [word for task, weights in FAST.items() for word in (f"--{task}", weights)]


def rows(name: str, workers: int, noted: Sequence[Figures]) -> list[dict[str, Any]]:
    """Give figures between each two moments, and print them."""
    found = []
    for before, after in pairwise(noted):
        frames = after["frames"] - before["frames"]
        row = {
            "work": name,
            "workers": workers,
            "frames": after["frames"],
            "processor_ms": round(1e3 * (after["processor_s"] - before["processor_s"]) / frames, 2),
            "start_processor_s": round(noted[0]["processor_s"], 2),
            "mib": round(after["mib"]),
            "open_files": after["open_files"],
            "bytes": round((after["bytes"] - before["bytes"]) / frames),
        }
        print(*row.values(), flush=True)
        found.append(row)
    return found


def full_size(scratch: Path) -> dict[str, Any]:
    """Figures of `perceive` for frames of KITTI's size, and the bytes of a frame in shards."""
    data, out, shards = scratch / "full", scratch / "full-out", scratch / "full-shards"
    copy_frames(PACKAGED_FRAMES, data, _FULL_SIZE + 2)
    _run(["shard", data, shards, "--frames-per-shard", _FULL_SIZE + 2])
    job = Job(["perceive", shards, out, *_tasks()], out, "lines/*.json")
    (row,) = rows("perceive, KITTI's size", 1, measure(job, [2, _FULL_SIZE], workers=1))
    tar = shards / "000000.tar"
    return {**row, "frame_bytes": round(tar.stat().st_size / (_FULL_SIZE + 2))}


def copy_frames(source: Path, target: Path, size: int) -> None:
    """Write the frames of an object tree under `size` names, one after the other."""
    names = sorted(path.stem for path in (source / "training" / "calib").iterdir())
    for folder in sorted((source / "training").iterdir()):
        (target / "training" / folder.name).mkdir(parents=True)
        files = {path.stem: path for path in folder.iterdir()}
        for number in range(size):
            file = files[names[number % len(names)]]
            copy = target / "training" / folder.name / f"{number:06d}{file.suffix}"
            shutil.copyfile(file, copy)


def _run(words: Sequence[object]) -> None:
    command = [sys.executable, "-m", "sightline", *map(str, words)]
    subprocess.run(command, check=True, capture_output=True)


def measure(job: Job, marks: Sequence[int], *, workers: int) -> list[Figures]:
    """Run a command, and note its figures when it has finished so many frames; Linux only."""
    words = [*job.words, "--workers", workers]
    command = [sys.executable, "-m", "sightline", *map(str, words)]
    noted: list[Figures] = []
    waiting = [mark // job.share for mark in marks]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None:
        done = len(list(job.out.glob(job.pattern))) * job.per_file
        family = _family(process.pid)
        figures = {
            "frames": done,
            "processor_s": sum(map(_processor_s, family)),
            "mib": sum(map(_resident_mib, family)),
            "open_files": sum(map(_open_files, family)),
        }
        # Ended workers count through their parent; the last look may come too late for either.
        if waiting and done >= waiting[0] and figures["mib"]:
            while waiting and done >= waiting[0]:
                waiting.pop(0)
            files = [path for path in job.out.rglob("*") if path.is_file()]
            noted.append({**figures, "bytes": sum(path.stat().st_size for path in files)})
        time.sleep(_POLL_S)
    if process.returncode:
        raise ValueError(f"{' '.join(command)} ended with status {process.returncode}")
    return noted


def _processor_s(process: int) -> float:
    """Processor time of a process, and of those below it that have ended."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / _TICKS


def _family(process: int) -> list[int]:
    """Numbers of a process and all below it."""
    try:
        listed = Path(f"/proc/{process}/task/{process}/children").read_text()
    except OSError:
        return []
    return [process, *(each for child in listed.split() for each in _family(int(child)))]


def _resident_mib(process: int) -> float:
    """Memory of a process that it does not share: its own, and its part of that of several."""
    try:
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0.0
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024


def _open_files(process: int) -> int:
    try:
        return len(list(Path(f"/proc/{process}/fd").iterdir()))
    except OSError:
        return 0


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
