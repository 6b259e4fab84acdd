"""Test-time augmentation: a network run on a frame and on its mirror image."""

from collections.abc import Callable, Mapping

import numpy as np
import torch
from torch import Tensor

Run = Callable[[Mapping[str, Tensor]], Mapping[str, Tensor]]
"""Function from a depth completion network's inputs to its outputs, by name; both are batch x
channels x height x width."""


def predict_with_mirror(run: Run, inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Average the outputs for a frame and for its mirror image, mirrored back.

    Uses numpy: PyTorch's threads would keep waiting for work.
    """
    first = _to_arrays(run(inputs))
    mirrored = {name: array[..., ::-1].copy() for name, array in _to_arrays(inputs).items()}
    second = _to_arrays(run({name: torch.from_numpy(each) for name, each in mirrored.items()}))
    with np.errstate(invalid="ignore", over="ignore"):  # non-finite values are handled later
        means = {name: (each + second[name][..., ::-1]) / 2 for name, each in first.items()}
    return {name: torch.from_numpy(each) for name, each in means.items()}


def _to_arrays(tensors: Mapping[str, Tensor]) -> dict[str, np.ndarray]:
    return {name: each.numpy(force=True) for name, each in tensors.items()}
