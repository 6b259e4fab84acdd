"""Fit of the joined objects' scores: `python -m benchmarks.fit_joined DATA LIST OUT`.

Runs both detectors on labelled frames that they were not trained on, in five states of the sensors,
and fits the logistic models by which `sightline.load("joined")` scores objects. Needed anew for
other weights. Simulated frames suffice; nothing is random.
"""

import hashlib
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import jsonargparse
import torch

from benchmarks.joined_frames import FIT_CASES, DetectionStore
from sightline.data.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.export.names import EngineName
from sightline.files.weights_header import find_weights
from sightline.joining.calibrating import calibrate_models
from sightline.joining.fitting import FitFrame, fit_models
from sightline.joining.refining import refiner_of


def main(
    data: Path,
    sample_list: str,
    out: Path,
    cache: Path,
    detection2d: str = "detection2d-best",
    detection3d: str = "detection3d-best",
    velodyne: Velodyne | None = None,
    engine: EngineName = "openvino",
) -> None:
    """Fit and write the models.

    Args:
        data: KITTI object tree with labels.
        sample_list: List of frames in ImageSets, or a text file with one name a line.
        out: File of the models (.json).
        cache: Folder for detections, which a second run reads.
        detection2d: Name or file of the image detector's weights.
        detection3d: Name or file of the sweep detector's weights.
        velodyne: Folder of the sweeps; None: velodyne, or else velodyne_reduced.
        engine: Inference engine.
    """
    torch.set_num_threads(1)
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne)
    samples = [dataset[index] for index in range(len(dataset))]
    store = DetectionStore(detection2d, detection3d, cache, engine)
    given = {"detection2d": detection2d, "detection3d": detection3d}

    def frames() -> Iterator[FitFrame]:
        for case, change in FIT_CASES.items():
            yield from store.frames(samples, case, change)

    models = fit_models(
        frames(),
        {
            "weights": {task: Path(name).stem for task, name in given.items()},
            "sha256": {
                task: hashlib.sha256(find_weights(name).read_bytes()).hexdigest()
                for task, name in given.items()
            },
            "data": data.name,
            "frames": ",".join(dataset.sample_ids),
            "states": list(FIT_CASES),
            "engine": engine,
            "sightline": version("sightline"),
        },
    )
    refine = refiner_of(store.detector3d)
    calibrate_models(models, frames(), refine).write(out)


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
