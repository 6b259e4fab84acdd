"""Flip test: run a stage again on a turned or mirrored input, and average."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import torch
from torch import Tensor

Run = Callable[[Mapping[str, Tensor]], Any]
"""Runner of a stage's module, here or by another engine; returns its NamedTuple."""


class View(NamedTuple):
    """Transform of a stage's inputs with a known effect on its output."""

    change: Callable[[Mapping[str, Tensor]], Mapping[str, Tensor]]
    """Transform of the inputs."""
    change_back: Callable[[Any], Any]
    """Inverse transform of the stage's NamedTuple."""


def _same(given: Any) -> Any:  # noqa: ANN401 - inputs or an output
    return given


AS_IT_IS: Final = View(_same, _same)


def answer_of_views(run: Run, inputs: Mapping[str, Tensor], views: Sequence[View]) -> Any:  # noqa: ANN401 - the stage's NamedTuple
    """Average a stage's outputs over all views, each transformed back.

    Args:
        run: Runs the stage's module.
        inputs: Inputs of the module.
        views: One or more. The output of a single view is returned unchanged.
    """
    answers = [view.change_back(run(view.change(inputs))) for view in views]
    if len(answers) == 1:
        return answers[0]
    means = (torch.stack(values).mean(dim=0) for values in zip(*answers, strict=True))
    return type(answers[0])(*means)
