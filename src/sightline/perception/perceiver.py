"""Several tasks' answers to one frame."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from sightline.export.names import EngineChoice
from sightline.inference.predictor import Predictor, lacking_parts
from sightline.inference.sample_predictor import SamplePredictor
from sightline.structures.predictions import Perception
from sightline.structures.sample import CameraLidarSample
from sightline.tasks import REGISTRY, find_task, task_names

if TYPE_CHECKING:
    from sightline.data.object_tree import Part

LEFT_OUT: Final = "none"
"""Named as a task's weights: the task is not asked."""

_SENSOR_PARTS: "Final[tuple[Part, ...]]" = ("image", "points")


@dataclass(frozen=True, kw_only=True, slots=True)
class FrameAnswers:
    """What tasks made of one frame."""

    answers: Mapping[str, Any]
    """By task; of those that had an answer."""
    lacks: "Mapping[str, tuple[Part, ...]]"
    """The others, with the parts of the sample that they would have needed."""
    milliseconds: Mapping[str, float]
    """How long each answer took, loading and writing aside; the first one of a process includes
    the start of its engine."""

    @property
    def perception(self) -> Perception:
        """What the answers tell, in the terms that all tasks share."""
        return Perception.joined(
            find_task(name).perception(answer) for name, answer in self.answers.items()
        )


class Perceiver(SamplePredictor[Perception]):
    """Asks several tasks about a frame: those that can do without a sensor go on where it fails.

    Examples:
        >>> import dataclasses, sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> sample = sightline.open_dataset(PACKAGED_FRAMES)[0]
        >>> weights = {"detection2d": "detection2d-fast-cpu", "depth-completion": "depth-fast-cpu"}
        >>> perceiver = sightline.Perceiver.load(weights)
        >>> found = perceiver(sample)
        >>> found.detections3d.boxes.tensor.shape[1], found.depth.depth_m.shape == sample.image_size
        (7, True)
        >>> blind = perceiver(dataclasses.replace(sample, points=None))  # the LiDAR is dead
        >>> "Car" in blind.detections2d.class_names, blind.detections3d, blind.depth
        (True, None, None)

    May be pickled, and called in a forked process.
    """

    def __init__(self, predictors: Mapping[str, Predictor]) -> None:
        """Takes each task's predictor, by the task's name.

        Raises:
            ValueError: There is none, or no such task.
        """
        if not predictors:
            raise ValueError(f"all tasks are left out; ask at least one of {', '.join(REGISTRY)}")
        for name in predictors:
            find_task(name)
        self.predictors: Final = dict(predictors)

    @classmethod
    def load(
        cls,
        weights: Mapping[str, str | Path | None] | None = None,
        *,
        engine: EngineChoice = "auto",
        device: str = "cpu",
        threads: int | None = None,
    ) -> "Perceiver":
        """Loads weights for each task: those that are named, else the task's default.

        Args:
            weights: By task: the name of weights that come with the package, a file, the name of
                one of the task's methods, or "none" or None: the task is left out.
            engine: What runs the networks: torch, onnxruntime or openvino; auto is openvino where
                it is installed, on the CPU, and torch elsewhere.
            device: cpu or cuda, where PyTorch runs them.
            threads: Of the CPU; None: the engine's own choice.

        Raises:
            ValueError: There is no such task or are no such weights, all tasks are left out, or
                the engine is not installed or cannot run on the device.
        """
        if weights is not None and not isinstance(weights, Mapping):
            raise ValueError(
                f"weights is of type {type(weights).__name__}, expected a dictionary such as "
                "{'depth-completion': 'depth-best'}: name weights for each task"
            )
        named = dict(weights or {})
        for name in named:
            find_task(name)
        predictors = {}
        for name in task_names():
            task = find_task(name)
            chosen = named.get(name, task.default_weights)
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
        return cls(predictors)

    @property
    def parts(self) -> "tuple[Part, ...]":
        """What its tasks look at of a sample, together."""
        seen = {part for predictor in self.predictors.values() for part in predictor.parts}
        return tuple(part for part in _SENSOR_PARTS if part in seen)

    def predict(self, sample: CameraLidarSample) -> Perception:
        """What the tasks tell of a sample; nothing of those that lack a sensor."""
        return self.answer(sample).perception

    def answer(self, sample: CameraLidarSample) -> FrameAnswers:
        """The tasks' own answers, and how long they took."""
        answers, lacks, milliseconds = {}, {}, {}
        for name, predictor in self.predictors.items():
            missing = lacking_parts(predictor, sample)
            if missing:
                lacks[name] = missing
                continue
            start = time.perf_counter()
            answers[name] = predictor(sample)
            milliseconds[name] = 1000 * (time.perf_counter() - start)
        return FrameAnswers(answers=answers, lacks=lacks, milliseconds=milliseconds)
