"""Registry of the tasks, with their weights, recipes, predictors and exports.

The only module that knows all tasks. It imports a task on first use, and a task's own module
imports PyTorch only for computations.
"""

import importlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol, get_args, runtime_checkable

from sightline.depth_completion.method_names import Method
from sightline.export.names import EngineChoice
from sightline.files.plain_text import shortened
from sightline.files.weights_header import find_weights, read_description, shipped_names
from sightline.geometry.wrong_types import named_arguments

if TYPE_CHECKING:
    from sightline.depth_completion import registration as depth_completion
    from sightline.detection2d import registration as detection2d
    from sightline.detection3d import registration as detection3d
    from sightline.export.graph import ExportGraph
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
"""Location of each task's object: "module:object"."""

PACKAGE_RECIPES: Final = Path(__file__).parent / "recipes"
"""Recipes that `sightline fit --config` knows by name."""


LINE_KEYS: Final = (
    "frame",
    "timestamp_s",
    "image_size_px",
    "sensors",
    "num_points",
    "tasks",
    "undone_turn",
    "objects",
    "detections2d",
    "detections3d",
    "depth",
)
"""Keys of a line of `perceive`, which outputs of tasks (`Output.further`) must not use."""


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
        """Training class, which identifies the task's recipes: "package.module.Class"."""
        ...

    @property
    def trial_settings(self) -> "dict[str, str]":
        """Settings that make a training by any of its recipes small, for tests."""
        ...

    @property
    def default_weights(self) -> str | None:
        """Default weights; None: weights or a method must be given."""
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
    def detects_around(self) -> bool:
        """Support of the task for whole turns of the LiDAR (`CameraLidarSample.all_around`)."""
        ...

    @property
    def switches(self) -> "tuple[OutputFilter, ...]":
        """Optional filters of the written predictions."""
        ...

    def config_type(self) -> type[Any]:
        """Dataclass of the network's settings."""
        ...

    def build(self, config: Any) -> Any:  # noqa: ANN401 - each task's own
        """Build the network (`nn.Module`) from settings."""
        ...

    def graphs(self, loaded: "LoadedNetwork[Any]") -> "tuple[ExportGraph, ...]":
        """List the graphs to export from a network; two for a two-stage detector."""
        ...

    def predictor(
        self,
        *,
        method: str | None = None,
        weights: str | Path | None = None,
        engine: EngineChoice = "torch",
        device: str = "cpu",
        threads: int | None = None,
    ) -> "Predictor":
        """Make a predictor of a method or of a network's weights; by default the default weights.

        Raises:
            ValueError: Both are given, one does not exist, or the engine cannot run it.
        """
        ...

    def scoring(self) -> "Scoring":
        """Create the scoring of its predictions with broken sensors."""
        ...

    def perception(self, prediction: Any) -> "Perception":  # noqa: ANN401 - the task's own
        """Convert a prediction to the form common to all tasks, for pictures and summaries."""
        ...

    def demo(self, frames: Path, out: Path) -> "DemoPart | None":
        """Run the task on the packaged frames and draw its results; None: nothing to show."""
        ...


if TYPE_CHECKING:
    _CHECKED: tuple[Task, ...] = (depth_completion.TASK, detection2d.TASK, detection3d.TASK)


def task_names() -> tuple[str, ...]:
    """Names of the tasks, the default task first."""
    return tuple(REGISTRY)


def find_task(name: str) -> Task:
    """Find a task by name.

    Raises:
        ValueError: There is no such task.
    """
    if name not in REGISTRY:
        raise ValueError(f"there is no task {name}; name one of {', '.join(REGISTRY)}")
    module, _, attribute = REGISTRY[name].partition(":")
    task = getattr(importlib.import_module(module), attribute)
    fault = _task_fault(task)
    if fault is not None:
        raise ValueError(f"{REGISTRY[name]} {fault}; see docs/adding.md, A task")
    declared: Task = task
    return declared


