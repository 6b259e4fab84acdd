"""What a benchmark ran on, for the record beside its figures."""

import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path

PACKAGES = (
    "torch",
    "numpy",
    "numba",
    "scipy",
    "opencv-python-headless",
    "shapely",
    "embreex",
    "fpsample",
)


def describe_machine() -> dict[str, str | int | bool]:
    """Processor, cores, versions and commit; nothing that names the machine or its folders."""
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    changed = _git("status", "--porcelain", "--untracked-files=no")
    return {
        "processor": _processor(),
        "cores": _cores(),
        "system": platform.system(),
        "python": platform.python_version(),
        **versions,
        "commit": _git("rev-parse", "--short", "HEAD") or "unknown",
        "dirty": changed is None or changed != "",
    }


def _processor() -> str:
    facts = Path("/proc/cpuinfo")
    if facts.is_file():
        for line in facts.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _cores() -> int:
    """Those this process may use, where the system tells; else all."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _git(*arguments: str) -> str | None:
    """What git answers in this repository; None without git or outside a clone."""
    command = ["git", "-C", str(Path(__file__).parent), *arguments]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return answer.stdout.strip()
