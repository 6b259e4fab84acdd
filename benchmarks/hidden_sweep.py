"""Depth where the LiDAR saw nothing: `python -m benchmarks.hidden_sweep --data KITTI`.

Returns of some image columns are taken away: none, the middle third, one half (left and right in
turns), or all. Truth: rings that no method sees (`sightline evaluate held-out`), over the whole
image and in the hidden columns alone; with `--truth returns` the whole sweep, of any LiDAR, for
frames without returns. Errors: mean over the frames, with the paired difference of each method from
the first one in the same state; beside them the mean error that a network itself expects there. The
last line is kept in benchmarks/results/hidden_sweep.json.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import Final, Literal

import jsonargparse
import torch

from benchmarks.record import print_record
from sightline.data.open import open_dataset
from sightline.depth_completion.predictor import DepthCompleter, DepthPredictor
from sightline.depth_completion.street_depth import street_depth
from sightline.evaluation.depth_breakdown import paired_difference
from sightline.evaluation.held_out import HeldOutErrors, depth_map_errors
from sightline.evaluation.held_out_frame import HeldOutFrame, split_rings
from sightline.export.names import EngineName
from sightline.geometry.projection import project_points, sparse_depth_map
from sightline.structures.predictions import DepthMap
from sightline.structures.sample import CameraLidarSample


@dataclass(frozen=True)
class _Scores:
    """Errors of a method in each frame, and those it expects [mm] if it does."""

    errors: list[HeldOutErrors] = field(default_factory=list)
    expected_mm: list[float] = field(default_factory=list)


Completer = Callable[[CameraLidarSample], DepthMap]
Columns = tuple[float, float]

_STATES: Final[dict[str, tuple[Columns, ...]]] = {
    "sound": ((0, 0),),
    "middle third hidden": ((1 / 3, 2 / 3),),
    "half hidden": ((0, 1 / 2), (1 / 2, 1)),
    "no returns": ((0, 1),),
}
"""Hidden columns as shares of the image's width, in turns over the frames."""


def main(
    data: Path,
    sample_list: str | None = "sample_val",
    weights: Sequence[str] = ("depth-best", "depth-fast-cpu"),
    image_weights: str = "depth-image",
    truth: Literal["rings", "returns"] = "rings",
    engine: EngineName = "openvino",
) -> None:
    """Print errors by state and method, then one line of JSON.

    Args:
        data: KITTI object tree or recording with calibration, images and sweeps.
        sample_list: List of frames in ImageSets; None: all.
        weights: Weights that complete a sweep; each also without those for the image.
        image_weights: Weights that need no returns.
        truth: Held-out rings, or all returns: then no method gets any.
        engine: Inference engine of the networks, on one thread.
    """
    torch.set_num_threads(1)
    dataset = open_dataset(data, sample_list=sample_list, parts={"image", "points"})
    samples = (dataset[index] for index in range(len(dataset)))
    make = split_rings if truth == "rings" else _of_returns
    frames = [make(sample) for sample in samples]
    methods: dict[str, Completer] = {}
    load = partial(DepthPredictor.load, engine=engine, threads=1)
    for name in weights:
        methods[name] = alone = load(name)
        alone.image_weights = None
    methods["adaptive"] = DepthCompleter("adaptive")
    methods["a plain street"] = _plain_street
    methods[image_weights] = load(image_weights)
    for name in weights:
        methods[f"{name} with {image_weights}"] = joint = DepthPredictor.load(
            name, engine=engine, threads=1
        )
        joint.image_weights = image_weights
    rows = []
    for state in _STATES if truth == "rings" else ("no returns",):
        first: dict[str, _Scores] = {}
        for name, method in methods.items():
            scores = _score(frames, _STATES[state], method)
            first = first or scores
            rows.append(_row(state, name, scores, first))
            print(rows[-1], flush=True)
    print_record(
        {"frames": len(frames), "truth": truth, "results": rows},
        seed=0,
        weights=(*weights, image_weights),
    )


def _of_returns(sample: CameraLidarSample) -> HeldOutFrame:
    assert sample.points is not None, "the data set has sweeps"
    rings = torch.zeros(len(sample.points), dtype=torch.int64)
    truth_m = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
    return HeldOutFrame(sample=sample, rings=rings, truth_m=truth_m)


def _plain_street(sample: CameraLidarSample) -> DepthMap:
    depth_m = street_depth(sample)
    return DepthMap(depth_m=depth_m, valid=torch.zeros_like(depth_m, dtype=torch.bool))


def _score(
    frames: list[HeldOutFrame], hidden: tuple[Columns, ...], method: Completer
) -> dict[str, _Scores]:
    """Score all frames on the whole truth and on that of the hidden columns."""
    scores = {"all": _Scores(), "hidden": _Scores()}
    for index, frame in enumerate(frames):
        width = frame.sample.image_size[1]
        first, last = (share * width for share in hidden[index % len(hidden)])
        sweep = frame.sample if last == width else frame.with_beams(frame.sensor_beams)
        given = _without_columns(sweep, first, last)
        predicted = method(given)
        columns = torch.arange(width)
        truth_m = torch.where((columns >= first) & (columns < last), frame.truth_m, 0.0)
        for part, truth in (("all", frame.truth_m), ("hidden", truth_m)):
            if truth.any():
                place = frame.sample.sample_id
                scores[part].errors.append(
                    depth_map_errors(truth, predicted, place, zero_where_nothing=True)
                )
                if predicted.uncertainty_m is not None:
                    expected_m = predicted.uncertainty_m[truth > 0].mean()
                    scores[part].expected_mm.append(1000 * float(expected_m))
    return scores


def _without_columns(sample: CameraLidarSample, first: float, last: float) -> CameraLidarSample:
    assert sample.points is not None, "frames of the protocol have sweeps"
    columns = project_points(sample.points[:, :3].double(), sample.calibration).pixels[:, 0]
    is_hidden = (columns >= first - 0.5) & (columns < last - 0.5)
    return replace(sample, points=sample.points[~is_hidden])


def _row(
    state: str,
    method: str,
    scores: dict[str, _Scores],
    first: dict[str, _Scores],
) -> dict[str, object]:
    row: dict[str, object] = {"state": state, "method": method}
    for part, found in scores.items():
        errors = found.errors
        if found.expected_mm and math.isfinite(max(found.expected_mm)):  # infinite: no depth
            row[f"{part}_expected_mm"] = round(fmean(found.expected_mm), 1)
        if errors:
            for name in ("rmse_mm", "mae_mm", "median_mm"):
                row[f"{part}_{name}"] = round(fmean(getattr(each, name) for each in errors), 1)
            row[f"{part}_difference"] = asdict(
                paired_difference(
                    "RMSE",
                    [each.rmse_mm for each in errors],
                    [each.rmse_mm for each in first[part].errors],
                )
            )
    return row


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)
