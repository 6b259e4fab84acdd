"""Predictors made of functions, for tests of jobs."""

from collections.abc import Callable
from dataclasses import dataclass, field

from sightline.depth_completion.registration import TASK
from sightline.geometry.projection import sparse_depth_map
from sightline.inference.predict import predict
from sightline.structures.predictions import DepthMap


@dataclass(frozen=True)
class FunctionPredictor:
    """Predictor made of a function."""

    function: Callable
    name: str = "sparse"
    parts: tuple[str, ...] = ("points",)
    needs: tuple[str, ...] = ()
    gives: tuple[str, ...] = ("depth",)
    made_by: dict[str, str] = field(default_factory=lambda: {"version": "1"})

    def __call__(self, sample):
        return self.function(sample)


def sparse(sample):
    """Predict the projected sweep: quick, and different for each frame."""
    depth_m = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
    return DepthMap(depth_m=depth_m, valid=depth_m > 0)


def write(data, out, function=sparse, *, workers=1, overwrite=False, **fields):
    predictor = FunctionPredictor(function, **fields)
    return predict(TASK, predictor, data, out, workers=workers, overwrite=overwrite)
