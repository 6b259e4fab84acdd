"""Tensors by name: what goes into a module or an engine, and what comes out."""

from collections.abc import Mapping

from torch import Tensor

SINGLE_OUTPUT = "output"
"""Name of the output of a module that returns a bare tensor."""


def named_outputs(output: object) -> dict[str, Tensor]:
    """The tensors of a module's output by name, in order; those that are None are left out.

    Args:
        output: A tensor, or a NamedTuple of tensors and None.

    Raises:
        ValueError: It is something else, or holds no tensor.
    """
    if isinstance(output, Tensor):
        return {SINGLE_OUTPUT: output}
    names = getattr(output, "_fields", None)
    if not isinstance(output, tuple) or names is None:
        raise ValueError(
            f"a module must return a tensor or a NamedTuple of tensors, got {type(output).__name__}"
        )
    given = {name: value for name, value in zip(names, output, strict=True) if value is not None}
    if not given or not all(isinstance(value, Tensor) for value in given.values()):
        raise ValueError(
            f"the fields of a module's output must be tensors or None, and not all None, got "
            f"{', '.join(f'{name}: {type(value).__name__}' for name, value in given.items())}"
        )
    return given


def check_inputs(inputs: Mapping[str, Tensor], names: tuple[str, ...], stride: int) -> None:
    """Refuses inputs that an engine would choke on without saying why.

    Args:
        inputs: What shall go in.
        names: What the engine takes.
        stride: What height and width of the images, the tensors with four axes, divide by.

    Raises:
        ValueError: A name is missing or unknown, or a size is no multiple of the stride.
    """
    if set(inputs) != set(names):
        raise ValueError(
            f"the network takes the inputs {', '.join(names)}, got {', '.join(inputs) or 'none'}"
        )
    for name, tensor in inputs.items():
        if tensor.ndim == 4 and any(size % stride or not size for size in tensor.shape[-2:]):
            height, width = tensor.shape[-2:]
            raise ValueError(
                f"height and width of {name} must be multiples of {stride}, got {height}x{width}; "
                "pad the image"
            )
