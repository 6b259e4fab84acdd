"""Depth kept by `--valid-only`: `python -m benchmarks.valid_depth --data KITTI`.

Errors of the pixels that a method vouches for, and of the others, on held-out rings or on dense
truth, pooled over all frames. Of networks also by other limits of the expected error than the one
in use. Its last lines are kept in benchmarks/results/valid_depth.json.
"""

from pathlib import Path

import jsonargparse
import numpy as np
import torch

from benchmarks.record import print_record
from sightline.data.kitti_trees import Part, Velodyne
from sightline.data.open import open_dataset
from sightline.depth_completion.postprocess import TRUSTED_SHARE
from sightline.depth_completion.predictor import Completer, choose_completer
from sightline.evaluation.held_out_frame import HeldOutFrame, TruthChoice, split_rings
from sightline.export.names import EngineName
from sightline.structures.predictions import DepthMap

_IN_USE = 0.0  # stands for what the method itself calls valid
_LIMITS = (0.02, 0.05, 0.1, 0.2, 0.4)


def main(
    data: Path,
    methods: tuple[str, ...] = ("linear", "adaptive"),
    weights: tuple[str, ...] = ("depth-fast-cpu", "depth-best"),
    beams: tuple[int, ...] = (64, 16),
    sample_list: str = "sample_train",
    every: int = 1,
    max_frames: int = 1000,
    truth: TruthChoice = "rings",
    velodyne: Velodyne = "velodyne",
    engine: EngineName = "torch",
) -> None:
    """Print a table, then one line of JSON.

    Args:
        data: KITTI object tree with calibration, images and sweeps.
        methods: Methods without training.
        weights: Names or files of trained weights.
        beams: Numbers of beams that the methods get.
        sample_list: List of frames in ImageSets, or a text file with one name a line.
        every: Step between frames.
        max_frames: Maximum number of frames.
        truth: Kind of truth; see `sightline evaluate held-out`.
        velodyne: Folder of the sweeps.
        engine: Inference engine of the networks.
    """
    torch.set_num_threads(1)
    parts: set[Part] = {"image", "points"} if truth == "rings" else {"image", "points", "depth"}
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne, parts=parts)
    chosen = range(0, len(dataset), every)[:max_frames]
    completers = [choose_completer(method=method) for method in methods]
    completers += [choose_completer(weights=name, engine=engine, threads=1) for name in weights]
    found: dict[tuple[str, int, float], list[np.ndarray]] = {}
    of_image: dict[tuple[str, int, float], list[float]] = {}
    for index in chosen:
        frame = split_rings(dataset[index], truth=truth)
        for count in beams:
            for completer in completers:
                for share, (pixels, kept_share) in _pixels(frame, completer, count).items():
                    found.setdefault((completer.name, count, share), []).append(pixels)
                    of_image.setdefault((completer.name, count, share), []).append(kept_share)
    print(f"{len(chosen)} frames of {data}, truth: {truth}; RMSE / MAE / median in mm")
    print(f"{'method':<16}{'beams':>6}{'limit':>7}{'kept':>8}{'of image':>10}", end="")
    print(f"{'kept pixels':>24}{'others':>24}")
    results = []
    for (name, count, share), columns in found.items():
        error_mm, is_valid = np.concatenate(columns, axis=1)
        kept, others = (_summary(error_mm[is_valid == value]) for value in (1, 0))
        image_share = float(np.mean(of_image[name, count, share]))
        told = f"{share:g}" if share else ""
        print(
            f"{name:<16}{count:>6}{told:>7}{100 * is_valid.mean():>7.1f}%"
            f"{100 * image_share:>9.1f}%{_told(kept):>24}{_told(others):>24}"
        )
        results.append({
            "method": name, "beams": count, "limit": share or None,
            "kept_share": float(is_valid.mean()), "image_share": image_share,
            "kept_mm": kept, "others_mm": others,
        })  # fmt: skip
    setting = {"frames": len(chosen), "data": data.name, "truth": truth, "in_use": TRUSTED_SHARE}
    print_record({**setting, "results": results}, seed=None, weights=weights)


def _pixels(
    frame: HeldOutFrame, completer: Completer, beams: int
) -> dict[float, tuple[np.ndarray, float]]:
    """Compute signed errors [mm] of the pixels with truth and value, and whether each is valid.

    With the share of the image's pixels that are valid.

    By limit of the expected error, as a share of the depth; 0: the method's own.
    """
    sample = frame.with_beams(beams)
    answer: DepthMap = completer(sample)
    is_scored = (frame.truth_m > 0) & (answer.depth_m > 0)
    error_mm = 1e3 * (answer.depth_m - frame.truth_m)[is_scored].double().numpy()
    masks = {_IN_USE: answer.valid}
    if answer.uncertainty_m is not None:
        supported = choose_completer(method="adaptive")(sample).valid  # as networks take it
        for share in _LIMITS:
            masks[share] = supported & (answer.uncertainty_m < share * answer.depth_m)
    return {
        share: (
            np.stack((error_mm, mask[is_scored].numpy().astype(np.float64))),
            float(mask.double().mean()),
        )
        for share, mask in masks.items()
    }


def _summary(error_mm: np.ndarray) -> list[float] | None:
    """Compute RMSE, MAE and median of the absolute errors; None without pixels."""
    if not len(error_mm):
        return None
    size = np.abs(error_mm)
    return [round(float(x), 1) for x in (np.sqrt(np.mean(size**2)), np.mean(size), np.median(size))]


def _told(summary: list[float] | None) -> str:
    return "-" if summary is None else " / ".join(f"{x:.0f}" for x in summary)


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)
