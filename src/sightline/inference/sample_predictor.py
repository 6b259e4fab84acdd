"""Base of the predictors of samples: one sample in, one answer out, or lists of both."""

from abc import ABC, abstractmethod
from typing import Generic, TypeVar, overload

from sightline.data.weights import float32_by_default
from sightline.structures.sample import CameraLidarSample

Answer = TypeVar("Answer")

_Samples = list[CameraLidarSample] | tuple[CameraLidarSample, ...]


class SamplePredictor(ABC, Generic[Answer]):
    """Callable with a sample or with a list of samples; a subclass writes `predict`."""

    __slots__ = ()

    @abstractmethod
    def predict(self, sample: CameraLidarSample) -> Answer:
        """Predict for one sample.

        Raises:
            ValueError: The sample lacks what is needed.
        """

    @overload
    def __call__(self, sample: CameraLidarSample) -> Answer: ...
    @overload
    def __call__(self, sample: _Samples) -> list[Answer]: ...
    def __call__(self, sample: object) -> Answer | list[Answer]:
        """Predict for a sample, or for each sample of a list, in its order.

        The samples of a list may differ in size and in what they lack: each is predicted by itself,
        so that its answer does not depend on the others.

        Args:
            sample: One sample, or a list or tuple of them.

        Returns:
            The answer, or a list with an answer for each sample.

        Raises:
            TypeError: It is neither; names the type, and in a list the place.
            ValueError: A sample lacks what is needed.
        """
        if isinstance(sample, CameraLidarSample):
            with float32_by_default():
                return self.predict(sample)
        if not isinstance(sample, list | tuple):
            raise _wrong_type(sample, "")
        for place, each in enumerate(sample):
            if not isinstance(each, CameraLidarSample):
                raise _wrong_type(each, f" at place {place} of the list")
        with float32_by_default():
            return [self.predict(each) for each in sample]


def _wrong_type(given: object, where: str) -> TypeError:
    kind = type(given)
    name = kind.__name__ if kind.__module__ == "builtins" else f"{kind.__module__}.{kind.__name__}"
    return TypeError(
        f"a predictor takes a CameraLidarSample or a list of them, got {name}{where}; take a "
        "sample of open_dataset(..), or make one by CameraLidarSample.from_arrays(..)"
    )
