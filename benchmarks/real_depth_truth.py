"""Scores depth completion by real truth: `python -m benchmarks.real_depth_truth --data TRUTH`.

TRUTH is in the layout of KITTI's selection for depth completion (`val_selection_cropped`), with two
folders beside it for fewer beams: `sweeps/NNNNNN.bin`, in KITTI's ring order, and
`calib/NNNNNN.txt`, in KITTI's object format; and `groundtruth_depth_all`, truth with moving cars.
KITTI stereo 2015's training frames, their disparity turned into depth, can be laid out so.

With 64 beams a method gets the selection's own sparse maps; with fewer, every second, fourth or
eighth ring of the sweep. Its last line is kept in benchmarks/results/real_depth_truth.json.
"""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jsonargparse
import numpy as np
import torch

from benchmarks.record import print_record
from sightline.data.formats.image_file import read_rgb
from sightline.data.formats.kitti_calibration import read_intrinsics
from sightline.data.formats.kitti_files import read_object_calibration
from sightline.data.formats.map_png import read_depth_png
from sightline.data.formats.rings import NUM_RINGS, ring_numbers
from sightline.depth_completion.method_names import Method
from sightline.depth_completion.methods import complete_depth
from sightline.depth_completion.predictor import DepthPredictor
from sightline.evaluation.depth_breakdown import (
    bands,
    error_sums,
    lost_returns,
    paired_difference,
)
from sightline.evaluation.depth_scores import fill_gaps
from sightline.geometry.projection import sparse_depth_map

BANDS_M = (10.0, 20.0, 40.0, 90.0)
METHODS: tuple[Method, ...] = ("linear", "classical", "adaptive")
WEIGHTS = ("depth-fast-cpu", "depth-best")
AGAINST = "classical"
"""Reference method of the comparison, frame by frame."""
BEAMS = (64, 32, 16, 8)

Frame = dict[str, Any]
Complete = Callable[[np.ndarray, np.ndarray], np.ndarray]


def main(data: Path, beams: tuple[int, ...] = BEAMS, seed: int = 0) -> None:
    """Print a row for each method and number of beams, then one line of JSON.

    Args:
        data: Folder with `val_selection_cropped`, `sweeps` and `calib`.
        beams: Numbers of beams; each divides 64.
        seed: Seed of the intervals' resampling.
    """
    torch.set_num_threads(1)
    frames = [_read_frame(data, path) for path in _truth_files(data)]
    results = [
        {"beams": number, **row}
        for number in beams
        for row in _rows([_with_beams(frame, number) for frame in frames], seed)
    ]
    setting = {"frames": len(frames), "bands_m": BANDS_M, "against": AGAINST}
    print_record({**setting, "results": results}, seed=seed, weights=WEIGHTS)


def _rows(frames: list[Frame], seed: int) -> list[dict[str, Any]]:
    """Score every method on frames of one number of beams."""
    completers: dict[str, Complete] = {name: _by_method(name) for name in METHODS}
    completers |= {name: _by_network(name) for name in WEIGHTS}
    maps = {
        name: [fill_gaps(complete(frame["sparse"], frame["image"])) for frame in frames]
        for name, complete in completers.items()
    }
    rows = []
    for name, depths in maps.items():
        row: dict[str, Any] = {"method": name}
        for truth in ("standing", "with_cars"):
            errors = [_errors(d, f[truth]) for d, f in zip(depths, frames, strict=True)]
            others = [_errors(d, f[truth]) for d, f in zip(maps[AGAINST], frames, strict=True)]
            sums = [
                error_sums(d, f[truth], band_ends_m=BANDS_M, sparse_m=f["sparse"])
                for d, f in zip(depths, frames, strict=True)
            ]
            total = sum(sums[1:], start=sums[0])
            rmse, mae, median = np.mean(errors, axis=0)
            row[truth] = {
                "rmse_mm": round(rmse, 1),
                "mae_mm": round(mae, 1),
                "median_mm": round(median, 1),
                "bands": [asdict(band) for band in bands(total, BANDS_M, places=True)],
                "lost": asdict(lost_returns(total)),
                "difference": [
                    asdict(
                        paired_difference(
                            score,
                            [each[place] for each in errors],
                            [each[place] for each in others],
                            seed=seed,
                        )
                    )
                    for place, score in enumerate(("RMSE", "MAE"))
                ],
            }
        _print(len(frames), frames[0]["beams"], row)
        rows.append(row)
    return rows


