"""Separation of real and simulated data: `python -m benchmarks.sim_or_real --real KITTI ...`.

Judges learn to separate the two sides on half of the frames and classify the other half: balanced
accuracy, 0.5 if they cannot. Its last line is kept in benchmarks/results/sim_or_real.json.

- Cars in the LiDAR: the points in the boxes of cars (occlusion 0 or 1, whole in the image, 20
  points, within 50 m) in the box's own frame. Each real car is paired with a simulated one of the
  same distance, view and occlusion, which the judge of these three alone checks. Networks get 256
  points, so they see the density but not the number; with and without reflectance.
- Patches of 64x64 pixels: plain ones below the horizon, at equal places from the principal point,
  and cars, cut by their 3D boxes and resized.
- Logistic regression on hand-made features: the ranking lists how well each feature alone separates
  the sides (area under the curve; 0.5: not at all).

Frames are split at random in each repeat; each half serves once for training. Frames of one drive
may be in both halves: the object benchmark does not list its drives. Intervals are 95 % of
bootstraps over frames. Two differences do not concern the simulation: labels drawn by hand, which
lie some centimetres off the car (so networks also get the points relative to their own middle), and
the resampling of KITTI's rectified images (grain, smallest in the middle). Both sides have
coordinates of whole millimetres, hundredths of reflectance, PNGs, and points cut to the image.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import jsonargparse
import numpy as np
import torch
from jaxtyping import Bool, Int64
from numpy import ndarray
from torch import Tensor

from benchmarks.record import print_record
from benchmarks.sim_or_real_crops import CarCrop, Frames, cut_frames, match
from benchmarks.sim_or_real_judges import (
    PatchJudge,
    PointJudge,
    area_under_curve,
    drawn_points,
    judge_by_features,
    judge_by_network,
    patch_features,
    pose_features,
    reflectance_features,
    shape_features,
)

_BOOTSTRAPS = 1000
_NUM_PRINTED_FEATURES = 8

Judge = Callable[[Tensor, Bool[Tensor, " num_train"], Tensor], Bool[Tensor, " num_test"]]
"""Function of training items, their labels (is real) and test items; predicts test labels."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Items:
    """Items to judge, half of them real."""

    is_real: Bool[Tensor, " num_items"]
    frames: Int64[ndarray, " num_items"]
    """Frame of each item on its side."""
    views: Mapping[str, Tensor]
    """Views of the items for judges."""
    features: Mapping[str, tuple[str, ...]]
    """Column names of a view, if it has any."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdicts:
    """Verdicts of a judge."""

    is_real: Bool[ndarray, " num_items"]
    frames: Int64[ndarray, " num_items"]
    right: Bool[ndarray, " num_items"]


_BY_POINTS = partial(judge_by_network, make=lambda items: PointJudge(items.shape[-1]), steps=800)
_BY_PIXELS = partial(judge_by_network, make=lambda _: PatchJudge(), steps=1000)
_JUDGES: Mapping[str, tuple[str, str, Judge]] = {
    # Subject, view of it, judge.
    "car, pose alone: features": ("car", "pose", judge_by_features),
    "car, points: network": ("car", "points", _BY_POINTS),
    "car, points without reflectance: network": ("car", "places", _BY_POINTS),
    "car, points from their middle: network": ("car", "centred points", _BY_POINTS),
    "car, the same without reflectance: network": ("car", "centred places", _BY_POINTS),
    "car, shape and reflectance: features": ("car", "all", judge_by_features),
    "car, shape: features": ("car", "shape", judge_by_features),
    "car, reflectance: features": ("car", "reflectance", judge_by_features),
    "patch: network": ("patch", "pixels", _BY_PIXELS),
    "patch: features": ("patch", "colour", judge_by_features),
    "patch of a car: network": ("car's patch", "pixels", _BY_PIXELS),
    "patch of a car: features": ("car's patch", "colour", judge_by_features),
}
_CAR_FEATURES: Mapping[str, Callable[[CarCrop], dict[str, float]]] = {
    "pose": pose_features,
    "shape": shape_features,
    "reflectance": reflectance_features,
    "all": lambda car: {**shape_features(car), **reflectance_features(car)},
}


def main(
    real: Path,
    simulated: Path,
    split: str = "sample_train",
    repeats: int = 4,
    patches_per_frame: int = 16,
    max_frames: int | None = None,
) -> None:
    """Print two tables, then one line of JSON.

    Args:
        real: KITTI object tree.
        simulated: Object tree of `sightline simulate`.
        split: List of the real frames in ImageSets, or a text file with one name a line.
        repeats: Number of splits and trainings, each with another seed.
        patches_per_frame: Number of plain patches.
        max_frames: Maximum number of simulated frames; None: all.
    """
    torch.set_num_threads(1)
    sides = (
        cut_frames(real, split, patches_per_frame),
        cut_frames(simulated, None, patches_per_frame, max_frames),
    )
    verdicts: dict[str, list[Verdicts]] = {name: [] for name in _JUDGES}
    halves: list[Mapping[str, Items]] = []
    for repeat in range(repeats):
        first, second = part(sides, repeat)
        halves += [first, second]
        for name, (subject, view, judge) in _JUDGES.items():
            torch.manual_seed(repeat)
            for train, test in ((first, second), (second, first)):
                verdicts[name].append(verdict(judge, view, train[subject], test[subject]))
    results: list[dict[str, str | float]] = [
        {"judge": name, **score(given)} for name, given in verdicts.items()
    ]
    ranking = rank(halves)
    show(sides, results, ranking)
    setting = {"split": split, "repeats": repeats, "frames": [side.num_frames for side in sides]}
    print_record({**setting, "results": results, "ranking": ranking}, seed=0)


def part(
    sides: tuple[Frames, Frames], seed: int
) -> tuple[Mapping[str, Items], Mapping[str, Items]]:
    """Split the frames of both sides, real first, into halves; by subject, half real."""
    rng = np.random.default_rng(seed)
    orders = [rng.permutation(side.num_frames) for side in sides]
    first, second = (
        [order[start::2] for order in orders]  # the simulated side has more frames
        for start in (0, 1)
    )
    return _subjects(sides, first, seed), _subjects(sides, second, seed)


def _subjects(
    sides: tuple[Frames, Frames], chosen: list[Int64[ndarray, " num_chosen"]], seed: int
) -> Mapping[str, Items]:
    crops = [
        [car for car in side.cars if car.frame in set(frames.tolist())]
        for side, frames in zip(sides, chosen, strict=True)
    ]
    pairs = match(*crops)
    cars = [[crops[side][pair[side]] for pair in pairs] for side in (0, 1)]
    with_patches = [
        (one, other) for one, other in zip(*cars, strict=True) if _has_patches(one, other)
    ]
    patched = [[pair[side] for pair in with_patches] for side in (0, 1)]
    count = min(len(frames) for frames in chosen)
    per_frame = len(sides[0].patches) // sides[0].num_frames
    rows = [(frames[:count, None] * per_frame + np.arange(per_frame)).ravel() for frames in chosen]
    return {
        "car": _car_items(cars, seed),
        "patch": _patch_items(
            [side.patches[row] for side, row in zip(sides, rows, strict=True)],
            np.concatenate([row // per_frame for row in rows]),
        ),
        "car's patch": _patch_items(
            [torch.stack([car.patch for car in side if car.patch is not None]) for side in patched],
            np.array([car.frame for side in patched for car in side]),
        ),
    }


def _has_patches(one: CarCrop, other: CarCrop) -> bool:
    return one.patch is not None and other.patch is not None


def _car_items(cars: list[list[CarCrop]], seed: int) -> Items:
    both = [car for side in cars for car in side]
    points = drawn_points(both, seed)
    centred = points.clone()
    centred[..., :3] -= points[..., :3].mean(dim=1, keepdim=True)
    views = {"points": points, "places": points[..., :3]}
    views |= {"centred points": centred, "centred places": centred[..., :3]}
    features = {}
    for view, compute_features in _CAR_FEATURES.items():
        rows = [compute_features(car) for car in both]
        views[view] = torch.tensor([list(row.values()) for row in rows])
        features[view] = tuple(rows[0])
    return Items(
        is_real=_first_half(len(both)),
        frames=np.array([car.frame for car in both]),
        views=views,
        features=features,
    )


def _patch_items(sides: list[Tensor], frames: Int64[ndarray, " num_items"]) -> Items:
    pixels = torch.cat(sides)
    rows = [patch_features(patch) for patch in pixels]
    return Items(
        is_real=_first_half(len(pixels)),
        frames=frames,
        views={
            "pixels": pixels,
            "colour": torch.tensor([list(row.values()) for row in rows]),
        },
        features={"colour": tuple(rows[0])},
    )


def _first_half(count: int) -> Bool[Tensor, " {count}"]:
    return torch.arange(count) < count // 2


def verdict(judge: Judge, view: str, train: Items, test: Items) -> Verdicts:
    """Train a judge on one half and test it on the other."""
    predicted = judge(train.views[view], train.is_real, test.views[view])
    right = predicted == test.is_real
    return Verdicts(is_real=test.is_real.numpy(), frames=test.frames, right=right.numpy())


def score(given: list[Verdicts]) -> dict[str, float]:
    """Compute the balanced accuracy, its interval over frames, and its spread over repeats."""
    is_real = np.concatenate([one.is_real for one in given])
    frames = np.concatenate([one.frames for one in given])
    right = np.concatenate([one.right for one in given])
    rng = np.random.default_rng(0)
    drawn = np.zeros(_BOOTSTRAPS)
    total = 0.0
    for side in (True, False):
        is_side = is_real == side
        _, places = np.unique(frames[is_side], return_inverse=True)
        counts, correct = np.bincount(places), np.bincount(places, weights=right[is_side])
        weights = rng.multinomial(len(counts), np.full(len(counts), 1 / len(counts)), _BOOTSTRAPS)
        drawn += (weights @ correct) / (weights @ counts) / 2
        total += correct.sum() / counts.sum() / 2
    low, high = np.quantile(drawn, (0.025, 0.975))
    halves = [float(one.right.mean()) for one in given]
    spread = np.std(np.mean(np.reshape(halves, (-1, 2)), axis=1))
    numbers = {"balanced_accuracy": total, "low": low, "high": high, "spread_of_repeats": spread}
    return {name: round(float(value), 3) for name, value in numbers.items()}


def rank(halves: list[Mapping[str, Items]]) -> dict[str, list[dict[str, str | float]]]:
    """Rank, by table, the features that separate the sides best, by their mean area over halves."""
    tables: dict[str, list[dict[str, str | float]]] = {}
    for subject, view in (
        ("car", "pose"),
        ("car", "shape"),
        ("car", "reflectance"),
        ("patch", "colour"),
        ("car's patch", "colour"),
    ):
        items = [half[subject] for half in halves]
        is_real = torch.cat([one.is_real for one in items])
        rows: list[dict[str, str | float]] = []
        for column, name in enumerate(items[0].features[view]):
            values = torch.cat([one.views[view][:, column] for one in items])
            medians = [float(values[is_real == side].median()) for side in (True, False)]
            area = area_under_curve(values, is_real)
            rows.append(
                {
                    "feature": name,
                    "area": round(area, 3),
                    "real": round(medians[0], 4),
                    "simulated": round(medians[1], 4),
                }
            )
        rows.sort(key=lambda row: -abs(float(row["area"]) - 0.5))
        tables[f"{subject}, {view}"] = rows
    return tables


def show(
    sides: tuple[Frames, Frames],
    results: list[dict[str, str | float]],
    ranking: dict[str, list[dict[str, str | float]]],
) -> None:
    """Print the tables."""
    for name, side in zip(("real", "simulated"), sides, strict=True):
        print(f"{name}: {side.num_frames} frames, {len(side.cars)} cars")
    print(f"{'':<44}{'balanced accuracy':>18}{'95 %':>16}{'repeats +-':>12}")
    for row in results:
        interval = f"{row['low']:.2f} to {row['high']:.2f}"
        print(
            f"{row['judge']:<44}{row['balanced_accuracy']:>18.3f}{interval:>16}"
            f"{row['spread_of_repeats']:>12.3f}"
        )
    for table, rows in ranking.items():
        print(f"\n{table:<44}{'area':>10}{'real':>12}{'simulated':>12}")
        for row in rows[:_NUM_PRINTED_FEATURES]:
            print(
                f"  {row['feature']:<42}{row['area']:>10.3f}{row['real']:>12.4g}"
                f"{row['simulated']:>12.4g}"
            )


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)
