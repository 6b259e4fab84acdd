"""Time of KITTI's object evaluation, files included.

`python -m benchmarks.kitti_evaluation --labels labels_7481.tar.gz --sample_list val.txt`: each
frame of the list against jittered copies of its own objects with clutter, all classes, by all four
measures. "process" starts a fresh interpreter, compiled code cached; "call" is the evaluation
alone in a warm one.
"""

import statistics
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jsonargparse
import numpy as np

from benchmarks.record import print_record
from sightline.data.formats.kitti_labels import KittiObjects, read_labels, write_objects
from sightline.data.layouts.frame_lists import read_sample_list
from sightline.evaluation.kitti_object import evaluate_objects

_PROCESS = """
import sys
from pathlib import Path
from sightline.evaluation.kitti_object import evaluate_objects
evaluate_objects(Path(sys.argv[1]), Path(sys.argv[2]), sample_list=sys.argv[3])
"""


def main(labels: Path, sample_list: Path, copies: int = 2, repeats: int = 5) -> None:
    """Print a table, then one line of JSON.

    Args:
        labels: Folder of label files, or an archive that holds one named label_2.
        sample_list: Text file with the frames, one a line.
        copies: Detections made of each labelled object.
        repeats: Runs of each kind; the median counts.
    """
    with tempfile.TemporaryDirectory() as scratch:
        if labels.is_file():
            with tarfile.open(labels) as archive:
                members = [each for each in archive if each.name.startswith("label_2/")]
                archive.extractall(scratch, members, filter="data")
            labels = Path(scratch) / "label_2"
        results = Path(scratch) / "results"
        names = read_sample_list(sample_list, labels)
        generator = np.random.default_rng(0)
        num_detections = sum(
            _write_jittered(generator, name, labels, results, copies) for name in names
        )
        command = [sys.executable, "-c", _PROCESS, str(results), str(labels), str(sample_list)]
        # Compiles, and fills file caches.
        report = evaluate_objects(results, labels, sample_list=sample_list)
        timings = {
            "call": _time(
                repeats, lambda: evaluate_objects(results, labels, sample_list=sample_list)
            ),
            "process": _time(repeats, lambda: subprocess.run(command, check=True)),
        }
    print(f"{len(names):,} frames, {num_detections:,} detections, {len(report.entries)} entries")
    rows = [{"run": run, **_summary(seconds)} for run, seconds in timings.items()]
    for row in rows:
        print(f"{row['run']:>8} {row['median_s']:6.2f} s  (IQR {row['iqr_s']:.2f})")
    settings = {"frames": len(names), "detections": num_detections, "entries": len(report.entries)}
    print_record({**settings, "results": rows}, seed=0)


def _write_jittered(
    generator: np.random.Generator, name: str, labels: Path, results: Path, copies: int
) -> int:
    """Write a frame's result file of jittered copies of its objects, and return their number."""
    truth = read_labels(labels / f"{name}.txt")
    kept = [i for i, kind in enumerate(truth.class_names) if kind != "DontCare"]
    chosen = np.repeat(np.array(kept, dtype=np.int64), copies)

    def jitter(values: np.ndarray, spread: float) -> np.ndarray:
        return values[chosen] + generator.normal(scale=spread, size=values[chosen].shape)

    found = KittiObjects(
        class_names=tuple(truth.class_names[i] for i in chosen),
        truncation=np.full(len(chosen), -1.0),
        occlusion=np.full(len(chosen), -1.0),
        alpha=jitter(truth.alpha, 0.1),
        boxes2d=jitter(truth.boxes2d, 3.0),
        dimensions_hwl=np.abs(jitter(truth.dimensions_hwl, 0.05)),
        locations=jitter(truth.locations, 0.15),
        rotation_y=jitter(truth.rotation_y, 0.05),
        scores=generator.normal(size=len(chosen)),
    )
    # every tenth detection is clutter, far from its object
    clutter = generator.random(len(chosen)) < 0.1
    found = replace(found, locations=found.locations + 20.0 * clutter[:, None])
    write_objects(results / f"{name}.txt", found)
    return len(chosen)


def _time(repeats: int, run: Callable[[], object]) -> list[float]:
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - start)
    return seconds


def _summary(seconds: list[float]) -> dict[str, float]:
    low, _, high = statistics.quantiles(seconds, n=4)
    return {"median_s": round(statistics.median(seconds), 3), "iqr_s": round(high - low, 3)}


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)
