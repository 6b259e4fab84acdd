"""Cost of a frame as data sets grow: `python -m benchmarks.growth SCRATCH`.

Commands over more and more small frames, each in a process of its own: processor time, memory, open
files and bytes written. Frames are few simulated ones under many names. A frame's time is that of
the larger job less that of a job with few frames, divided by the difference in frames: processor
time, since the machine is shared. Then two workers beside one, and a few frames of KITTI's size,
from which the needs of ten million are computed. Its last line is kept in
benchmarks/results/growth.json.
"""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Final

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
_FULL_SIZE: Final = 22
_POLL_S: Final = 0.2
_SIMULATED_SHARE: Final = 20  # a frame takes long to simulate, so there are fewer

Figures = dict[str, float]


def main(scratch: Path, sizes: tuple[int, ...] = (100, 1000), seed: int = 0) -> None:
    """Print a table, then one line of JSON.

    Args:
        scratch: Empty folder for the frames and results, which are removed.
        sizes: Numbers of frames, ascending.
        seed: Seed of the simulated frames.
    """
    scratch = scratch.absolute()
    first = scratch / "first"
    simulation = ["simulate", first, "--frames", _FEW, "--seed", seed, *_SIMULATED]
    measure(simulation, first, workers=2)
    results, begun = [], {}
    for size in (_FEW, *sizes):
        data = scratch / f"frames-{size}"
        copy_frames(first, data, size)
        for name, (frames, words, out) in commands(data, size, seed).items():
            figures = measure(words, out, workers=1)
            if size == _FEW:
                begun[name] = (frames, figures)
                continue
            results.append({"work": name, "workers": 1, **per_frame(frames, figures, begun[name])})
            print(*results[-1].values(), flush=True)
        if size == sizes[-1]:
            for name, (frames, words, out) in commands(data, size, seed).items():
                if name in ("evaluate", "shard"):  # threads, or one process
                    continue
                shutil.rmtree(out)
                figures = measure(words, out, workers=2)
                row = {"work": name, "workers": 2, **per_frame(frames, figures, begun[name])}
                results.append(row)
                print(*row.values(), flush=True)
        shutil.rmtree(data.parent / f"out-{size}")
    record = {"sizes": sizes, "results": results, "full_size": full_size(scratch)}
    shutil.rmtree(scratch)
    print_record(record, seed=seed, weights=FAST.values())


def commands(data: Path, size: int, seed: int) -> dict[str, tuple[int, list[object], Path]]:
    """Number of frames, words and output of each command, in their order."""
    out = data.parent / f"out-{size}"
    frames = max(size // _SIMULATED_SHARE, 2)
    tasks = [word for task, weights in FAST.items() for word in (f"--{task}", weights)]
    labels = data / "training" / "label_2"
    return {
        "simulate": (
            frames,
            ["simulate", out / "street", "--frames", frames, "--seed", seed, *_SIMULATED],
            out / "street",
        ),
        "shard": (
            size,
            ["shard", data, out / "shards", "--frames-per-shard", 100],
            out / "shards",
        ),
        "corrupt": (
            size,
            ["corrupt", data, out / "corrupted", "--cases", "camera_blank", "lidar_blank"],
            out / "corrupted",
        ),
        "predict": (
            size,
            ["predict", "detection2d", data, out / "found", "--weights", FAST["detection2d"]],
            out / "found",
        ),
        "perceive": (size, ["perceive", data, out / "all", *tasks], out / "all"),
        "evaluate": (
            size,
            ["evaluate", "objects", out / "found", labels, "--json", out / "scores.json"],
            out / "scores.json",
        ),
    }


def per_frame(frames: int, figures: Figures, begun: tuple[int, Figures]) -> Figures:
    """Figures of a job less those of its start with few frames."""
    few, start = begun
    more = frames - few
    return {
        "frames": frames,
        "processor_ms": round(1000 * (figures["processor_s"] - start["processor_s"]) / more, 2),
        "start_processor_s": round(start["processor_s"], 2),
        "wall_s": round(figures["wall_s"], 1),
        "peak_mib": round(figures["peak_mib"]),
        "open_files": figures["open_files"],
        "bytes": round((figures["bytes"] - start["bytes"]) / more),
    }


def full_size(scratch: Path) -> dict[str, Any]:
    """Figures of `perceive` for frames of KITTI's size, and the bytes of a frame in shards."""
    figures: dict[int, Figures] = {}
    sharded: dict[int, Figures] = {}
    tasks = [word for task, weights in FAST.items() for word in (f"--{task}", weights)]
    for size in (2, _FULL_SIZE):
        data, out = scratch / f"full-{size}", scratch / f"full-out-{size}"
        copy_frames(PACKAGED_FRAMES, data, size)
        shards = out / "shards"
        words: list[object] = ["shard", data, shards, "--frames-per-shard", _FULL_SIZE]
        sharded[size] = measure(words, shards, workers=1)
        words = ["perceive", shards, out / "all", "--pack", *tasks]
        figures[size] = measure(words, out / "all", workers=1)
    row = per_frame(_FULL_SIZE, figures[_FULL_SIZE], (2, figures[2]))
    read = per_frame(_FULL_SIZE, sharded[_FULL_SIZE], (2, sharded[2]))
    return {**row, "frame_bytes": read["bytes"]}


def copy_frames(source: Path, target: Path, size: int) -> None:
    """Link the frames of an object tree under `size` names, one after the other."""
    names = sorted(path.stem for path in (source / "training" / "calib").iterdir())
    for folder in sorted((source / "training").iterdir()):
        (target / "training" / folder.name).mkdir(parents=True)
        files = {path.stem: path for path in folder.iterdir()}
        for number in range(size):
            file = files[names[number % len(names)]]
            copy = target / "training" / folder.name / f"{number:06d}{file.suffix}"
            shutil.copyfile(file, copy)


def measure(words: list[object], out: Path, *, workers: int) -> Figures:
    """Run a command to its end, and look at its processes from time to time; Linux only."""
    command = [sys.executable, "-m", "sightline", *map(str, words)]
    if words[0] != "evaluate":
        command += ["--workers", str(workers)]
    begun_s = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    peak_mib, open_files = 0.0, 0
    while True:
        number, status, usage = os.wait4(process.pid, os.WNOHANG)
        if number:
            break
        family = _family(process.pid)
        peak_mib = max(peak_mib, sum(map(_resident_mib, family)))
        open_files = max(open_files, sum(map(_open_files, family)))
        time.sleep(_POLL_S)
    assert process.stderr is not None
    if status:
        raise ValueError(f"{' '.join(command)} failed: {process.stderr.read().decode()}")
    process.stderr.close()
    return {
        "processor_s": usage.ru_utime + usage.ru_stime,  # with those of its workers
        "wall_s": time.monotonic() - begun_s,
        "peak_mib": peak_mib,
        "open_files": open_files,
        "bytes": sum(path.stat().st_size for path in (out, *out.rglob("*")) if path.is_file()),
    }


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
