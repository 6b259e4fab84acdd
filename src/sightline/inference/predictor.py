"""What answers, and what becomes of the answers; imports neither PyTorch nor any task."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

if TYPE_CHECKING:
    from sightline.data.object_tree import Part
    from sightline.structures.predictions import Perception
    from sightline.structures.sample import CameraLidarSample


@runtime_checkable  # for beartype, which checks arguments under pytest
class Predictor(Protocol):
    """A task's answer to a sample, by a network or by a method that needs none.

    Picklable where workers are started afresh (macOS, Windows).
    """

    @property
    def name(self) -> str:
        """Of the method or of the weights."""
        ...

    @property
    def parts(self) -> "Collection[Part]":
        """What it looks at of a sample."""
        ...

    @property
    def needs(self) -> "Collection[Part]":
        """Those of the parts without which it has no answer."""
        ...

    @property
    def gives(self) -> Collection[str]:
        """Names of those of the task's outputs that its answers have."""
        ...

    @property
    def made_by(self) -> Mapping[str, str]:
        """What a manifest says beside the name: the weights' hash and the engine, say."""
        ...

    def __call__(self, sample: "CameraLidarSample") -> Any:  # noqa: ANN401 - each task's own
        """Answers.

        Raises:
            ValueError: The sample lacks what is needed.
        """
        ...


@dataclass(frozen=True, kw_only=True, slots=True)
class Output:
    """One kind of file that a task writes for each sample."""

    name: str
    """E.g. depth; also the flag that names the folder, where it is not a task's first output."""
    suffix: str
    """Of the files, with its dot."""
    summary: str
    """What the folder holds, in one sentence."""
    write: "Callable[[Path, CameraLidarSample, Any], None]"
    """Writes the answer to a sample, whole or not at all; picklable."""
    read: "Callable[[Path, CameraLidarSample, Perception], Perception] | None" = None
    """Adds what such a file tells of a sample to what the outputs before this one have told; None
    where a file tells nothing that is drawn."""


def lacking_parts(predictor: Predictor, sample: "CameraLidarSample") -> "tuple[Part, ...]":
    """For want of which parts a predictor has no answer to a sample; empty: it has one.

    Those that it needs; where it can do without each of its parts, all of them if none is there.
    """
    absent = [part for part in predictor.parts if getattr(sample, part) is None]
    if len(absent) == len(predictor.parts):
        return tuple(absent)
    return tuple(part for part in absent if part in predictor.needs)


@dataclass(frozen=True, kw_only=True, slots=True)
class Switch:
    """A way to write a task's answers that is off unless it is asked for."""

    name: str
    """E.g. valid_only; also the flag, and what manifests say."""
    summary: str
    """What it does to the files, in one sentence."""
    change: Callable[[Any], Any]
    """From an answer to the one that is written; picklable."""


@runtime_checkable
class AnsweringTask(Protocol):
    """A task, as far as its answers go."""

    @property
    def name(self) -> str:
        """Stands in manifests."""
        ...

    @property
    def outputs(self) -> tuple[Output, ...]:
        """What is written of an answer; the first is what everybody wants."""
        ...

    @property
    def switches(self) -> tuple[Switch, ...]:
        """How else answers may be written."""
        ...
