"""Base class of tasks that predict by networks alone, without methods."""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from sightline.files.plain_text import shortened
from sightline.inference.predictor import OutputFilter

if TYPE_CHECKING:
    from sightline.export.names import EngineChoice
    from sightline.inference.network_predictor import NetworkPredictor

LoadedPredictor = TypeVar("LoadedPredictor", bound="NetworkPredictor[Any, Any]")


class NetworkOnlyTask(ABC, Generic[LoadedPredictor]):
    """Part of `sightline.tasks.Task` that loads predictors; imports them when they are used."""

    default_weights: str
    methods: tuple[str, ...] = ()
    detects_around: bool = False
    switches: tuple[OutputFilter, ...] = ()

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the task."""

    @abstractmethod
    def predictor_type(self) -> type[LoadedPredictor]:
        """Class of the task's predictors."""

    def predictor(
        self,
        *,
        method: str | None = None,
        weights: str | Path | None = None,
        engine: "EngineChoice" = "torch",
        device: str = "cpu",
        threads: int | None = None,
    ) -> LoadedPredictor:
        """Load a predictor with the named or default weights.

        Raises:
            ValueError: A method is named, or as `NetworkPredictor.load`.
        """
        if method is not None:
            raise ValueError(
                f"{self.name} has no method '{shortened(method)}': it predicts by a network; leave "
                "the method out, or name weights instead"
            )
        return self.predictor_type().load(
            self.default_weights if weights is None else weights,
            engine=engine,
            device=device,
            threads=threads,
        )