def _task_fault(task: Any) -> str | None:  # noqa: ANN401 - perhaps no task
    """Describe how an object breaks `Task`, as the rest of a sentence; None: it does not."""
    if isinstance(task, type):
        return f"is a class, expected an object of it; write {task.__name__}()"
    members = [member for member in vars(Task) if not member.startswith("_")]
    absent = [member for member in members if not hasattr(task, member)]
    if absent:
        return f"lacks {', '.join(absent)} of sightline.tasks.Task"
    if not task.outputs:
        return "has no outputs, expected one at least"
    for noun, names in (
        ("name", [output.name for output in task.outputs]),
        ("key", [output.further for output in task.outputs if output.further]),
    ):
        if len(set(names)) < len(names):
            return f"has two outputs of one {noun}: {', '.join(names)}"
    for output in task.outputs:
        if not output.name.isidentifier():
            return f"has an output named {output.name!r}, expected letters, digits and _"
        if not output.suffix.startswith("."):
            return (
                f"has the output {output.name} with suffix {output.suffix!r}, expected a dot first"
            )
        if output.further in LINE_KEYS:
            return (
                f"has the output {output.name} with the key {output.further}, which lines of "
                "perceive use already; choose another"
            )
    return None


def further_keys(names: Iterable[str]) -> tuple[str, ...]:
    """Keys of `Perception.further` declared by these tasks."""
    outputs = [output for name in names for output in find_task(name).outputs]
    return tuple(output.further for output in outputs if output.further)


def choose_task(name: str | None, weights: str | Path | None) -> Task:
    """Find the task by name, else by the weights, else the default task.

    Raises:
        ValueError: There is no such task, or there are no such weights.
    """
    if name is not None:
        return find_task(name)
    if weights is None:
        return find_task(task_names()[0])
    from sightline.files.weights import read_weights

    path = find_weights(weights)
    task_name = read_weights(path).task
    if task_name not in REGISTRY:
        raise ValueError(
            f"{path} holds weights for {shortened(task_name)}, a task that this version does not "
            f"have; it has {', '.join(REGISTRY)}"
        )
    return find_task(task_name)


@named_arguments
def load(
    weights: str | Path,
    *,
    engine: EngineChoice = "auto",
    device: str = "cpu",
    threads: int | None = None,
) -> "Predictor":
    """Load a predictor from weights of any task.

    Examples:
        >>> import sightline
        >>> predictor = sightline.load("depth-fast-cpu")
        >>> predictor.name, predictor.parts
        ('depth-fast-cpu', ('image', 'points'))

    It takes a `CameraLidarSample` and returns a `DepthMap`, a `DetectionResult` or `Detections3D`.
    The predictor "joined" runs both detectors, and returns a `Perception` with objects.

    Args:
        weights: Name of weights in the package (`sightline tasks` lists them), or a file
            (.safetensors, .ckpt).
        engine: Engine of the network: torch, onnxruntime or openvino; auto is openvino on the CPU
            if it is installed, else torch. For openvino and onnxruntime, weights are converted when
            they are first loaded, which takes some ten seconds, and stored in the user's cache
            folder.
        device: Device for PyTorch: cpu or cuda.
        threads: Number of CPU threads; None: the engine's default.

    Raises:
        TypeError: The weights are neither a name nor a path.
        ValueError: There are no such weights, this version does not have their task, or the engine
            is not installed or cannot run on the device.
    """
    from sightline.joining.models import JOINED

    if weights == JOINED:
        from sightline.joining.predictor import JoinedPredictor

        return JoinedPredictor.load(engine=engine, device=device, threads=threads)
    if weights in get_args(Method) and not Path(weights).exists():
        raise ValueError(
            f"{weights} is a method of depth completion without weights; make "
            f'DepthCompleter("{weights}") of sightline.depth_completion.predictor'
        )
    task = choose_task(None, find_weights(weights))
    return task.predictor(weights=weights, engine=engine, device=device, threads=threads)


def weights_of(task: Task) -> tuple[str, ...]:
    """Names of the package's weights for a task."""
    return tuple(
        name for name in shipped_names() if read_description(find_weights(name)).task == task.name
    )


def recipes_of(task: Task) -> tuple[str, ...]:
    """Names of the recipes that train a task."""
    paths = PACKAGE_RECIPES.glob("*.yaml")
    trained = (path.stem for path in paths if task.training_class in path.read_text().split())
    return tuple(sorted(trained))
