"""Predictions of several tasks for one frame."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.export.names import EngineChoice
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments
from sightline.inference.predictor import Predictor, check_predictor, lacking_parts
from sightline.inference.sample_predictor import SamplePredictor
from sightline.joining.alignment import Alignment, AlignmentConfig
from sightline.joining.alignment_by_boxes import turn_by_boxes
from sightline.joining.config import JoinConfig
from sightline.joining.join import join_detections
from sightline.joining.models import (
    JOINED,
    JoinModels,
    fitted_models,
    read_models,
)
from sightline.joining.recording import measure_recording
from sightline.joining.refining import refiner_of
from sightline.structures.lidar_turn import LidarTurn, undo_turn
from sightline.structures.objects import Objects
from sightline.structures.predictions import Detections2D, Detections3D, Perception
from sightline.structures.sample import SENSOR_FIELDS, CameraLidarSample, copy_of_sensors
from sightline.tasks import REGISTRY, find_task, task_names

if TYPE_CHECKING:
    from sightline.data.layouts.kitti_trees import Part

SWEEP_TASK: Final = "detection3d"
_JOINED_TASKS: Final = ("detection2d", SWEEP_TASK)
LEFT_OUT: Final = "none"
"""Name of weights that disables a task."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FramePredictions:
    """Predictions of tasks for one frame."""

    by_task: Mapping[str, Any]
    """Predictions by task, for the tasks that made one."""
    lacks: "Mapping[str, tuple[Part, ...]]"
    """Missing parts of the sample by task, for the tasks without a prediction."""
    milliseconds: Mapping[str, float]
    """Time of each prediction by task, without loading and writing; the first one of a process
    includes the start of its engine."""
    objects: Objects | None = None
    """Objects joined from both detectors; None: not joined."""
    undone_turn: LidarTurn | None = None
    """Rotation of the LiDAR by which the frame's calibration was corrected; None: not corrected."""

    @property
    def perception(self) -> Perception:
        """The predictions in the format shared by all tasks."""
        perception = Perception.joined(
            find_task(name).perception(prediction) for name, prediction in self.by_task.items()
        )
        return replace(perception, objects=self.objects, undone_turn=self.undone_turn)


