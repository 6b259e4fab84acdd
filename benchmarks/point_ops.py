"""Times operations on point clouds against plain methods and libraries.

`python -m benchmarks.point_ops`; one thread, one run; its last line is kept in
benchmarks/results/point_ops.json. One simulated street that comes with Sightline, what the camera
sees of it, drawn to 16,384 points; 300 proposals: 220 around its objects, 80 around points.

- sample: 4,096 of 16,384 points, each the farthest from those before. Peer: `fpsample`, where it is
  installed (`pip install fpsample`), at the heights 5 and 7 of its tree.
- ball query: the first 32 points within 0.5 m of those 4,096. Peer: SciPy's k-d tree.
- three nearest: of the 4,096, for each of 16,384. Peer: SciPy's k-d tree.
- RoI pooling: 512 points with 130 features of each proposal and 1.0 m around it. Peer: numpy, a
  mask and a draw for each box.
- recall: IoUs of the 300 proposals and the objects, and which objects reach 0.5.

"plain torch" is the implementation for other devices. Times are processor time of all threads,
which other programs on the machine disturb least. The table marks results with other indices than
Sightline's: RoI pooling by numpy draws other points; the trees of fpsample 1.0.2 start at another
point than the given one, and its plain method differs from numpy's at ties.
"""

import importlib
import statistics
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jsonargparse
import numpy as np
import torch
from numpy import ndarray
from scipy.spatial import KDTree
from torch import Tensor

from benchmarks.record import print_record
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.ops import (
    ball_query,
    farthest_points,
    roi_points,
    rotated_iou,
    rotated_iou_torch,
    three_nearest,
)
from sightline.ops.group_points import group_points
from sightline.simulation.packaged import PACKAGED_FRAMES

POINTS, SAMPLED, PROPOSALS, ANYWHERE = 16_384, 4_096, 300, 80
FEATURES, POOLED, MARGIN_M = 130, 512, 1.0
RADIUS_M, NEIGHBOURS = 0.5, 32
Method = Callable[[], Any]


class Scene(NamedTuple):
    """Inputs of all methods, each with a batch axis."""

    points: Tensor
    sampled: Tensor
    features: Tensor
    proposals: Tensor
    objects: Tensor


def main(repeats: int = 15) -> None:
    """Print a table, then one line of JSON."""
    torch.set_num_threads(1)
    scene = make_scene(np.random.default_rng(0))
    results = []
    for operation, methods in operations(scene).items():
        outputs = {name: method() for name, method in methods.items()}  # warms up, too
        same = {
            name: np.array_equal(output, outputs["sightline"]) for name, output in outputs.items()
        }
        times: dict[str, list[float]] = {name: [] for name in methods}
        for _ in range(repeats):  # in turns, so that all meet the same disturbances
            for name, method in methods.items():
                times[name].append(milliseconds(method))
        for name, measured in times.items():
            low, median, high = statistics.quantiles(measured, n=4)
            row = {"operation": operation, "method": name, "median_ms": median}
            results.append(row | {"iqr_ms": high - low, "same_answer": same[name]})
            print(
                f"{operation:<14} {name:<14} {median:9.2f} ms  (IQR {high - low:.2f})"
                f"{'' if same[name] else '  another result'}"
            )
    setting = {
        "points": POINTS,
        "proposals": PROPOSALS,
        "objects": scene.objects.shape[1],
        "repeats": repeats,
        "threads": 1,
    }
    print_record({**setting, "results": results}, seed=0)


def milliseconds(method: Method) -> float:
    """Processor time of this process for one call."""
    start = time.process_time_ns()
    result = method()
    taken = (time.process_time_ns() - start) / 1e6
    del result  # its memory is not given back within the time
    return taken


def make_scene(rng: np.random.Generator) -> Scene:
    """The second packaged street."""
    sample = KittiObjectDataset(PACKAGED_FRAMES, parts=("points", "objects"))[1]
    assert sample.points is not None, "the packaged frames have sweeps"
    assert sample.objects is not None, "the packaged frames have labels"
    cloud = sample.points[:, :3].numpy()
    cloud = cloud[rng.permutation(np.resize(np.arange(len(cloud)), POINTS))]
    objects = sample.objects.boxes3d.tensor[sample.objects.has_box3d].float().numpy()
    around = objects[rng.integers(0, len(objects), PROPOSALS - ANYWHERE)]
    around = around + rng.normal(size=around.shape) * (0.5, 0.3, 0.2, 0.2, 0.1, 0.1, 0.1)
    sizes = np.tile((3.9, 1.6, 1.5), (ANYWHERE, 1))
    anywhere = (cloud[rng.integers(0, POINTS, ANYWHERE)], sizes, rng.normal(size=(ANYWHERE, 1)))
    proposals = np.concatenate((around, np.concatenate(anywhere, axis=1)))
    proposals[:, 3:6] = np.maximum(proposals[:, 3:6], 0.1)
    points = torch.from_numpy(np.ascontiguousarray(cloud))[None]
    return Scene(
        points=points,
        sampled=group_points(points, farthest_points.farthest_points(points, SAMPLED)),
        features=torch.rand(1, POINTS, FEATURES),
        proposals=torch.from_numpy(proposals.astype(np.float32))[None],
        objects=torch.from_numpy(objects)[None],
    )


