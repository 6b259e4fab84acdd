"""Time of rotated IoU, beside shapely and OpenCV: `python -m benchmarks.rotated_iou`.

One thread, one run; its last line is kept in benchmarks/results/rotated_iou.json.

50 scenes of 300 proposals by 20 cars, all 6,000 IoUs of each: 220 proposals scattered around the
cars and 80 anywhere. All methods get the same float64 arrays and give the dense matrix.

- sightline: `pairwise_iou_bev`, tensors in and out.
- shapely: polygons made in one call, an STRtree over the cars, intersections in one call.
- OpenCV: `rotatedRectangleIntersection`, called for pairs whose circumscribed circles meet (found
  with numpy, in OpenCV's favour), and for all pairs. It computes in float32.

Times are processor time, which other programs on the machine disturb least, and would show any
second thread. Errors are against polygons of 60-digit numbers.
"""

import math
import statistics
import time
from collections.abc import Callable
from typing import Any

import cv2
import jsonargparse
import numpy as np
import shapely
import torch
from numpy import ndarray

from benchmarks.record import print_record
from sightline.ops.rotated_iou import pairwise_iou_bev
from tests.reference.rotated_iou import exact_iou_bev

PROPOSALS, CARS = 300, 20
Method = Callable[[ndarray, ndarray], ndarray]


