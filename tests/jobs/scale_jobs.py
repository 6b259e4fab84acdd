"""Jobs over small frames whose programs, workers or machines are killed: run as a module.

`python -m tests.jobs.scale_jobs DATA OUT DRIVER WORKERS DELAY_S [SHARD_INDEX NUM_SHARDS]`
"""

import hashlib
import os
import signal
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import torch

from sightline.depth_completion.registration import TASK
from sightline.geometry.projection import sparse_depth_map
from sightline.inference.predict import predict
from sightline.jobs.crew import Driver
from sightline.jobs.run import JobResult
from sightline.structures.predictions import DepthMap
from sightline.structures.sample import CameraLidarSample

DEADLY = "000003"
"""Frame that kills its worker where `Sparse.deadly` is set."""


@dataclass(frozen=True)
class Sparse:
    """Predictor whose depth is the projected sweep: quick, and different for each frame."""

    delay_s: float = 0.0
    deadly: bool = False
    name: str = "sparse"
    parts: tuple[str, ...] = ("points",)
    needs: tuple[str, ...] = ()
    gives: tuple[str, ...] = ("depth",)
    made_by: dict[str, str] = field(default_factory=lambda: {"version": "1"})

    def __call__(self, sample: CameraLidarSample) -> DepthMap:
        time.sleep(self.delay_s)
        if self.deadly and sample.sample_id == DEADLY:
            os.kill(os.getpid(), signal.SIGKILL)
        torch.set_num_threads(1)
        depth_m = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
        return DepthMap(depth_m=depth_m, valid=depth_m > 0)


def run(
    data: Path,
    out: Path,
    driver: Driver = "local",
    workers: int = 1,
    delay_s: float = 0.0,
    shard_index: int = 0,
    num_shards: int = 1,
    **settings: bool,
) -> JobResult:
    """Predict the depth of all frames."""
    return predict(
        TASK,
        Sparse(delay_s, **settings),
        data,
        out,
        workers=workers,
        driver=driver,
        shard_index=shard_index,
        num_shards=num_shards,
    )


def digest(folder: Path) -> str:
    """Checksum over the names and bytes of all files that are not hidden."""
    total = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.name.startswith("."):
            total.update(f"{path.relative_to(folder)} {path.stat().st_size}\n".encode())
            total.update(path.read_bytes())
    return total.hexdigest()


def main(data: str, out: str, driver: Driver, workers: str, delay_s: str, *shard: str) -> None:
    """Run a job from the command line."""
    print(run(Path(data), Path(out), driver, int(workers), float(delay_s), *map(int, shard)))


if __name__ == "__main__":
    main(*sys.argv[1:])
