"""The tasks by name, and what belongs to each: weights, recipes, predictors, exports.

The one place that knows all tasks. Light: a task is imported when it is asked for, and its own
module imports PyTorch only where it computes.
"""

import importlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol, runtime_checkable

from sightline.files.plain_text import shortened
from sightline.files.weights_header import find_weights, read_description, shipped_names
from sightline.geometry.wrong_types import named_arguments

if TYPE_CHECKING:
    from sightline.depth_completion import registration as depth_completion
    from sightline.detection2d import registration as detection2d
    from sightline.detection3d import registration as detection3d
    from sightline.export.graph import ExportGraph
    from sightline.export.names import EngineChoice
    from sightline.inference.demo import DemoPart
    from sightline.inference.network import LoadedNetwork
    from sightline.inference.predictor import Output, OutputFilter, Predictor
    from sightline.robustness.scoring import Scoring
    from sightline.structures.predictions import Perception

REGISTRY: Final[dict[str, str]] = {
    "depth-completion": "sightline.depth_completion.registration:TASK",
    "detection2d": "sightline.detection2d.registration:TASK",
    "detection3d": "sightline.detection3d.registration:TASK",
}
"""Where the object of each task is: "module:object"."""

PACKAGE_RECIPES: Final = Path(__file__).parent / "recipes"
"""Recipes that `sightline fit --config` knows by name."""


@runtime_checkable
class Task(Protocol):
    """Declaration of a task: an object in its folder's `registration` module."""

    @property
    def name(self) -> str:
        """Name in the registry, in weights files and in manifests."""
        ...

    @property
    def summary(self) -> str:
        """Summary of `sightline predict NAME`, one sentence."""
        ...

    @property
    def training_class(self) -> str:
        """The class of its trainings, by which its recipes are told: "package.module.Class"."""
        ...

    @property
    def trial_settings(self) -> "dict[str, str]":
        """Settings that make a training by any of its recipes small: for its tests."""
        ...

    @property
    def default_weights(self) -> str | None:
        """Default weights; None: weights or a method must be named."""
        ...

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods without a network."""
        ...

    @property
    def outputs(self) -> "tuple[Output, ...]":
        """Files written per prediction; the first always, the others on request."""
        ...

    @property
    def switches(self) -> "tuple[OutputFilter, ...]":
        """Optional filters of the written predictions."""
        ...

    def config_type(self) -> type[Any]:
        """The dataclass of the network's settings."""
        ...

    def build(self, config: Any) -> Any:  # noqa: ANN401 - each task's own
        """The network (`nn.Module`) of such settings."""
        ...

    def graphs(self, loaded: "LoadedNetwork[Any]") -> "tuple[ExportGraph, ...]":
        """Graphs to export from a network; two for a detector of two stages."""
        ...

    def predictor(
        self,
        *,
        method: str | None = None,
        weights: str | Path | None = None,
        engine: "EngineChoice" = "torch",
        device: str = "cpu",
        threads: int | None = None,
    ) -> "Predictor":
        """Make a predictor of a method or of a network's weights; by default the default weights.

        Raises:
            ValueError: Both are named, or there is no such one, or the engine cannot run it.
        """
        ...

    def scoring(self) -> "Scoring":
        """Scoring of its predictions with broken sensors."""
        ...

    def perception(self, answer: Any) -> "Perception":  # noqa: ANN401 - the task's own
        """Convert a prediction to the form common to all tasks, for pictures and summaries."""
        ...

    def demo(self, frames: Path, out: Path) -> "DemoPart | None":
        """Shows itself on the frames that come with the package; None: has nothing to show."""
        ...


if TYPE_CHECKING:
    _CHECKED: tuple[Task, ...] = (depth_completion.TASK, detection2d.TASK, detection3d.TASK)


def task_names() -> tuple[str, ...]:
    """The tasks, the one that is taken where none is named first."""
    return tuple(REGISTRY)


def find_task(name: str) -> Task:
    """The task of a name.

    Raises:
        ValueError: There is none.
    """
    if name not in REGISTRY:
        raise ValueError(f"there is no task {name}; name one of {', '.join(REGISTRY)}")
    module, _, attribute = REGISTRY[name].partition(":")
    task = getattr(importlib.import_module(module), attribute)
    assert isinstance(task, Task), f"{REGISTRY[name]} declares all that a task has"
    return task


def further_keys(names: Iterable[str]) -> tuple[str, ...]:
    """Keys of `Perception.further` that these tasks declare."""
    outputs = [output for name in names for output in find_task(name).outputs]
    return tuple(output.further for output in outputs if output.further)


def choose_task(name: str | None, weights: str | Path | None) -> Task:
    """The task that is named, else the one whose network the weights are of, else the first.

    Raises:
        ValueError: There is no such task, or there are no such weights.
    """
    if name is not None:
        return find_task(name)
    if weights is None:
        return find_task(task_names()[0])
    from sightline.files.weights import read_weights

    path = find_weights(weights)
    told = read_weights(path).task
    if told not in REGISTRY:
        raise ValueError(
            f"{path} holds weights for {shortened(told)}, a task that this version does not have; "
            f"it has {', '.join(REGISTRY)}"
        )
    return find_task(told)


@named_arguments
def load(
    weights: str | Path,
    *,
    engine: "EngineChoice" = "auto",
    device: str = "cpu",
    threads: int | None = None,
) -> "Predictor":
    """A predictor of whatever task the weights are of.

    Examples:
        >>> import sightline
        >>> predictor = sightline.load("depth-fast-cpu")
        >>> predictor.name, predictor.parts
        ('depth-fast-cpu', ('image', 'points'))

    It takes a `CameraLidarSample` and gives a `DepthMap`, a `DetectionResult` or `Detections3D`.

    Args:
        weights: Name of weights that come with the package (`sightline tasks` lists them), or a
            file (.safetensors, .ckpt).
        engine: What runs the network: torch, onnxruntime, openvino, or auto, which takes openvino
            where it is installed, on the CPU, and else torch. For openvino and onnxruntime weights
            are converted when they are first loaded, which takes some ten seconds, and kept in the
            user's cache folder.
        device: cpu or cuda, where PyTorch runs it.
        threads: Of the CPU; None: the engine's own choice.

    Raises:
        TypeError: The weights are neither a name nor a path.
        ValueError: There are no such weights, they are of no task that this version has, or the
            engine is not installed or cannot run on the device.
    """
    task = choose_task(None, find_weights(weights))
    return task.predictor(weights=weights, engine=engine, device=device, threads=threads)


def weights_of(task: Task) -> tuple[str, ...]:
    """Names of the weights that come with the package for a task."""
    return tuple(
        name for name in shipped_names() if read_description(find_weights(name)).task == task.name
    )


def recipes_of(task: Task) -> tuple[str, ...]:
    """Names of the recipes that train a task."""
    paths = PACKAGE_RECIPES.glob("*.yaml")
    trained = (path.stem for path in paths if task.training_class in path.read_text().split())
    return tuple(sorted(trained))
