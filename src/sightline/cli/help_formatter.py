"""Help of the commands in plain words instead of Python's types."""

import re
import types
from argparse import Action
from pathlib import Path
from typing import Any, Final, Literal, Union, get_args, get_origin

from jsonargparse import ActionYesNo, DefaultHelpFormatter

from sightline.files.settings import without_backspaces

_WORDS: Final = {Path: "path", str: "text", int: "whole number", float: "number"}
_NO_DEFAULT: Final = re.compile(r"(, )?default: %\(default\)s")


class PlainHelpFormatter(DefaultHelpFormatter):
    """Formatter that names types in words, and no default where it is None."""

    def format_help(self) -> str:
        """Format the help, without the backspaces that jsonargparse has in --print_config."""
        return without_backspaces(super().format_help())

    def _get_type_str(self, action: Action) -> str | None:
        """Name the type of an argument's values; None: no type is printed."""
        if isinstance(action, ActionYesNo):
            return None
        hint = getattr(action, "_typehint", None) or action.type
        has_choices = get_origin(hint) is Literal  # the help lists the choices
        return None if hint is None or has_choices else plain_type(hint)

    def _get_help_string(self, action: Action) -> str:
        text = super()._get_help_string(action)
        if action.default is None or isinstance(action, ActionYesNo):
            text = _NO_DEFAULT.sub("", text).replace(" ()", "")
        return text


def plain_type(hint: Any) -> str | None:  # noqa: ANN401 - a type hint
    """Name a type in words; None: it has no short name."""
    if hint in _WORDS:
        return _WORDS[hint]
    if get_origin(hint) is Literal:
        return "one of " + ", ".join(map(str, get_args(hint)))
    if get_origin(hint) in (Union, types.UnionType):
        words = [plain_type(each) for each in get_args(hint) if each is not types.NoneType]
        return " or ".join(filter(None, words)) if all(words) else None
    return None