def main(scenes: int = 50, repeats: int = 15, exact_scenes: int = 10) -> None:
    """Print a table, then one line of JSON."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    rng = np.random.default_rng(0)
    pairs = [scene(rng) for _ in range(scenes)]
    methods = {
        "sightline": by_sightline,
        "shapely STRtree": by_shapely,
        "OpenCV, near pairs": by_opencv,
        "OpenCV, all pairs": by_opencv_unfiltered,
    }
    times: dict[str, list[float]] = {name: [] for name in methods}
    for _ in range(
        repeats + 1
    ):  # in turns, so that all meet the same disturbances; the first warms up
        for name, method in methods.items():
            times[name].append(milliseconds(method, pairs))
    results: list[dict[str, Any]] = []
    for name, method in methods.items():
        low, median, high = statistics.quantiles(times[name][1:], n=4)
        error = max(largest_error(method, *pair) for pair in pairs[:exact_scenes])
        results.append(
            {"method": name, "median_ms": median, "iqr_ms": high - low, "max_error": error}
        )
    ours = results[0]["median_ms"]
    for row in results:
        row["times_sightline"] = row["median_ms"] / ours
        print(
            f"{row['method']:<20} {row['median_ms']:9.2f} ms  (IQR {row['iqr_ms']:.2f})"
            f"  {row['times_sightline']:7.1f} x  largest error {row['max_error']:.1e}"
        )
    setting = {"scenes": scenes, "boxes": [PROPOSALS, CARS], "repeats": repeats, "threads": 1}
    print_record({**setting, "results": results}, seed=0)


def scene(rng: np.random.Generator) -> tuple[ndarray, ndarray]:
    """Proposals and cars on a plane of 70 m by 80 m: x, y, length, width, yaw."""
    cars, clutter = anywhere(rng, CARS), anywhere(rng, 80)
    around = cars[rng.integers(0, CARS, PROPOSALS - len(clutter))]
    around = around + rng.normal(size=around.shape) * (0.5, 0.3, 0.2, 0.1, 0.1)
    return np.concatenate((around, clutter)), cars


def anywhere(rng: np.random.Generator, count: int) -> ndarray:
    """Cars, most of them along or across the street."""
    columns = (
        rng.uniform(0, 70, count),
        rng.uniform(-40, 40, count),
        rng.normal(3.9, 0.3, count),
        rng.normal(1.6, 0.1, count),
        rng.choice([0, math.pi / 2, math.pi], count) + rng.normal(0, 0.1, count),
    )
    return np.stack(columns, axis=1)


def milliseconds(method: Method, pairs: list[tuple[ndarray, ndarray]]) -> float:
    """Processor time of this process for all scenes."""
    start = time.process_time_ns()
    for proposals, cars in pairs:
        method(proposals, cars)
    return (time.process_time_ns() - start) / 1e6


def largest_error(method: Method, proposals: ndarray, cars: ndarray) -> float:
    """Compute all IoUs of one scene; pairs further apart than 10 m do not overlap."""
    iou, exact = method(proposals, cars), np.zeros((len(proposals), len(cars)))
    for i, j in np.argwhere(distances(proposals, cars) < 10):
        exact[i, j] = exact_iou_bev(tuple(proposals[i].tolist()), tuple(cars[j].tolist()))
    return float(np.abs(iou - exact).max())


def distances(a: ndarray, b: ndarray) -> ndarray:
    """Between all centres."""
    between: ndarray = np.hypot(a[:, None, 0] - b[:, 0], a[:, None, 1] - b[:, 1])
    return between


def by_sightline(proposals: ndarray, cars: ndarray) -> ndarray:
    """Public function of Sightline."""
    return pairwise_iou_bev(torch.from_numpy(proposals), torch.from_numpy(cars)).numpy()


def by_shapely(proposals: ndarray, cars: ndarray) -> ndarray:
    """GEOS, vectorised by shapely 2."""
    a, b = polygons(proposals), polygons(cars)
    i, j = shapely.STRtree(b).query(a)
    shared = np.zeros((len(a), len(b)))
    shared[i, j] = shapely.area(shapely.intersection(a[i], b[j]))
    return over_union(shared, proposals, cars)


def polygons(boxes: ndarray) -> ndarray:
    """Outlines of all boxes."""
    along = boxes[:, 2, None] / 2 * (1, 1, -1, -1)
    across = boxes[:, 3, None] / 2 * (-1, 1, 1, -1)
    cos, sin = np.cos(boxes[:, 4, None]), np.sin(boxes[:, 4, None])
    x = boxes[:, 0, None] + cos * along - sin * across
    y = boxes[:, 1, None] + sin * along + cos * across
    outlines: ndarray = shapely.polygons(np.stack((x, y), axis=-1))
    return outlines


def over_union(shared: ndarray, a: ndarray, b: ndarray) -> ndarray:
    """IoU from shared areas."""
    areas_a, areas_b = a[:, 2] * a[:, 3], b[:, 2] * b[:, 3]
    iou: ndarray = shared / (areas_a[:, None] + areas_b - shared)
    return iou


def by_opencv(proposals: ndarray, cars: ndarray) -> ndarray:
    """A loop over the pairs that may overlap."""
    radii_a, radii_b = (np.hypot(boxes[:, 2], boxes[:, 3]) / 2 for boxes in (proposals, cars))
    near = np.argwhere(distances(proposals, cars) < radii_a[:, None] + radii_b)
    return opencv_loop(proposals, cars, [(i, j) for i, j in near.tolist()])


def by_opencv_unfiltered(proposals: ndarray, cars: ndarray) -> ndarray:
    """A loop over all pairs."""
    every = [(i, j) for i in range(len(proposals)) for j in range(len(cars))]
    return opencv_loop(proposals, cars, every)


def opencv_loop(proposals: ndarray, cars: ndarray, pairs: list[tuple[int, int]]) -> ndarray:
    """OpenCV's shared area of the given pairs, as IoU."""
    a, b = (
        [
            ((x, y), (length, width), math.degrees(yaw))
            for x, y, length, width, yaw in boxes.tolist()
        ]
        for boxes in (proposals, cars)
    )
    shared = np.zeros((len(a), len(b)))
    for i, j in pairs:
        kind, polygon = cv2.rotatedRectangleIntersection(a[i], b[j])
        if kind != cv2.INTERSECT_NONE:
            shared[i, j] = cv2.contourArea(polygon)  # its corners are in order
    return over_union(shared, proposals, cars)


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
