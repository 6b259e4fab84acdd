"""Figures of a running command, looked at from outside: processor time, memory, files. Linux only.

Processor times are those of a process and all below it, so that other programs on the machine
change them little; their use of the machine is noted, too, for wall times.
"""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

_POLL_S: Final = 0.1
_TICKS: Final = os.sysconf("SC_CLK_TCK")
_SMALL: Final = (
    *("--image-size", "310,94", "--focal-px", "180", "--lidar", "vlp-16"),
    *("--velodyne", "velodyne_reduced"),
)
"""Options of `simulate`: a quarter of KITTI's sides, few points."""
_NUM_DIFFERENT: Final = 10
"""Number of simulated frames, which stand under many names."""
FAST: Final = {
    "depth-completion": "depth-fast-cpu",
    "detection2d": "detection2d-fast-cpu",
    "detection3d": "detection3d-fast-cpu",
}
"""Weights by task."""


class Job(NamedTuple):
    """A command, and the files by which its progress is seen."""

    words: Sequence[object]
    out: Path
    pattern: str
    """Pattern of the files that are finished last."""
    per_file: int = 1
    """Number of frames of such a file."""


class Figures(NamedTuple):
    """State of a running command."""

    frames: int
    """Number of finished frames."""
    wall_s: float
    """Time since the command's start."""
    processor_s: float
    others_s: float
    """Processor time of all other programs since the command's start."""
    mib: float
    """Memory without mapped files, such as libraries' code, which other programs share or not."""
    open_files: int
    num_bytes: int
    """Bytes of the files that were written."""


def command(words: Sequence[object]) -> list[str]:
    """Give the whole command line of a command of Sightline."""
    return [sys.executable, "-m", "sightline", *map(str, words)]


def run(words: Sequence[object]) -> None:
    """Run a command to its end, without its output."""
    subprocess.run(command(words), check=True, capture_output=True)


def measure(job: Job, marks: Sequence[int]) -> list[Figures]:
    """Run a command, note its figures when it has finished so many frames, then end it.

    Raises:
        ValueError: The command ends before all marks were seen.
    """
    noted: list[Figures] = []
    watch = Watch(job.words)
    while len(noted) < len(marks) and watch.process.poll() is None:
        done = sum(1 for _ in job.out.glob(job.pattern)) * job.per_file
        is_new = not noted or done > noted[-1].frames
        if done >= marks[len(noted)] and is_new:
            noted.append(watch.figures(done, job.out))
        time.sleep(_POLL_S)
    if len(noted) < len(marks):
        raise ValueError(
            f"{' '.join(map(str, job.words))} ended with status {watch.process.returncode} after "
            f"{len(noted)} of {len(marks)} marks"
        )
    watch.process.terminate()
    watch.process.wait()
    return noted


def measure_whole(
    words: Sequence[object], *, frames: int, look: Callable[[], None] = lambda: None
) -> Figures:
    """Run a command of one process to its end; memory and open files are the largest seen.

    `look` is called often while it runs.

    Raises:
        ValueError: The command fails.
    """
    watch = Watch(words)
    largest = watch.figures(frames)
    while True:
        number, status, used = os.wait4(watch.process.pid, os.WNOHANG)
        if number:
            break
        look()
        seen = watch.figures(frames)
        open_files, mib = max(seen.open_files, largest.open_files), max(seen.mib, largest.mib)
        largest = seen._replace(mib=mib, open_files=open_files)
        time.sleep(_POLL_S)
    if status:
        raise ValueError(f"{' '.join(map(str, words))} ended with status {status}")
    return largest._replace(processor_s=used.ru_utime + used.ru_stime)


