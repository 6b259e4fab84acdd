"""Cost of a LiDAR at another height: `python -m benchmarks.lidar_height DATA`.

The LiDAR frame's origin is moved up or down, with points and calibration; the rings keep their
points. The detector gets no height, the true height, or the height above the road estimated from
five sweeps. Prints a table, then one line of JSON; benchmarks/results/lidar_height.json holds those
of `detection3d-best` and of `--weights detection2d-best`.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jsonargparse
import torch

from benchmarks.record import print_record
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.evaluation.kitti_object import evaluate_objects
from sightline.export.names import EngineName
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.road_height import drive_height_m
from sightline.jobs.progress import track
from sightline.structures.sample import CameraLidarSample
from sightline.tasks import choose_task

_NUM_HEIGHT_SWEEPS = 5  # sweeps, as of a recording


def main(
    data: Path,
    weights: str = "detection3d-best",
    frames: int = 60,
    sample_list: str = "val",
    velodyne: Velodyne = "velodyne_reduced",
    shifts_m: Sequence[float] = (0.0, 0.6, -0.5),
    engine: EngineName = "openvino",
) -> None:
    """Score each height and each source of the given height.

    Args:
        data: KITTI object tree with labels.
        weights: Name or file of a detector's weights.
        frames: Number of frames, from the first of the list.
        sample_list: List of frames.
        velodyne: Folder of the sweeps.
        shifts_m: Upward shifts of the LiDAR.
        engine: Inference engine of the network.
    """
    torch.set_num_threads(1)
    task = choose_task(None, weights)
    predictor = task.predictor(weights=weights, engine=engine, threads=1)
    metric = "3d" if task.name == "detection3d" else "bbox"
    parts = predictor.parts
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne, parts=parts)
    samples = [dataset[index] for index in range(frames)]
    names = [sample.sample_id for sample in samples]
    rows: list[dict[str, object]] = []
    for up_m in shifts_m:
        moved = [at_height(sample, up_m) for sample in samples]
        sweeps = [sample.points.numpy() for sample in moved if sample.points is not None]
        by_road_m = drive_height_m(
            sweeps[:: max(frames // _NUM_HEIGHT_SWEEPS, 1)][:_NUM_HEIGHT_SWEEPS]
        )
        heights_m = {
            "none": None,
            "true height": round(KITTI_LIDAR_HEIGHT_M + up_m, 3),
            "five sweeps": by_road_m,
        }
        for source, height_m in heights_m.items():
            with tempfile.TemporaryDirectory() as out:
                for sample in track(moved, description=f"{up_m:+.1f} m, height: {source}"):
                    given = replace(sample, lidar_height_m=height_m)
                    path = Path(out) / f"{sample.sample_id}.txt"
                    task.outputs[0].write(path, given, predictor(given))
                labels = data / "training" / "label_2"
                report = evaluate_objects(out, labels, sample_list=names).to_json()
            scores = {
                entry["class"]: round(entry["AP_R40"], 1)
                for entry in report["entries"]
                if entry["metric"] == metric and entry["difficulty"] == "moderate"
            }
            rows.append({"up_m": up_m, "source": source, "height_m": height_m, **scores})
            print(" ".join(f"{key} {value}" for key, value in rows[-1].items()))
    setting = {"frames": frames, "metric": f"{metric} AP_R40 moderate"}
    print_record({**setting, "results": rows}, seed=None, weights=[weights])


def at_height(sample: CameraLidarSample, up_m: float) -> CameraLidarSample:
    """Raise the origin of a sample's LiDAR by `up_m`."""
    assert sample.points is not None, "detectors need sweeps"
    old_from_new = torch.eye(4, dtype=torch.float64)
    old_from_new[2, 3] = up_m
    camera_from_lidar = sample.calibration.camera_from_lidar @ old_from_new
    return replace(
        sample,
        points=sample.points - sample.points.new_tensor([0, 0, up_m, 0]),
        calibration=replace(sample.calibration, camera_from_lidar=camera_from_lidar),
    )


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