def operations(scene: Scene) -> dict[str, dict[str, Method]]:
    """Timed methods by operation, `sightline` first."""
    points, proposals, objects = scene.points, scene.proposals[0], scene.objects[0]
    cloud, sampled = points[0].numpy(), scene.sampled[0].numpy()
    return {
        "sample": {
            "sightline": lambda: farthest_points.farthest_points(points, SAMPLED)[0],
            "plain numpy": lambda: sample_by_numpy(cloud),
            **sampling_peers(cloud),
        },
        "ball query": {
            "sightline": lambda: ball_query.ball_query(
                points, scene.sampled, radius_m=RADIUS_M, count=NEIGHBOURS
            ).indices[0],
            "scipy": lambda: query_by_scipy(cloud, sampled),
        },
        "three nearest": {
            "sightline": lambda: three_nearest.three_nearest(scene.sampled, points).indices[0],
            "scipy": lambda: KDTree(sampled).query(cloud, 3)[1],
        },
        "RoI pooling": {
            "sightline": lambda: pool(scene),
            "plain torch": lambda: pool_by_torch(scene),
            "plain numpy": lambda: pool_by_numpy(scene, np.random.default_rng(0)),
        },
        "recall": {
            "sightline": lambda: rotated_iou.pairwise_iou_3d(proposals, objects).amax(0) >= 0.5,
            "plain torch": lambda: recall_by_torch(proposals, objects),
        },
    }


def sampling_peers(cloud: ndarray) -> dict[str, Method]:
    """Load the package fpsample; None where it is not installed."""
    try:
        fpsample = importlib.import_module("fpsample")
    except ModuleNotFoundError:
        return {}

    def at_height(height: int) -> Method:
        sample = fpsample.bucket_fps_kdline_sampling
        return lambda: sample(cloud, SAMPLED, h=height, start_idx=0).astype(np.int64)

    return {f"fpsample, h={height}": at_height(height) for height in (5, 7)}


def sample_by_numpy(cloud: ndarray) -> ndarray:
    """Every distance in every step."""
    nearest, taken = np.full(len(cloud), np.inf, np.float32), np.zeros(SAMPLED, np.int64)
    columns = cloud.T.copy()
    for step in range(1, SAMPLED):
        dx, dy, dz = columns - columns[:, taken[step - 1], None]
        np.minimum(nearest, dx * dx + dy * dy + dz * dz, out=nearest)
        taken[step] = nearest.argmax()
    return taken


def query_by_scipy(cloud: ndarray, sampled: ndarray) -> ndarray:
    """SciPy's tree, then the first in order."""
    near = KDTree(cloud).query_ball_point(sampled, RADIUS_M, return_sorted=True)
    return np.array(
        [
            np.pad(row[:NEIGHBOURS], (0, max(NEIGHBOURS - len(row), 0)), constant_values=row[0])
            for row in near
        ]
    )


def pool(scene: Scene) -> Tensor:
    """Drawn points with their features."""
    drawn = roi_points.roi_points(
        scene.points, scene.proposals, margin_m=MARGIN_M, count=POOLED, seed=0
    )
    return group_points(scene.features, drawn.indices)[0]


def pool_by_torch(scene: Scene) -> Tensor:
    """All points tested against all boxes."""
    columns, boxes = scene.points[0].double().T.contiguous(), scene.proposals[0].double()
    index, _ = roi_points.choose_by_torch(columns, boxes, MARGIN_M, POOLED, 0)
    return scene.features[0][index]


def pool_by_numpy(scene: Scene, rng: np.random.Generator) -> ndarray:
    """Box by box."""
    cloud, features = scene.points[0].numpy(), scene.features[0].numpy()
    pooled = np.zeros((PROPOSALS, POOLED, FEATURES), np.float32)
    for k, (x, y, z, length, width, height, yaw) in enumerate(scene.proposals[0].tolist()):
        dx, dy, dz = (cloud - np.array((x, y, z), np.float32)).T
        along, across = np.cos(yaw) * dx + np.sin(yaw) * dy, np.cos(yaw) * dy - np.sin(yaw) * dx
        is_inside = np.abs(along) <= length / 2 + MARGIN_M
        is_inside &= np.abs(across) <= width / 2 + MARGIN_M
        is_inside &= np.abs(dz) <= height / 2 + MARGIN_M
        inside = np.flatnonzero(is_inside)
        if len(inside) >= POOLED:
            pooled[k] = features[rng.choice(inside, POOLED, replace=False)]
        elif len(inside):
            repeated = rng.choice(inside, POOLED - len(inside))
            pooled[k] = features[np.concatenate((inside, repeated))]
    return pooled


def recall_by_torch(proposals: Tensor, objects: Tensor) -> Tensor:
    """All pairs in float64."""
    iou = rotated_iou_torch.iou(proposals.double()[:, None], objects.double()[None])
    return iou.amax(0) >= 0.5


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