class MultiTaskPredictor(SamplePredictor[Perception]):
    """Predictor of several tasks; if a sensor fails, the tasks that do not need it continue.

    Examples:
        >>> import dataclasses, sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> sample = sightline.open_dataset(PACKAGED_FRAMES)[0]
        >>> weights = {"detection2d": "detection2d-fast-cpu", "depth-completion": "depth-fast-cpu"}
        >>> perceiver = sightline.MultiTaskPredictor.load(weights)
        >>> found = perceiver(sample)
        >>> found.detections3d.boxes.tensor.shape[1], found.depth.depth_m.shape == sample.image_size
        (7, True)
        >>> blind = perceiver(dataclasses.replace(sample, points=None))  # the LiDAR is dead
        >>> "Car" in blind.detections2d.class_names, blind.detections3d
        (True, None)
        >>> blind.depth.valid.any().item(), blind.depth.guessed.all().item()  # from the image
        (False, True)

    Objects are joined from the detections if there are models for the weights of both detectors.
    Can be pickled, and called in a forked process.
    """

    @named_arguments
    def __init__(
        self,
        predictors: Mapping[str, Predictor],
        alignment: Alignment | None = None,
        join_models: JoinModels | None = None,
    ) -> None:
        """Store the predictors by task name.

        Args:
            predictors: Predictors by task name.
            alignment: State of the LiDAR's mount, as `aligned` measures it. None: not measured.
            join_models: Models of joined scores. None: the included ones for both detectors.

        Raises:
            ValueError: There are no predictors, there is no such task, or the models were fitted
                for other weights.
        """
        if not predictors:
            raise ValueError(f"all tasks are left out; use at least one of {', '.join(REGISTRY)}")
        for name, predictor in predictors.items():
            find_task(name)
            check_predictor(predictor)
            own = getattr(predictor, "network_task", None)
            if own is not None and own.name != name:
                raise ValueError(f"{predictor.name} is of task {own.name}, not {name}; name that")
        self.predictors: Final = dict(predictors)
        self.join_models: Final = _models_for(self._detector_weights, join_models)
        self.alignment: Final = alignment

    @classmethod
    @named_arguments
    def load(
        cls,
        weights: Mapping[str, str | Path | None] | None = None,
        *,
        joined: str | Path | None = None,
        engine: EngineChoice = "auto",
        device: str = "cpu",
        threads: int | None = None,
    ) -> "MultiTaskPredictor":
        """Load weights for each task: the given ones, else the task's default.

        Args:
            weights: Weights by task: the name of weights in the package, a file, the name of one of
                the task's methods, or "none" or None to leave the task out.
            joined: File of models of joined scores for these weights, from `sightline fit-joined`.
                None: those included in the package.
            engine: Engine of the networks: torch, onnxruntime or openvino; auto is openvino on the
                CPU if it is installed, else torch.
            device: Device for PyTorch: cpu or cuda.
            threads: Number of CPU threads; None: the engine's default.

        Raises:
            ValueError: A task or weights do not exist, all tasks are left out, or the engine is not
                installed or cannot run on the device.
        """
        if weights is not None and not isinstance(weights, Mapping):
            raise ValueError(
                f"weights is of type {type(weights).__name__}, expected a dictionary such as "
                "{'depth-completion': 'depth-best'}: give weights by task name"
            )
        join_models = None if joined is None else read_models(Path(joined))
        given = dict(weights or {})
        for name in given:
            find_task(name)
        predictors = {}
        for name in task_names():
            task = find_task(name)
            chosen = given.get(name, task.default_weights)
            if chosen is None or str(chosen) == LEFT_OUT:
                continue
            is_method = str(chosen) in task.methods
            predictors[name] = task.predictor(
                method=str(chosen) if is_method else None,
                weights=None if is_method else chosen,
                engine=engine,
                device=device,
                threads=threads,
            )
        return cls(predictors, join_models=join_models)

    @named_arguments
    def aligned(
        self,
        samples: Sequence[CameraLidarSample] | SampleDataset,
        config: AlignmentConfig | None = None,
    ) -> "MultiTaskPredictor":
        """Make a predictor whose tasks get frames with the LiDAR's measured rotation undone.

        As `JoinedPredictor.aligned`. If frames disagree or sweeps are late, only the joined objects
        know of it.

        Args:
            samples: Frames of one recording, of which up to 15 are read, evenly spread.
            config: Biases and limits. None: those for KITTI's rig.
        """
        alignment = measure_recording(samples, self._detect, config or AlignmentConfig())
        if self.join_models is None:
            alignment = Alignment(turn=alignment.turn)
        return self.with_alignment(alignment)

    def with_alignment(self, alignment: Alignment) -> "MultiTaskPredictor":
        """Make a predictor with the same tasks and another state of the LiDAR's mount."""
        return MultiTaskPredictor(self.predictors, alignment, self.join_models)

    @property
    def lacks_models(self) -> bool:
        """Check if objects are not joined though both detectors are networks."""
        return len(self._detector_weights) == len(_JOINED_TASKS) and self.join_models is None

    @property
    def models_entry(self) -> dict[str, str]:
        """Entry of a manifest with the checksum of models of joined scores that are not shipped."""
        shipped = _models_for(self._detector_weights, None)
        if self.join_models in (None, shipped):
            return {}
        return {"joined": self.join_models.identity["numbers_sha256"]}

    @property
    def _detector_weights(self) -> list[tuple[str, str]]:
        """Name and SHA-256 of each detector's weights; none for one that is no network."""
        detectors = [self.predictors[name] for name in _JOINED_TASKS if name in self.predictors]
        named = [(each.name, each.made_by.get("weights_sha256", "")) for each in detectors]
        return [(name, sha256) for name, sha256 in named if sha256]

    @property
    def parts(self) -> "tuple[Part, ...]":
        """Parts of a sample that its tasks use."""
        used = {part for predictor in self.predictors.values() for part in predictor.parts}
        return tuple(part for part in SENSOR_FIELDS.values() if part in used)

    @named_arguments
    def predict(self, sample: CameraLidarSample) -> Perception:
        """Predict with all tasks; tasks that lack a sensor contribute nothing."""
        return self.predict_by_task(sample).perception

    @named_arguments
    def predict_by_task(self, sample: CameraLidarSample) -> FramePredictions:
        """Return the tasks' own predictions and their times, without the rotation."""
        alignment = self.alignment or Alignment()
        turn = alignment.turn
        sample = undo_turn(sample, turn)
        by_task, lacks, milliseconds = {}, {}, {}
        for name, predictor in self.predictors.items():
            missing = lacking_parts(predictor, sample)
            if missing:
                lacks[name] = missing
                continue
            start = time.perf_counter()
            by_task[name] = predictor(copy_of_sensors(sample))
            milliseconds[name] = 1000 * (time.perf_counter() - start)
        predictions = FramePredictions(
            by_task=by_task, lacks=lacks, milliseconds=milliseconds, undone_turn=turn or None
        )
        if self.join_models is None or not by_task.keys() & set(_JOINED_TASKS):
            return predictions
        start = time.perf_counter()
        found = predictions.perception
        if alignment.by_boxes:
            turn = turn_by_boxes(sample, found.detections2d, found.detections3d)
            sample = undo_turn(sample, turn)
        objects = join_detections(
            sample,
            found.detections2d,
            found.detections3d,
            self.join_models,
            JoinConfig(sweep_in_image=not alignment.late),
            refiner_of(self.predictors.get(SWEEP_TASK)),
        )
        milliseconds[JOINED] = 1000 * (time.perf_counter() - start)
        return replace(predictions, objects=objects, undone_turn=turn or None)

    def _detect(self, sample: CameraLidarSample) -> tuple[Detections2D | None, Detections3D | None]:
        """Detections of both detectors; None: it was left out or lacks a sensor."""
        found = Perception.joined(
            find_task(name).perception(self.predictors[name](sample))
            for name in _JOINED_TASKS
            if name in self.predictors and not lacking_parts(self.predictors[name], sample)
        )
        return found.detections2d, found.detections3d

    def answer(self, sample: CameraLidarSample) -> FramePredictions:
        """Deprecated name of `predict_by_task`."""
        warn_user("answer is now predict_by_task", DeprecationWarning)
        return self.predict_by_task(sample)


def _models_for(weights: Sequence[tuple[str, str]], given: JoinModels | None) -> JoinModels | None:
    """Check the given models of joined scores, or find the included ones; None: there are none."""
    if len(weights) < len(_JOINED_TASKS):
        if given is not None:
            raise ValueError("models of joined scores need both detectors; leave them out")
        return None
    if given is None:
        return fitted_models(*(sha256 for _, sha256 in weights))
    given.check_fit(*weights)
    return given
