"""Scoring of depth completion under sensor faults, on held-out LiDAR rings or simulated depth.

The truth is the same for all faults; only the input gets worse. Rings are held out first and the
rest is corrupted afterwards, so the input contains no truth and the truth no faults.
"""

import json
import statistics
from dataclasses import asdict
from pathlib import Path
from typing import Final, Never

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.layouts.kitti_trees import Part
from sightline.evaluation.held_out import depth_map_errors
from sightline.evaluation.held_out_frame import (
    check_for_sweeps,
    check_rings,
    split_depth,
    split_rings,
)
from sightline.files.atomic import atomic_write_text
from sightline.files.plain_text import read_text
from sightline.files.problem import REMAKE, FileError
from sightline.geometry.projection import sparse_depth_map
from sightline.jobs.output_dirs import finished_names
from sightline.robustness.record import number_or_none
from sightline.robustness.scoring import BenchFrame, BenchMetric, BenchPrediction, Panel, Scores
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.canvas import scaled_to_width
from sightline.visualization.depth import colorize_depth
from sightline.visualization.image import camera_picture

_METRICS: Final = {"rmse_mm": "RMSE", "mae_mm": "MAE", "median_mm": "median absolute error"}


class HeldOutScoring:
    """`Scoring` by the held-out-rings protocol, with all beams of the sensor.

    An output without any depth, such as with a dead LiDAR, is scored as 0 m everywhere.
    """

    name = "held-out rings"
    suffix = ".json"
    parts: tuple[Part, ...] = ("points",)
    takes_results = False
    metrics = tuple(
        BenchMetric(name=name, title=title, unit="mm") for name, title in _METRICS.items()
    )

    def check(self, dataset: SampleDataset) -> None:
        """Check for sweeps with rings; see `Scoring.check`."""
        check_for_sweeps(dataset)

    def notes(self, dataset: SampleDataset) -> tuple[str, ...]:
        """Return no notes: errors are means over the many pixels of every frame."""
        del dataset
        return ()

    def prepare(self, sample: CameraLidarSample) -> BenchFrame:
        """Separate the input rings, cropped by the protocol, from the truth."""
        frame = split_rings(sample)
        check_rings(frame)
        return BenchFrame(frame.with_beams(frame.sensor_beams), frame.truth_m)

    def store(self, path: Path, prediction: BenchPrediction) -> None:
        """Write the frame's errors."""
        sample, truth_m = prediction.frame
        place = f"sample {sample.sample_id}"
        errors = depth_map_errors(truth_m, prediction.output, place, zero_where_nothing=True)
        atomic_write_text(path, json.dumps(asdict(errors)) + "\n")

    def finished(self, folder: Path) -> frozenset[str]:
        """List the frames with a file; see `ResultWriter.finished`."""
        return finished_names(folder, self.suffix)

    def read(self, path: Path, sample: CameraLidarSample) -> Never:
        """Not supported: the files hold errors, not outputs; see `Scoring.read`."""
        del sample
        raise FileError(path, "holds a frame's errors and no depth", "draw the prediction itself")

    def score(self, folder: Path, dataset: SampleDataset) -> Scores:
        """Average the errors over the frames."""
        rows = [_read(folder / f"{name}{self.suffix}") for name in dataset.sample_ids]
        return {name: statistics.fmean(row[at] for row in rows) for at, name in enumerate(_METRICS)}

    def draw(self, prediction: BenchPrediction, width_px: int) -> tuple[Panel, ...]:
        """Draw the image and the sweep of the input, and the completed depth."""
        sample, depth_map = prediction.corrupted.sample, prediction.output
        panels = [Panel("image", camera_picture(sample))]
        if sample.points is not None:
            sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
            panels.append(Panel("sweep", colorize_depth(sparse, point_size_px=5)))
        panels.append(Panel("completed depth", colorize_depth(depth_map.depth_m * depth_map.valid)))
        return tuple(Panel(name, scaled_to_width(picture, width_px)) for name, picture in panels)


class SimulatedDepthScoring(HeldOutScoring):
    """`Scoring` by the simulated depth below the highest return: the LiDAR needs no rings."""

    name = "simulated depth in reach"
    parts: tuple[Part, ...] = ("points", "depth")

    def check(self, dataset: SampleDataset) -> None:
        """Accept every data set: no rings are held out."""
        del dataset

    def prepare(self, sample: CameraLidarSample) -> BenchFrame:
        """Separate the input, cropped as for held-out rings, from the depth map."""
        return BenchFrame(*split_depth(sample))


def _read(path: Path) -> tuple[float, ...]:
    """Read a frame's metrics as a tuple, which takes less memory than the file's contents."""
    try:
        row = json.loads(read_text(path))
        numbers = [number_or_none(row[name]) for name in _METRICS]
        known = tuple(number for number in numbers if number is not None)
        if len(known) < len(_METRICS):
            raise ValueError("a metric is null")
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        if isinstance(error, FileError):
            raise
        raise FileError(path, "does not hold a frame's errors", REMAKE) from error
    return known
