"""Frames with sound and faulty sensors, and their detections kept in a folder: for joining."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple

import torch

from sightline.augmentation.sample_changes import thin_rings
from sightline.corruptions.suites import find_suite
from sightline.data.formats.kitti_conversion import kitti_from_labels
from sightline.data.formats.kitti_labels import KittiObjects
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.detection2d.predictor import DetectionPredictor
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.export.names import EngineName
from sightline.files.atomic import atomic_write_text
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.joining.fit_pair import Change, clean, core_fault, without_camera, without_lidar
from sightline.joining.fitting import FitFrame
from sightline.joining.models import JoinModels, read_models
from sightline.structures.lidar_turn import LidarTurn, undo_turn
from sightline.structures.predictions import Detections2D, Detections3D
from sightline.structures.sample import CameraLidarSample

_CORE: Final = find_suite("core")
_SOUND: Final = "clean"
_RINGS: Final = 64


def beams(num_beams: int, first: int) -> Change:
    """Make a change to `num_beams` of 64 rings, from ring `first` on."""

    def thin(sample: CameraLidarSample, position: int) -> CameraLidarSample:
        del position
        return thin_rings(sample, _RINGS // num_beams, first)

    return thin


def turned(yaw_deg: float) -> Change:
    """Make a change to a LiDAR rotated in its mount.

    The calibration is turned instead of the sweep, so that the sweep's detections stay.
    """

    def turn(sample: CameraLidarSample, position: int) -> CameraLidarSample:
        del position
        return undo_turn(sample, LidarTurn(yaw_deg=-yaw_deg))

    return turn


def half_hidden(sample: CameraLidarSample, position: int) -> CameraLidarSample:
    """Remove the returns left or right of straight ahead, in turns."""
    if sample.points is None:
        return sample
    is_left = sample.points[:, 1] > 0
    return replace(sample, points=sample.points[is_left if position % 2 else ~is_left])


CASES: Final[Mapping[str, Change]] = {
    "clean": clean,
    "camera_blank": without_camera,
    "lidar_blank": without_lidar,
    **{f"beams_32_from_{first}": beams(32, first) for first in range(2)},
    **{f"beams_16_from_{first}": beams(16, first) for first in range(4)},
    **{f"beams_8_from_{first}": beams(8, first) for first in range(0, 8, 2)},
    "half_hidden": half_hidden,
    **{f"yaw_{yaw_deg:g}": turned(yaw_deg) for yaw_deg in (0.5, 1.0, 2.0)},
    **{f"{kind}-3": core_fault(kind, 3) for kind in _CORE.kinds},
}
"""States of the sensors in which joined objects are scored."""


@dataclass(frozen=True)
class DetectionStore:
    """Detections of both detectors, computed once and kept as JSON by case and frame."""

    weights2d: str
    weights3d: str
    folder: Path
    engine: EngineName = "openvino"

    @cached_property
    def detector2d(self) -> DetectionPredictor:
        """Detector in the image, loaded when it is first needed."""
        return DetectionPredictor.load(self.weights2d, engine=self.engine, threads=1)

    @cached_property
    def detector3d(self) -> Detection3DPredictor:
        """Detector in the sweep, loaded when it is first needed."""
        return Detection3DPredictor.load(self.weights3d, engine=self.engine, threads=1)

    def frame(
        self, sample: CameraLidarSample, case: str, position: int, change: Change
    ) -> FitFrame:
        """Change a sample, and find or compute its detections."""
        changed = change(sample, position)
        path = self.folder / case / f"{sample.sample_id}.json"
        if path.is_file():
            content = json.loads(path.read_text())
            return FitFrame(
                sample=changed,
                found2d=_detections2d(content["image"]),
                found3d=None if content["sweep"] is None else _detections3d(content["sweep"]),
            )
        found2d = self.detector2d(changed).detections
        found3d: Detections3D | None = None
        if changed.points is sample.points and case != _SOUND:  # the sweep is as it was
            found3d = self.frame(sample, _SOUND, position, clean).found3d
        elif changed.points is not None:
            found3d = self.detector3d(changed)
        path.parent.mkdir(parents=True, exist_ok=True)
        content = {"image": plain(found2d), "sweep": None if found3d is None else plain(found3d)}
        atomic_write_text(path, json.dumps(content))
        return FitFrame(sample=changed, found2d=found2d, found3d=found3d)

    def frames(
        self, samples: list[CameraLidarSample], case: str, change: Change
    ) -> Iterator[FitFrame]:
        """Yield the frames of a case in order."""
        for position, sample in enumerate(samples):
            yield self.frame(sample, case, position, change)


class LabelledFrames(NamedTuple):
    """Labelled frames, and all that joins their detections."""

    samples: list[CameraLidarSample]
    labels: list[KittiObjects]
    models: JoinModels
    weights: list[str]
    """Names of the detectors' weights."""
    store: DetectionStore


def open_labelled(
    data: Path,
    sample_list: str,
    velodyne: Velodyne | None,
    models: Path,
    cache: Path,
    engine: EngineName,
) -> LabelledFrames:
    """Read labelled frames, models of joined scores, and the detectors that these name."""
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne)
    samples = [dataset[index] for index in range(len(dataset))]
    labels = [kitti_from_labels(s.objects, s.calibration) for s in samples if s.objects is not None]
    fitted = read_models(models)
    weights: dict[str, str] = fitted.provenance["weights"]
    store = DetectionStore(weights["detection2d"], weights["detection3d"], cache, engine)
    return LabelledFrames(samples, labels, fitted, list(weights.values()), store)


def plain(found: Detections2D | Detections3D) -> dict[str, Any]:
    """Convert detections to JSON without loss."""
    return {
        "classes": list(found.class_names),
        "boxes": found.boxes.tensor.tolist(),
        "scores": found.scores.tolist(),
    }


def _detections2d(content: Mapping[str, Any]) -> Detections2D:
    return Detections2D(
        class_names=tuple(content["classes"]),
        boxes=Boxes2D(torch.tensor(content["boxes"]).reshape(-1, 4)),
        scores=torch.tensor(content["scores"]),
    )


def _detections3d(content: Mapping[str, Any]) -> Detections3D:
    return Detections3D(
        class_names=tuple(content["classes"]),
        boxes=Boxes3D(torch.tensor(content["boxes"]).reshape(-1, 7)),
        scores=torch.tensor(content["scores"]),
    )
