"""Base class of predictors, for one sample or a list of samples."""

from abc import ABC, abstractmethod
from dataclasses import fields
from typing import Generic, TypeVar, overload

from torch import Tensor

from sightline.files.weights import plain_defaults
from sightline.geometry.arguments import type_name
from sightline.jobs.worker import keep_pytorch_to_one_thread_in_forks
from sightline.structures.sample import CameraLidarSample

Prediction = TypeVar("Prediction")

_Samples = list[CameraLidarSample] | tuple[CameraLidarSample, ...]


class SamplePredictor(ABC, Generic[Prediction]):
    """Predictor of a sample or a list of samples; a subclass implements `predict`."""

    __slots__ = ()

    @abstractmethod
    def predict(self, sample: CameraLidarSample) -> Prediction:
        """Predict for one sample.

        Raises:
            ValueError: The sample lacks a required part.
        """

    @overload
    def __call__(self, sample: CameraLidarSample) -> Prediction: ...
    @overload
    def __call__(self, sample: _Samples) -> list[Prediction]: ...
    def __call__(self, sample: object, *others: object) -> Prediction | list[Prediction]:
        """Predict for a sample, or for each sample of a list, in its order.

        The samples of a list may differ in size and in missing parts: each prediction is
        independent of the other samples.

        Args:
            sample: One sample, or a list or tuple of them.
            others: Must be empty: several samples are given as a list.

        Returns:
            The prediction, or a list with a prediction for each sample.

        Raises:
            TypeError: `sample` is neither (the error contains the type, and in a list the
                position), or there are `others`.
            ValueError: A sample lacks a required part, or has a tensor without values (on PyTorch's
                device meta), or one that requires gradients.
        """
        if others:
            raise TypeError(
                f"a predictor takes one sample or one list of samples, got {1 + len(others)} "
                "arguments; put several samples into a list: predictor([a, b])"
            )
        keep_pytorch_to_one_thread_in_forks()
        if isinstance(sample, CameraLidarSample):
            _check_tensors(sample)
            with plain_defaults():
                return self.predict(sample)
        if not isinstance(sample, list | tuple):
            raise _wrong_type(sample, "")
        for position, each in enumerate(sample):
            if not isinstance(each, CameraLidarSample):
                raise _wrong_type(each, f" at position {position} of the list")
            _check_tensors(each)
        with plain_defaults():
            return [self.predict(each) for each in sample]


def _check_tensors(sample: CameraLidarSample) -> None:
    """Refuse tensors without values, and gradients, which predictions do not have."""
    for holder, prefix in ((sample, ""), (sample.calibration, "calibration.")):
        for field in fields(holder):
            tensor = getattr(holder, field.name)
            if not isinstance(tensor, Tensor):
                continue
            subject = f"{prefix}{field.name} of sample {sample.sample_id}"
            if tensor.is_meta:
                raise ValueError(
                    f"{subject} is on PyTorch's device meta and has no values; give data"
                )
            if tensor.requires_grad:
                raise ValueError(
                    f"{subject} requires gradients, and predictions have none; give "
                    f"{field.name}.detach()"
                )


def _wrong_type(given: object, where: str) -> TypeError:
    return TypeError(
        f"a predictor takes a CameraLidarSample or a list of them, got {type_name(given)}{where}; "
        "use a sample of open_dataset(..), or make one by CameraLidarSample.from_arrays(..)"
    )
