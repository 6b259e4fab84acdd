"""Named tensors: inputs and outputs of modules and engines."""

from collections.abc import Mapping

from torch import Tensor

SINGLE_OUTPUT = "output"
"""Output name of a module that returns a single tensor."""


def named_outputs(output: object) -> dict[str, Tensor]:
    """Name the tensors of a module's output, in order; None values are left out.

    Args:
        output: A tensor, or a NamedTuple of tensors and None.

    Raises:
        ValueError: The output has another type, or contains no tensor.
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
    """Refuse invalid inputs, for which engines have unclear errors.

    Args:
        inputs: Inputs by name.
        names: Names of the engine's inputs.
        stride: Number that must divide height and width of the images, the tensors with four axes.

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
