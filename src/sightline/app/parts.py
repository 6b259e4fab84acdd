"""Parts of the page's answer, each computed in a worker process from a state."""

import gzip
import pickle
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

import cv2
import numpy as np
from jaxtyping import UInt8

from sightline.app.breaking import break_sample
from sightline.app.points import pack_points
from sightline.app.state import Breakage, PageState
from sightline.data.datasets.newer_frames import shared_calibration
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.datasets.sample_files import describe_sparse_maps, list_sample_files
from sightline.export.names import EngineChoice
from sightline.files.problem import FileError
from sightline.health.monitor import HealthMonitor, rgb_of
from sightline.health.shipped import ChosenLimits, choose_for_dataset
from sightline.inference.predictor import Predictor, lacking_parts
from sightline.joining.join import join_detections
from sightline.joining.models import JOINED, fitted_models
from sightline.joining.refining import refiner_of
from sightline.perception.perceiver import LEFT_OUT
from sightline.structures.health import SampleHealth
from sightline.structures.labels import ObjectLabels
from sightline.structures.predictions import DepthMap
from sightline.structures.sample import SENSOR_FIELDS, CameraLidarSample
from sightline.tasks import find_task
from sightline.visualization.colors import UNCERTAINTY_SCALE
from sightline.visualization.depth import colorize_depth, draw_depth

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")
PartName = Literal["scene", "health", "detection2d", "detection3d", "depth-completion", "joined"]

_KEPT_SAMPLES: Final = 4
_KEPT_PREDICTORS: Final = 8
_JPEG: Final = (cv2.IMWRITE_JPEG_QUALITY, 90)
_GZIP_LEVEL: Final = 1
_FEW_DIGITS: Final = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class Answer:
    """Part of an answer, ready to be sent."""

    content: Mapping[str, Any]
    """Content as JSON."""
    files: Mapping[str, bytes] = field(default_factory=dict)
    """Pictures and points by name."""
    found: bytes = b""
    """Pickled detections and their network's digest, from which objects are joined."""

    @property
    def num_bytes(self) -> int:
        """Approximate memory."""
        return 1000 + len(repr(self.content)) + len(self.found) + sum(map(len, self.files.values()))


@dataclass(frozen=True, kw_only=True, slots=True)
class Task:
    """Work for a process: one part of a state."""

    part: PartName
    state: PageState
    found: tuple[bytes, bytes] = (b"", b"")
    """Pickled detections of image and sweep, for `joined`."""


Stamp = tuple[tuple[int, int] | None, ...]
"""Time of the last change and length of each file of a frame; None: the file is missing."""


class PartMaker:
    """Maker of answers, with the samples and networks used last; one in each worker process."""

    def __init__(
        self,
        dataset: SampleDataset,
        data: Path,
        engine: EngineChoice,
        *,
        whole: SampleDataset | None = None,
    ) -> None:
        """Store the data; networks are loaded when they are first needed.

        Args:
            dataset: Frames of the page.
            data: Folder of the data set.
            engine: Engine of the networks.
            whole: All frames, by which the limits of health are chosen. None: those of the page.
        """
        self._whole = whole or dataset
        self._dataset, self._data, self.engine = dataset, data, engine
        self._positions = {name: index for index, name in enumerate(dataset.sample_ids)}
        self._samples: OrderedDict[tuple[Breakage, Stamp], CameraLidarSample] = OrderedDict()
        self._predictors: OrderedDict[tuple[str, str], Predictor] = OrderedDict()
        self._files: list[dict[str, Path]] = []
        self._read_once = {path: _file_stamp(path) for path in shared_calibration(dataset)}

    def make(self, task: Task) -> Answer:
        """Compute a part.

        Raises:
            ValueError: The frame cannot be read, or its sensors give nothing to work on; or a raw
                drive's calibration, which is read once, has changed.
        """
        for path, stamp in self._read_once.items():
            if _file_stamp(path) != stamp:
                raise FileError(path, "has changed since the page was started", "start it again")
        sample = self._broken(task.state.broken)
        if task.part == "scene":
            sound = self._broken(Breakage(frame=task.state.broken.frame))
            return _scene(sample, sound)
        if task.part == "health":
            return Answer(content=self._health(sample))
        if task.part == JOINED:
            return self._joined(sample, task)
        return self._predicted(sample, task)

    def stamp(self, frame: str) -> Stamp:
        """Times and lengths of a frame's files: answers of other ones are out of date."""
        return tuple(map(_file_stamp, (*self._paths(frame).values(), *self._read_once)))

    @cached_property
    def limits(self) -> ChosenLimits:
        """Limits of the sensors' health, as chosen by `sightline health`."""
        chosen = choose_for_dataset(self._whole)
        if describe_sparse_maps(self._whole, self._data) is None:
            return chosen
        doubt = "scores of sparse depth maps, which are used as sweeps, mean nothing"
        return replace(chosen, lidar=f"{chosen.lidar}; {doubt}")

    def _health(self, sample: CameraLidarSample) -> dict[str, Any]:
        limits = self.limits
        judged = health_json(HealthMonitor(limits.limits)(sample))
        return {**judged, "limits": {"camera": limits.camera, "lidar": limits.lidar}}

    def _paths(self, frame: str) -> dict[str, Path]:
        self._files = self._files or list_sample_files(self._dataset)
        return self._files[self._positions[frame]]

    def _broken(self, broken: Breakage) -> CameraLidarSample:
        key = broken, self.stamp(broken.frame)
        return _kept(self._samples, key, _KEPT_SAMPLES, lambda: self._read(broken))

    def _read(self, broken: Breakage) -> CameraLidarSample:
        sound = Breakage(frame=broken.frame)
        if broken != sound:
            return break_sample(self._broken(sound), broken)
        check_inside(self._paths(broken.frame).values(), self._data)
        return self._dataset[self._positions[broken.frame]]

    def _predictor(self, task: str, weights: str) -> Predictor:
        def load() -> Predictor:
            found = find_task(task)
            is_method = weights in found.methods
            return found.predictor(
                method=weights if is_method else None,
                weights=None if is_method else weights,
                engine=self.engine,
                threads=1,
            )

        return _kept(self._predictors, (task, weights), _KEPT_PREDICTORS, load)

    def _predicted(self, sample: CameraLidarSample, task: Task) -> Answer:
        weights = task.state.weights_for(task.part)
        if weights == LEFT_OUT:
            return Answer(content={"by": LEFT_OUT})
        predictor = self._predictor(task.part, weights)
        lacks = lacking_parts(predictor, sample)
        content: dict[str, Any] = {"by": predictor.name}
        digest = predictor.made_by.get("weights_sha256", "")
        if lacks:
            nothing = pickle.dumps((None, digest))
            return Answer(content={**content, "lacks": list(lacks)}, found=nothing)
        prediction = predictor(sample)
        perception = find_task(task.part).perception(prediction)
        key = {"depth-completion": "depth"}.get(task.part, f"{task.part[:9]}s{task.part[9:]}")
        content[key] = perception.to_json()[key]
        if perception.depth is not None:
            return Answer(content=content, files=_depth_files(perception.depth))
        for gate in ("camera_gate", "lidar_gate"):
            values = getattr(prediction, gate, None)
            if values is not None:
                content[gate] = np.rint(100 * values.numpy()).astype(int).tolist()
        kept = perception.detections2d or perception.detections3d
        return Answer(content=content, found=pickle.dumps((kept, digest)))

    def _joined(self, sample: CameraLidarSample, task: Task) -> Answer:
        given = [pickle.loads(each) if each else (None, "") for each in task.found]  # noqa: S301 - own
        (found2d, digest2d), (found3d, digest3d) = given
        models = fitted_models(digest2d, digest3d)
        if models is None or (found2d is None and found3d is None):
            return Answer(content={"objects": None})
        weights = task.state.weights_for("detection3d")
        refine = refiner_of(None if found3d is None else self._predictor("detection3d", weights))
        objects = join_detections(sample, found2d, found3d, models, refine=refine)
        return Answer(content={"objects": objects.to_json()})


