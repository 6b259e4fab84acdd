"""Record of a benchmark run: results, and everything needed to run it again."""

import hashlib
import json
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path

from sightline.files.weights_header import find_weights

PACKAGES = (
    "torch",
    "numpy",
    "numba",
    "scipy",
    "opencv-python-headless",
    "openvino",
    "onnxruntime",
    "shapely",
    "embreex",
    "fpsample",
)
_FOLDERS = re.compile(r"[^\s='\"\[,]*/(?=[^/])")


def _git(*arguments: str) -> str | None:
    """Run git in this repository; None without git or outside a clone."""
    words = ["git", "-C", str(Path(__file__).parent), *arguments]
    try:
        completed = subprocess.run(words, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return completed.stdout.strip()


def _state() -> dict[str, str | bool]:
    changed = _git("status", "--porcelain", "--untracked-files=no")
    commit = _git("rev-parse", "--short=7", "HEAD") or "unknown"
    return {"commit": commit, "dirty": changed is None or changed != ""}


_STATE = _state()
"""Commit and whether tracked files differ from it, at the start of the run."""


def print_record(
    content: Mapping[str, object], *, seed: int | None, weights: Iterable[str | Path] = ()
) -> None:
    """Print the record as one line of JSON, to be kept in `benchmarks/results`.

    Args:
        content: Settings and results.
        seed: Seed of the run; None: nothing is drawn.
        weights: Names or files of the trained weights in the run; those of untrained networks are
            left out.
    """
    record = {
        "command": command(sys.argv),
        **_STATE,
        "date": time.strftime("%Y-%m-%d"),
        "seed": seed,
        "weights": {Path(each).stem: digest(find_weights(each)) for each in weights},
        "machine": describe_machine(),
    }
    print(json.dumps({**record, **content}))


def command(arguments: list[str]) -> str:
    """Give the command line without the folders of this machine."""
    words = [f"python -m benchmarks.{Path(arguments[0]).stem}"]
    words += [_FOLDERS.sub("", argument).rstrip("/") for argument in arguments[1:]]
    return " ".join(words)


def digest(path: Path) -> str:
    """Compute the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def describe_machine() -> dict[str, str | int]:
    """Describe processor, cores and versions; no host name and no folders."""
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return {
        "processor": _processor(),
        "cores": _cores(),
        "system": platform.system(),
        "python": platform.python_version(),
        **versions,
    }


def _processor() -> str:
    cpu_info = Path("/proc/cpuinfo")
    if cpu_info.is_file():
        for line in cpu_info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _cores() -> int:
    """Count the cores that this process may use, or all if the system does not report it."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
