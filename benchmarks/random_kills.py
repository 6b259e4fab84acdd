"""Random kills of a job over many frames: `python -m benchmarks.random_kills SCRATCH`.

A job of two workers predicts many small frames. Again and again, after a random number of further
files, one of its workers is killed (SIGKILL), or the whole job with all workers, which is then
started again. At the end the bytes of all files are compared with those of an undisturbed job. Its
last line is kept in benchmarks/results/random_kills.json.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Final

import jsonargparse

from benchmarks.record import print_record
from tests.inference.trees import write_object_tree
from tests.jobs.scale_jobs import digest, run

_POLL_S: Final = 0.02
_PROGRAM_SHARE: Final = 0.1  # of the kills; a start of the program takes seconds


def main(scratch: Path, frames: int = 10_000, kills: int = 100, seed: int = 0) -> None:
    """Print the result, then one line of JSON.

    Args:
        scratch: Empty folder for frames and results, which are removed.
        frames: Number of frames.
        kills: Number of kills.
        seed: Seed of the moments and the victims.
    """
    scratch = scratch.absolute()
    data, out, expected = (scratch / name for name in ("data", "out", "expected"))
    write_object_tree(data, frames, num_points=20)
    run(data, expected)
    draw = random.Random(seed)
    every = frames // (kills + 1)
    job = _start(data, out)
    killed = {"workers": 0, "programs": 0}
    for _ in range(kills):
        _wait(job, out, _count(out) + draw.randint(1, every))
        workers = _children(job.pid)
        if draw.random() < _PROGRAM_SHARE or not workers:
            os.killpg(job.pid, signal.SIGKILL)
            job.wait()
            job = _start(data, out)
            killed["programs"] += 1
        else:
            os.kill(draw.choice(workers), signal.SIGKILL)
            killed["workers"] += 1
    status = job.wait()
    is_equal = digest(out) == digest(expected)
    print(f"{frames} frames, killed {killed}: status {status}, bytes equal: {is_equal}")
    shutil.rmtree(scratch)
    setting = {"frames": frames, "killed": killed, "status": status, "equal": is_equal}
    print_record(setting, seed=seed)
    sys.exit(not is_equal or status)


def _start(data: Path, out: Path) -> subprocess.Popen[bytes]:
    words = [sys.executable, "-m", "tests.jobs.scale_jobs", str(data), str(out)]
    words += ["local", "2", "0"]
    return subprocess.Popen(words, start_new_session=True, stderr=subprocess.DEVNULL)


def _wait(job: subprocess.Popen[bytes], out: Path, number: int) -> None:
    while _count(out) < number:
        if job.poll() is not None:
            raise ValueError(f"the job ended with status {job.returncode} at {_count(out)} files")
        time.sleep(_POLL_S)


def _count(out: Path) -> int:
    return sum(name.endswith(".png") for name in os.listdir(out)) if out.is_dir() else 0  # noqa: PTH208


def _children(process: int) -> list[int]:
    listed = Path(f"/proc/{process}/task/{process}/children").read_text()
    return [int(number) for number in listed.split()]


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
