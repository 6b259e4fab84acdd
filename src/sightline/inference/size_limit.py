"""Limit on memory and time for building networks from untrusted settings."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from torch import Tensor, nn
from torch.nn.modules.module import (
    register_module_buffer_registration_hook,
    register_module_module_registration_hook,
    register_module_parameter_registration_hook,
)

_SLACK_TENSORS = 64  # for buffers that are not saved in files, for example
_SLACK_NUMBERS = 2**20
_SLACK_MODULES = 1024
_MODULES_PER_TENSOR = 16  # activations and containers have no tensors


@contextmanager
def size_limit(tensors: Mapping[str, Tensor]) -> Iterator[None]:
    """Within the block, stops building a module that is too large for its weights.

    Each layer is counted when it is added to its module, before its weights are initialised: at
    that time their memory is reserved but not yet used.

    Args:
        tensors: The weights.

    Raises:
        ValueError: The module being built has far more or far larger parts than `tensors`.
    """
    remaining = {
        "tensors": 2 * len(tensors) + _SLACK_TENSORS,
        "numbers": 2 * sum(tensor.numel() for tensor in tensors.values()) + _SLACK_NUMBERS,
        "modules": _MODULES_PER_TENSOR * len(tensors) + _SLACK_MODULES,
    }

    def take(kind: str, number: int) -> None:
        remaining[kind] -= number
        if remaining[kind] < 0:
            raise ValueError("its settings build a network far larger than its weights")

    def count_tensor(module: nn.Module, name: str, tensor: Tensor | None) -> None:
        del module, name
        if tensor is not None:
            take("tensors", 1)
            take("numbers", tensor.numel())

    def count_module(module: nn.Module, name: str, submodule: nn.Module | None) -> None:
        del module, name, submodule
        take("modules", 1)

    handles = (
        register_module_parameter_registration_hook(count_tensor),
        register_module_buffer_registration_hook(count_tensor),
        register_module_module_registration_hook(count_module),
    )
    try:
        yield
    finally:
        for handle in handles:
            handle.remove()
