"""A network asked twice: for a frame and for its mirror image."""

from collections.abc import Callable, Mapping

import numpy as np
import torch
from torch import Tensor

_UNCHANGED = 1e-4  # of the depth: engines round

Run = Callable[[Mapping[str, Tensor]], Mapping[str, Tensor]]
"""Inputs of a depth completion network by name, batch x channels x height x width; its outputs."""


def answer_with_mirror(run: Run, inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The mean of both answers, the second one mirrored back.

    Where one of them leaves the classical completion as it is, so does this: a correction takes
    two that agree on making one. By numpy, whose threads do not go on waiting as PyTorch's do.
    """
    first = _to_arrays(run(inputs))
    mirrored = {name: array[..., ::-1].copy() for name, array in _to_arrays(inputs).items()}
    second = _to_arrays(run({name: torch.from_numpy(each) for name, each in mirrored.items()}))
    second = {name: each[..., ::-1] for name, each in second.items()}
    answer = {name: (each + second[name]) / 2 for name, each in first.items()}
    filled = inputs.get("filled_depth_m")
    if filled is not None:
        completion = filled.numpy(force=True)
        is_kept = np.zeros(completion.shape, dtype=bool)
        for each in (first, second):
            is_kept |= np.abs(each["depth_m"] - completion) <= _UNCHANGED * completion
        answer["depth_m"] = np.where(is_kept, completion, answer["depth_m"])
    return {name: torch.from_numpy(each) for name, each in answer.items()}


def _to_arrays(tensors: Mapping[str, Tensor]) -> dict[str, np.ndarray]:
    return {name: each.numpy(force=True) for name, each in tensors.items()}
