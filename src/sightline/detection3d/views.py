"""Stages asked twice, the second time about what is turned or mirrored: the flip test."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import torch
from torch import Tensor

Run = Callable[[Mapping[str, Tensor]], Any]
"""Runs a stage's module, here or by another engine; gives its NamedTuple."""


class View(NamedTuple):
    """A change of a stage's inputs after which the right answer is known to change alike."""

    change: Callable[[Mapping[str, Tensor]], Mapping[str, Tensor]]
    """Of the inputs."""
    change_back: Callable[[Any], Any]
    """Of the stage's NamedTuple, to what it stands for before the change."""


def _same(given: Any) -> Any:  # noqa: ANN401 - inputs or an output
    return given


AS_IT_IS: Final = View(_same, _same)


def answer_of_views(run: Run, inputs: Mapping[str, Tensor], views: Sequence[View]) -> Any:  # noqa: ANN401 - the stage's NamedTuple
    """The mean of a stage's answers to all views, each changed back.

    Args:
        run: Runs the stage's module.
        inputs: What it takes.
        views: One or more. A single one's answer is given as it is.
    """
    answers = [view.change_back(run(view.change(inputs))) for view in views]
    if len(answers) == 1:
        return answers[0]
    means = (torch.stack(values).mean(dim=0) for values in zip(*answers, strict=True))
    return type(answers[0])(*means)