class Watch:
    """Running command, looked at from outside."""

    def __init__(self, words: Sequence[object]) -> None:
        """Start the command, without its output."""
        self._begun_s, self._begun_busy_s = time.monotonic(), _busy_s()
        self.process = subprocess.Popen(
            command(words), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )

    def figures(self, frames: int, out: Path | None = None) -> Figures:
        """Note the figures of this moment; `out` is the folder of the files it writes."""
        family = family_of(self.process.pid)
        wall_s, processor_s = time.monotonic() - self._begun_s, sum(map(processor_s_of, family))
        return Figures(
            frames=frames,
            wall_s=wall_s,
            processor_s=processor_s,
            others_s=_busy_s() - self._begun_busy_s - processor_s,
            mib=sum(map(memory_mib_of, family)),
            open_files=sum(map(_num_open_files, family)),
            num_bytes=0 if out is None else _num_bytes(out),
        )


def beyond(mark: int) -> int:
    """Give the number of frames for a job whose last mark must not be its end."""
    return mark + mark // 20 + 10


def simulate_frames(folder: Path, size: int, *, seed: int) -> Path:
    """Write `size` small frames, a few simulated ones under many names; returns their folder."""
    few, data = folder / "few", folder / "data"
    run(["simulate", few, "--frames", _NUM_DIFFERENT, "--seed", seed, *_SMALL])
    copy_frames(few, data, size)
    return data


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


def jobs(data: Path, out: Path, *, size: int, seed: int, workers: int) -> dict[str, Job]:
    """Commands over small frames by their names; `size` is the number of frames to simulate."""
    street, shards, cases, found, together = (
        out / name for name in ("street", "shards", "corrupted", "found", "all")
    )
    simulate = ["simulate", street, "--frames", size, "--seed", seed, *_SMALL]
    pack = ["shard", data, shards, "--frames-per-shard", 10]
    corrupt = ["corrupt", data, cases, "--cases", "camera_blank", "lidar_blank"]
    predict = ["predict", "detection2d", data, found, "--weights", FAST["detection2d"]]
    found_jobs = {
        "simulate": Job(simulate, street, "training/calib/*.txt"),
        "shard": Job(pack, shards, "0*.json", per_file=10),
        "corrupt": Job(corrupt, cases, "lidar_blank/training/velodyne_reduced/*.bin"),
        "predict": Job(predict, found, "*.txt"),
        "perceive": perceive_job(data, together),
    }
    by = ("--workers", workers)
    return {name: job._replace(words=[*job.words, *by]) for name, job in found_jobs.items()}


def perceive_job(data: Path, out: Path) -> Job:
    """Command `perceive` with the fast weights."""
    tasks = [word for task, weights in FAST.items() for word in (f"--{task}", weights)]
    return Job(["perceive", data, out, *tasks], out, "lines/*.json")


def family_of(process: int) -> list[int]:
    """Numbers of a process and all below it."""
    try:
        listed = Path(f"/proc/{process}/task/{process}/children").read_text()
    except OSError:
        return []
    return [process, *(each for child in listed.split() for each in family_of(int(child)))]


def processor_s_of(process: int) -> float:
    """Processor time of a process, and of those below it that have ended."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / _TICKS


def _busy_s() -> float:
    """Processor time of all programs of the machine: user, nice, system, interrupts."""
    fields = Path("/proc/stat").read_text().splitlines()[0].split()[1:8]
    user, nice, system, _, _, *interrupts = map(int, fields)
    return (user + nice + system + sum(interrupts)) / _TICKS


def memory_mib_of(process: int) -> float:
    """Memory of a process without mapped files; pages that several share count in parts."""
    try:
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0.0
    kinds = ("Pss_Anon:", "Pss_Shmem:")
    return sum(int(line.split()[1]) for line in lines if line.startswith(kinds)) / 1024


def _num_bytes(folder: Path) -> int:
    """Sum up the sizes of all files of a folder; temporary ones and their folders may vanish."""
    total = 0
    for parent, _, names in os.walk(folder):
        for name in names:
            with suppress(FileNotFoundError):
                total += Path(parent, name).stat().st_size
    return total


def _num_open_files(process: int) -> int:
    try:
        return len(list(Path(f"/proc/{process}/fd").iterdir()))
    except OSError:
        return 0
