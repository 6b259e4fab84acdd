"""Processor time of each part of the page's answer, and the page's weight.

python -m benchmarks.page_latency [--states 20] [--engine auto]

Each state turns the LiDAR by another angle, as the slider does, so nothing is taken from memory.
Processor time of one core is hardly changed by other jobs; two workers share the parts.
"""

import argparse
import time
from importlib.resources import files
from typing import get_args

import cv2
import numpy as np
import torch

import sightline
from sightline.app.parts import PartMaker, PartName, Task
from sightline.app.state import parse_state
from sightline.jobs.pool import one_blas_thread
from sightline.simulation.packaged import PACKAGED_FRAMES

_FIRST_DEG = 0.5
_STEP_DEG = 0.05


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--states", type=int, default=20)
    parser.add_argument("--engine", default="auto")
    given = parser.parse_args()
    cv2.setNumThreads(0)
    torch.set_num_threads(1)
    one_blas_thread()
    dataset = sightline.open_dataset(
        PACKAGED_FRAMES, parts=("image", "points", "objects"), needs=()
    )
    maker = PartMaker(dataset, PACKAGED_FRAMES, given.engine)
    times: dict[str, list[float]] = {name: [] for name in get_args(PartName)}
    for number in range(given.states + 1):
        state = parse_state(f"yaw={_FIRST_DEG + number * _STEP_DEG:.2f}", dataset.sample_ids)
        found: dict[str, bytes] = {}
        for name in get_args(PartName):
            start = time.process_time()
            task = Task(
                part=name,
                state=state,
                found=(found.get("detection2d", b""), found.get("detection3d", b"")),
            )
            found[name] = maker.make(task).found
            if number:  # the first one starts the networks
                times[name].append(1000 * (time.process_time() - start))
    whole = np.sum(list(times.values()), axis=0)
    for name, each in {**times, "all": whole.tolist()}.items():
        print(f"{name}: median {np.median(each):.0f} ms, 95th {np.quantile(each, 0.95):.0f} ms")
    static = files("sightline.app").joinpath("static")
    weight = sum(len(each.read_bytes()) for each in static.iterdir())
    print(f"page without data: {weight / 1000:.0f} kB")


if __name__ == "__main__":
    main()
