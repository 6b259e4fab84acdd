"""A network run on a frame and on its mirror image."""

from collections.abc import Callable, Mapping

import numpy as np
import torch
from torch import Tensor

Run = Callable[[Mapping[str, Tensor]], Mapping[str, Tensor]]
"""Inputs of a depth completion network by name, batch x channels x height x width; its outputs."""


def answer_with_mirror(run: Run, inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The mean of both answers, the second one mirrored back.

    In numpy, which starts no threads that go on waiting as PyTorch's do.
    """
    first = _to_arrays(run(inputs))
    mirrored = {name: array[..., ::-1].copy() for name, array in _to_arrays(inputs).items()}
    second = _to_arrays(run({name: torch.from_numpy(each) for name, each in mirrored.items()}))
    with np.errstate(invalid="ignore", over="ignore"):  # what is not finite is sorted out later
        means = {name: (each + second[name][..., ::-1]) / 2 for name, each in first.items()}
    return {name: torch.from_numpy(each) for name, each in means.items()}


def _to_arrays(tensors: Mapping[str, Tensor]) -> dict[str, np.ndarray]:
    return {name: each.numpy(force=True) for name, each in tensors.items()}
