"""Commands with options generated from declarations elsewhere."""

from collections.abc import Callable, Mapping
from inspect import Parameter, Signature
from typing import Any


def declare(
    command: Callable[..., None],
    positional: Mapping[str, Any],
    options: Mapping[str, tuple[Any, object]],
    *,
    help_text: str,
) -> Callable[..., None]:
    """Set the signature for jsonargparse of a function with `**settings`.

    Args:
        command: The function, changed in place.
        positional: Names and types of the arguments.
        options: Names, types and defaults of the options.
        help_text: The docstring.

    Returns:
        The function.
    """
    parameters = [
        Parameter(name, Parameter.POSITIONAL_OR_KEYWORD, annotation=kind)
        for name, kind in positional.items()
    ]
    parameters += [
        Parameter(name, Parameter.KEYWORD_ONLY, annotation=kind, default=default)
        for name, (kind, default) in options.items()
    ]
    vars(command)["__signature__"] = Signature(parameters)
    command.__annotations__ = {each.name: each.annotation for each in parameters}
    command.__doc__ = help_text
    return command
