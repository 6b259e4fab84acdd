"""Base class of predictors that run a trained network on an inference engine."""

from abc import abstractmethod
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from sightline.export.names import EngineChoice, EngineName
from sightline.geometry.wrong_types import named_arguments
from sightline.inference.network import LoadedNetwork, Network, NetworkTask, load_network
from sightline.inference.sample_predictor import Prediction, SamplePredictor

Made = TypeVar("Made", bound="NetworkPredictor[Any, Any]")  # beartype refuses Self in a method


class NetworkPredictor(SamplePredictor[Prediction], Generic[Network, Prediction]):
    """Predictor that runs a trained network on an engine.

    A subclass implements `_start` and `predict`. May be pickled, and called in a forked process.
    """

    network_task: ClassVar[NetworkTask[Any]]
    """Task of the network."""

    @named_arguments
    def __init__(
        self,
        loaded: LoadedNetwork[Network],
        *,
        engine: EngineChoice = "torch",
        device: str = "cpu",
        threads: int | None = None,
    ) -> None:
        """Take a loaded network; `load` takes the name of its weights.

        Args:
            loaded: The network.
            engine: Inference engine.
            device: cpu or cuda.
            threads: Number of CPU threads; None: the engine's default.

        Raises:
            ValueError: The engine is not installed or cannot run on the device.
        """
        self.name = loaded.name
        self.sha256 = loaded.sha256
        self.engine: EngineName = self._start(loaded, engine, device, threads)

    @abstractmethod
    def _start(
        self,
        loaded: LoadedNetwork[Network],
        engine: EngineChoice,
        device: str,
        threads: int | None,
    ) -> EngineName:
        """Prepare the network for an engine; return the engine's name."""

    @classmethod
    @named_arguments
    def load(  # noqa: PYI019 - see Made
        cls: type[Made],
        weights: str | Path,
        *,
        engine: EngineChoice = "torch",
        device: str = "cpu",
        threads: int | None = None,
    ) -> Made:
        """Load weights by name or from a file, and make a predictor.

        Raises:
            ValueError: See `load_network` and the constructor.
        """
        loaded = load_network(cls.network_task, weights)
        return cls(loaded, engine=engine, device=device, threads=threads)

    @property
    def made_by(self) -> dict[str, str]:
        """Entries of a manifest besides the name."""
        return {"weights_sha256": self.sha256, "engine": self.engine}