def check_inside(paths: Iterable[Path], data: Path) -> None:
    """Refuse files of a frame that lie outside the data, by a link.

    Raises:
        FileError: There is such a file.
    """
    root = data.resolve()
    for path in paths:
        if not path.resolve().is_relative_to(root):
            raise FileError(
                path, "is a link that leads out of the data", "copy the file into the data"
            )


def health_json(health: SampleHealth) -> dict[str, Any]:
    """Convert the health of a sample to JSON."""
    judged = {"camera": health.camera, "lidar": health.lidar, "alignment": health.alignment}
    return {
        **{
            name: each and {"score": round(each.score, _FEW_DIGITS), "worst": each.worst_check}
            for name, each in judged.items()
        },
        "yaw_deg": None if health.yaw_deg is None else round(health.yaw_deg, _FEW_DIGITS),
        "camera_regions": health.camera_regions.astype(int).tolist(),
    }


def _scene(sample: CameraLidarSample, sound: CameraLidarSample) -> Answer:
    """Describe a broken sample, with its picture and points."""
    height, width = sample.image_size
    image = rgb_of(sample)
    if image is None:
        image = np.zeros((height, width, 3), np.uint8)
    projection = sample.calibration.image_from_lidar
    content = {
        "frame": sample.sample_id,
        "timestamp_s": sample.timestamp_s,
        "image_size_px": [height, width],
        "sensors": {sensor: sensor not in sample.missing_sensors for sensor in SENSOR_FIELDS},
        "num_points": None if sample.points is None else len(sample.points),
        "image_from_lidar": projection.tolist(),
        "labels": None if sample.objects is None else _labels(sample.objects),
    }
    packed = gzip.compress(pack_points(sample.points, sound.points), _GZIP_LEVEL, mtime=0)
    files = {"image": _jpeg(image), "points": packed}
    return Answer(content=content, files=files)


def _labels(labels: ObjectLabels) -> list[dict[str, Any]]:
    has_box3d = labels.has_box3d.tolist()
    boxes2d, boxes3d = labels.boxes2d.tensor.tolist(), labels.boxes3d.tensor.tolist()
    return [
        {
            "class": name,
            "box_px": [round(each, 1) for each in boxes2d[index]],
            "box_3d": [round(each, 3) for each in boxes3d[index]] if has_box3d[index] else None,
        }
        for index, name in enumerate(labels.class_names)
    ]


def _depth_files(depth: DepthMap) -> dict[str, bytes]:
    files = {"depth": _jpeg(draw_depth(depth))}
    if depth.uncertainty_m is not None:
        coloured = colorize_depth(depth.uncertainty_m, scale=UNCERTAINTY_SCALE)
        files["uncertainty"] = _jpeg(coloured)
    return files


def _jpeg(rgb: UInt8[np.ndarray, "height width 3"]) -> bytes:
    _, encoded = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), _JPEG)
    return encoded.tobytes()


def _file_stamp(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


def _kept(
    kept: OrderedDict[_Key, _Value], key: _Key, most: int, make: Callable[[], _Value]
) -> _Value:
    """Value of a key among those used last, or a new one."""
    if key not in kept:
        kept[key] = make()
    kept.move_to_end(key)
    while len(kept) > most:
        kept.popitem(last=False)
    return kept[key]
