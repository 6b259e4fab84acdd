"""Registration of functions as PyTorch operators, which compilers do not look into."""

from collections.abc import Callable
from typing import Any

import torch
from torch import library


class Operator:
    """A function of tensors that is a PyTorch operator: `torch.ops.sightline.<name>`.

    Like PyTorch's `custom_op`, whose operators import the compiler at their first call: two
    seconds of processor time before a predictor's first result.
    """

    def __init__(self, name: str, function: Callable[..., Any]) -> None:
        """Register a function that changes no argument and returns none, on every device.

        Args:
            name: Name without the namespace.
            function: The implementation; its annotations give the operator's types.
        """
        self._name = f"sightline::{name}"
        library.define(self._name, library.infer_schema(function, mutates_args=()))
        library.impl(self._name, "default", function)
        self._overload = getattr(torch.ops.sightline, name).default

    def __call__(self, *args: object) -> Any:  # noqa: ANN401 - the function's result
        """Call the operator."""
        return self._overload(*args)

    def register_fake(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Register the function that gives results of the right shape and type, without values."""
        library.register_fake(self._name, function)
        return function

    def register_autograd(
        self, backward: Callable[..., Any], *, setup_context: Callable[..., None]
    ) -> None:
        """Register the gradient, as for PyTorch's `register_autograd`."""
        library.register_autograd(self._name, backward, setup_context=setup_context)


def operator(name: str) -> Callable[[Callable[..., Any]], Operator]:
    """Make a decorator that turns a function into the operator of this name."""
    return lambda function: Operator(name, function)
