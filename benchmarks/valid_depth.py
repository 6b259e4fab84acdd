"""Depth kept by `--valid-only`: `python -m benchmarks.valid_depth --data KITTI`.

Errors of a method's valid pixels, and of the others, on held-out rings or on dense truth, pooled
over all frames. For networks also with other limits of the expected error than the default. Its
last lines are kept in benchmarks/results/valid_depth.json.
"""

from pathlib import Path

import jsonargparse
import numpy as np
import torch

from benchmarks.record import print_record
from sightline.data.layouts.kitti_trees import Part, Velodyne
from sightline.data.open import open_dataset
from sightline.depth_completion.postprocess import TRUSTED_SHARE
from sightline.depth_completion.predictor import Completer, choose_completer
from sightline.evaluation.held_out_frame import HeldOutFrame, TruthChoice, split_rings
from sightline.export.names import EngineName
from sightline.structures.predictions import DepthMap

_OWN_LIMIT = 0.0  # the method's own valid pixels
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
    image_shares: dict[tuple[str, int, float], list[float]] = {}
    for index in chosen:
        frame = split_rings(dataset[index], truth=truth)
        for count in beams:
            for completer in completers:
                for share, (pixels, kept_share) in _pixels(frame, completer, count).items():
                    found.setdefault((completer.name, count, share), []).append(pixels)
                    image_shares.setdefault((completer.name, count, share), []).append(kept_share)
    print(f"{len(chosen)} frames of {data}, truth: {truth}; RMSE / MAE / median in mm")
    print(f"{'method':<16}{'beams':>6}{'limit':>7}{'kept':>8}{'of image':>10}", end="")
    print(f"{'kept pixels':>24}{'others':>24}")
    results = []
    for (name, count, share), columns in found.items():
        error_mm, is_valid = np.concatenate(columns, axis=1)
        kept, others = (_summary(error_mm[is_valid == value]) for value in (1, 0))
        image_share = float(np.mean(image_shares[name, count, share]))
        limit_text = f"{share:g}" if share else ""
        print(
            f"{name:<16}{count:>6}{limit_text:>7}{100 * is_valid.mean():>7.1f}%"
            f"{100 * image_share:>9.1f}%{_summary_text(kept):>24}{_summary_text(others):>24}"
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
    """Compute signed errors [mm] and validity of the pixels with truth and value.

    Also the share of valid pixels in the image. By limit of the expected error, as a share of the
    depth; 0: the method's own.
    """
    sample = frame.with_beams(beams)
    prediction: DepthMap = completer(sample)
    is_scored = (frame.truth_m > 0) & (prediction.depth_m > 0)
    error_mm = 1e3 * (prediction.depth_m - frame.truth_m)[is_scored].double().numpy()
    masks = {_OWN_LIMIT: prediction.valid}
    if prediction.uncertainty_m is not None:
        supported = choose_completer(method="adaptive")(sample).valid  # as networks take it
        for share in _LIMITS:
            masks[share] = supported & (prediction.uncertainty_m < share * prediction.depth_m)
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


def _summary_text(summary: list[float] | None) -> str:
    return "-" if summary is None else " / ".join(f"{x:.0f}" for x in summary)


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)
