"""Interfaces of predictors and their outputs; imports neither PyTorch nor any task."""

import json
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FunctionType, MethodType
from typing import TYPE_CHECKING, Any, Final, Protocol, runtime_checkable

from sightline.geometry.arguments import check_collection, type_name
from sightline.geometry.user_warning import warn_user

if TYPE_CHECKING:
    from sightline.data.layouts.kitti_trees import Part
    from sightline.structures.predictions import Perception
    from sightline.structures.sample import CameraLidarSample


@runtime_checkable  # for beartype, which checks arguments under pytest
class Predictor(Protocol):
    """Predictor of a task for one sample, by a network or by a method without training.

    Must be picklable on systems that spawn workers (macOS, Windows).
    """

    @property
    def name(self) -> str:
        """Name of the method or of the weights."""
        ...

    @property
    def parts(self) -> "Collection[Part]":
        """Used parts of a sample."""
        ...

    @property
    def needs(self) -> "Collection[Part]":
        """Required parts of a sample."""
        ...

    @property
    def gives(self) -> Collection[str]:
        """Names of the task's outputs that it predicts."""
        ...

    @property
    def made_by(self) -> Mapping[str, str]:
        """Further entries of a manifest, beside the name: e.g. the weights' hash and the engine.

        Results of an earlier run are kept where name and entries are the same: change one whenever
        the predictor changes. Kept results without entries give a warning.
        """
        ...

    def __call__(self, sample: "CameraLidarSample") -> Any:  # noqa: ANN401 - each task's own
        """Predict for a sample.

        Raises:
            ValueError: The sample lacks a required part.
        """
        ...


_MEMBERS: Final = ("name", "parts", "needs", "gives", "made_by")


def check_predictor(predictor: object) -> None:
    """Check the members that a predictor declares, before the first sample.

    Raises:
        ValueError: It is none, a class or a function, or lacks a member; or its names or its
            entries of a manifest are no text.
    """
    if predictor is None or isinstance(predictor, type | FunctionType | MethodType):
        raise ValueError(
            f"the predictor is {_described(predictor)}, expected an object of "
            "sightline.inference.predictor.Predictor; return one, made by its constructor"
        )
    kind = type(predictor).__name__
    lacking = [each for each in (*_MEMBERS, "__call__") if not hasattr(predictor, each)]
    if lacking:
        raise ValueError(
            f"the predictor is of type {type_name(predictor)}, which lacks {', '.join(lacking)}; "
            "give it all members of sightline.inference.predictor.Predictor"
        )
    name, *collections, made_by = (getattr(predictor, member) for member in _MEMBERS)
    if not isinstance(name, str):
        raise ValueError(f"{kind}.name is of type {type_name(name)}, expected text; give str(..)")
    for member, values in zip(_MEMBERS[1:-1], collections, strict=True):
        check_collection(f"{kind}.{member}", values)
        if not isinstance(values, Collection):
            given = f"{kind}.{member} is of type {type_name(values)}"
            raise ValueError(f"{given}, expected a tuple; give () for none")
    if not isinstance(made_by, Mapping):
        given = f"{kind}.made_by is of type {type_name(made_by)}"
        raise ValueError(f"{given}, expected a dictionary; give {{}} for none")
    for entry, value in made_by.items():
        try:
            json.dumps(value)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"{kind}.made_by[{entry!r}] is of type {type_name(value)}, expected text for "
                "manifests; give str(..)"
            ) from error


def warn_of_unversioned(predictors: Iterable[Predictor], kept: int, *, remedy: str) -> None:
    """Warn if results are kept of predictors that do not say by what they were made.

    Sightline's own methods are left out: their results name the version of Sightline.

    Args:
        predictors: Predictors of the job.
        kept: Number of results of earlier runs that the job keeps.
        remedy: Continuation of the warning.
    """
    own = [each for each in predictors if not type(each).__module__.startswith("sightline.")]
    unversioned = [each.name for each in own if not each.made_by]
    if kept and unversioned:
        warn_user(
            f"{kept:,} results of earlier runs are kept, and made_by of {', '.join(unversioned)} "
            "is empty, so they may come from another state of it: enter a version or the weights' "
            f"checksum in made_by; {remedy}",
        )


def _described(predictor: object) -> str:
    """Describe what is no object of a predictor."""
    if predictor is None:
        return "None"
    kind = "class" if isinstance(predictor, type) else "function"
    return f"the {kind} {getattr(predictor, '__name__', '')}"


@dataclass(frozen=True, kw_only=True, slots=True)
class Output:
    """Kind of file that a task writes for each sample."""

    name: str
    """Name, e.g. depth; also the flag for the folder, except for a task's first output."""
    suffix: str
    """Suffix of the files, with its dot."""
    summary: str
    """Contents of the folder, in one sentence."""
    write: "Callable[[Path, CameraLidarSample, Any], None]"
    """Function that writes the prediction for a sample atomically; picklable."""
    read: "Callable[[Path, CameraLidarSample, Perception], Perception] | None" = None
    """Function that adds the contents of a file to the perception from the outputs before this one;
    None: the file contains nothing to draw."""
    remark: "Callable[[Any], str] | None" = None
    """Fact about a prediction that its file does not hold, as the rest of a sentence, such as "hold
    guesses"; empty: none. Commands count it."""
    further: str = ""
    """Key of the prediction in `Perception.further`, and of lines; empty: boxes or depth."""


def lacking_parts(predictor: Predictor, sample: "CameraLidarSample") -> "tuple[Part, ...]":
    """Missing parts of a sample that prevent a prediction; empty: a prediction is possible.

    These are the missing required parts; for a predictor without required parts, all its parts if
    the sample has none of them.
    """
    absent = [part for part in predictor.parts if getattr(sample, part) is None]
    if len(absent) == len(predictor.parts):
        return tuple(absent)
    return tuple(part for part in absent if part in predictor.needs)


@dataclass(frozen=True, kw_only=True, slots=True)
class OutputFilter:
    """Optional change of a task's written predictions, off by default."""

    name: str
    """Name, e.g. valid_only; also the flag and the entry in manifests."""
    summary: str
    """Effect on the files, in one sentence."""
    change: Callable[[Any], Any]
    """Changes a prediction before it is written; picklable."""


@runtime_checkable
class PredictingTask(Protocol):
    """Part of a task's interface that concerns its predictions."""

    @property
    def name(self) -> str:
        """Name of the task in manifests."""
        ...

    @property
    def outputs(self) -> tuple[Output, ...]:
        """Outputs to write; the first is the main one."""
        ...

    @property
    def switches(self) -> tuple[OutputFilter, ...]:
        """Optional changes of the written predictions."""
        ...