def _by_method(name: Method) -> Complete:
    return lambda sparse, _: complete_depth(sparse, name).depth_m.numpy()


def _by_network(weights: str) -> Complete:
    predictor = DepthPredictor.load(weights)
    return lambda sparse, image: predictor.complete(sparse, image).depth_m.numpy()


def _print(count: int, beams: int, row: dict[str, Any]) -> None:
    cells = []
    for truth in ("standing", "with_cars"):
        scores = row[truth]
        by_band = " ".join(
            f"{band['rmse_mm']:.0f}/{band['mae_mm']:.0f}"
            for band in scores["bands"][: len(BANDS_M)]
        )
        cells.append(
            f"{scores['rmse_mm']:5.0f} / {scores['mae_mm']:4.0f} / {scores['median_mm']:3.0f} "
            f"({by_band})"
        )
    lost = row["standing"]["lost"]
    low, high = (row["standing"]["difference"][0][end] for end in ("low", "high"))
    print(
        f"{beams:2} beams, {count} frames, {row['method']:<15} standing {cells[0]}, "
        f"with cars {cells[1]}, lost {lost['lost_share']:.2%} {lost['lost_share_beyond_40m']:.1%}, "
        f"RMSE less {AGAINST}'s [{low:+.0f}, {high:+.0f}]",
        flush=True,
    )


def _errors(depth_m: np.ndarray, truth_m: np.ndarray) -> tuple[float, float, float]:
    """Compute RMSE, MAE and median of the absolute errors of one image [mm]."""
    scored = truth_m > 0
    errors = np.abs(depth_m - truth_m)[scored].astype(np.float64) * 1e3
    return float(np.sqrt((errors**2).mean())), float(errors.mean()), float(np.median(errors))


def _truth_files(data: Path) -> list[Path]:
    return sorted((data / "val_selection_cropped" / "groundtruth_depth").glob("*.png"))


def _read_frame(data: Path, truth: Path) -> Frame:
    selection = data / "val_selection_cropped"
    number = int(truth.name.split("_")[3])
    image_name = truth.name.replace("groundtruth_depth", "image")
    return {
        "image": read_rgb(selection / "image" / image_name),
        "measured": read_depth_png(
            selection / "velodyne_raw" / truth.name.replace("groundtruth_depth", "velodyne_raw")
        ),
        "standing": read_depth_png(truth),
        "with_cars": read_depth_png(data / "groundtruth_depth_all" / truth.name),
        "points": np.fromfile(data / "sweeps" / f"{number:06d}.bin", "<f4").reshape(-1, 4),
        "calibration": read_object_calibration(data / "calib" / f"{number:06d}.txt"),
        "intrinsics": read_intrinsics(
            selection / "intrinsics" / image_name.replace(".png", ".txt")
        ),
    }


def _with_beams(frame: Frame, beams: int) -> Frame:
    """Give the frame the sparse map of a number of beams."""
    if beams == NUM_RINGS:
        return {**frame, "sparse": frame["measured"], "beams": beams}
    step = NUM_RINGS // beams
    points = frame["points"][ring_numbers(frame["points"]) % step == (step // 2 if step > 2 else 0)]
    # The selection is cut from the image of the calibration; its intrinsics give the offset.
    height, width = frame["measured"].shape
    principal = frame["calibration"].image_from_camera[:2, 2].numpy()
    left, top = np.round(principal - frame["intrinsics"][:2, 2]).astype(int).tolist()
    whole = sparse_depth_map(
        torch.from_numpy(points), frame["calibration"], (top + height, left + width)
    )
    return {**frame, "sparse": whole[top:, left:].contiguous().numpy(), "beams": beams}


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)
