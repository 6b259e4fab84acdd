"""Parser of the command line's arguments."""

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from inspect import Parameter, Signature
from pathlib import Path
from typing import Any, Literal, NoReturn

import jsonargparse
import yaml

from sightline.cli.help_formatter import PlainHelpFormatter
from sightline.cli.output import fail
from sightline.cli.refusal import UNQUOTED, plain_refusal
from sightline.files.plain_text import read_text

Device = Literal["cpu", "cuda"]

REFUSED = 2
"""Exit status for refused arguments."""

_LISTS: dict[str, tuple[type[int] | type[float] | type[str], int | None]] = {
    "--beams": (int, None),
    "--by-distance": (float, None),
    "--ious": (float, None),
    "--image-size": (int, 2),
    "--cases": (str, None),
    "--results": (str, None),
    "--healthy": (str, None),
    "--compare": (str, None),
    "--frames": (str, None),
    "--kinds": (str, None),
    "--severities": (int, None),
    "--tasks": (str, None),
}
"""Options with several values: their type, and their number if it is fixed."""

_MAY_BE_LEFT_OUT = {"--out-folder": "out_folder", "--data-set": "data_set"}
"""Optional positional arguments; commands that need them check them themselves."""
_SEVERAL = ("frames",)
"""Positional arguments with one or more values."""
_SHORT = {"--page": "-o"}


_MAX_DEPTH, _MAX_VALUES = 50, 2**16
"""Limits of nesting depth and number of values in one argument or settings file."""

_MERGE = "tag:yaml.org,2002:merge"
_load_yaml = jsonargparse.get_loader("yaml")
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def load_value(value: str) -> Any:  # noqa: ANN401 - as YAML has it
    """Read an argument or a file of settings as YAML, or as text if it is not UTF-8.

    Raises:
        yaml.YAMLError: It is no YAML, is nested deeply or large, or has a name twice.
    """
    try:
        value.encode()
    except UnicodeEncodeError:
        return value
    try:
        _check_depth(value)
        loaded = _load_yaml(value)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = "" if mark is None else f"line {mark.line + 1}, column {mark.column + 1}: "
        raise yaml.YAMLError(f"is no YAML: {where}{error.problem}") from error
    _check_extent(loaded)
    if isinstance(loaded, dict | list):
        _check_keys(yaml.compose(value, Loader=_Loader))
    return loaded


def _check_depth(value: str) -> None:
    """Refuse text that is nested deeply before PyYAML's C code, which calls itself, reads it."""
    if len(value) <= _MAX_DEPTH:
        return
    depth = 0
    for event in yaml.parse(value, Loader=_Loader):
        is_start = isinstance(event, yaml.CollectionStartEvent)
        depth += is_start - isinstance(event, yaml.CollectionEndEvent)
        if depth > _MAX_DEPTH:
            raise yaml.YAMLError(f"is nested more than {_MAX_DEPTH} deep")


def _check_extent(loaded: object) -> None:
    """Refuse settings that are nested deeply, or large by aliases: copying them would hang."""
    pending, num_values = [(loaded, 0)], 0
    while pending:
        value, depth = pending.pop()
        num_values += 1
        if depth > _MAX_DEPTH:
            raise yaml.YAMLError(f"is nested more than {_MAX_DEPTH} deep")
        if num_values > _MAX_VALUES:
            raise yaml.YAMLError(f"holds more than {_MAX_VALUES} values, including its aliases")
        if isinstance(value, dict):
            pending += [(each, depth + 1) for each in value.values()]
        elif isinstance(value, list):
            pending += [(each, depth + 1) for each in value]


def _check_keys(root: yaml.Node) -> None:
    """Refuse a name that stands twice in one mapping: YAML would take the last value."""
    pending = [root]
    for node in pending:
        values = node.value if isinstance(node, yaml.CollectionNode) else ()
        if isinstance(node, yaml.MappingNode):
            names: set[str] = set()
            for key, _ in values:
                name, line = str(key.value), key.start_mark.line + 1
                if name in names and key.tag != _MERGE:
                    raise yaml.YAMLError(f"line {line} has {name} a second time")
                names.add(name)
            values = [value for _, value in values]
        pending += values


jsonargparse.set_loader("yaml", load_value, (yaml.YAMLError,))


class OneLineParser(jsonargparse.ArgumentParser):
    """Parser with errors in one line, and option names with dashes."""

    def __init__(self, *args: Any, **settings: Any) -> None:  # noqa: ANN401 - as jsonargparse
        # The meaning of an abbreviation would change with new options.
        plain = {"allow_abbrev": False, "formatter_class": PlainHelpFormatter}
        super().__init__(*args, **{**plain, **settings})

    def add_argument(self, *names: str, **settings: Any) -> Any:  # noqa: ANN401 - as jsonargparse
        """Add an argument; a Boolean argument becomes a flag without a value."""
        dashed = [
            name.replace("_", "-") if name.startswith("--") and name != "--print_config" else name
            for name in names
        ]
        if settings.get("type") is bool:  # `--overwrite`, not `--overwrite true`
            del settings["type"]
            settings["action"] = jsonargparse.ActionYesNo(no_prefix="no-")
        if dashed[0] in _LISTS and settings.get("type") is not int:  # `simulate --frames 2`
            settings["action"] = _ValueList
        if dashed[0] in _MAY_BE_LEFT_OUT:
            dashed, settings["nargs"] = [_MAY_BE_LEFT_OUT[dashed[0]]], "?"
        if dashed[0] in _SEVERAL:
            settings |= {"action": "store", "type": _name, "nargs": "+"}
        if dashed[0] in _SHORT:
            dashed.append(_SHORT[dashed[0]])
        return super().add_argument(*dashed, **settings)

    def add_subcommands(self, *args: Any, **settings: Any) -> Any:  # noqa: ANN401 - as jsonargparse
        """Add commands; `with_config_first` refuses files of settings before one."""
        for action in self._actions:
            if action.dest in ("config", "print_config"):
                action.help = argparse.SUPPRESS
        return super().add_subcommands(*args, **settings)

    def parse_args(self, *args: Any, **settings: Any) -> Any:  # noqa: ANN401 - as jsonargparse
        """Parse arguments; of files of settings, also lists and optional positional arguments."""
        parsed = super().parse_args(*args, **settings)
        try:
            for action in self._actions:
                value = parsed.get(action.dest)
                if isinstance(action, _ValueList) and value is not None:
                    parsed[action.dest] = action.of_file(value)
                elif action.dest in _MAY_BE_LEFT_OUT.values() and value is None:
                    parsed[action.dest] = _path_in_files(action.dest, parsed.get("config"))
        except argparse.ArgumentError as error:
            self.error(str(error))
        return parsed

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        """Print the error and end the program."""
        del ex  # its text is in the message
        sys.exit(fail(plain_refusal(message, str(self.prog)), REFUSED))


def _name(value: object) -> str:
    """Take a name from the command line or a file of settings.

    Raises:
        ValueError: YAML has read it as a number, without its leading zeros.
    """
    if not isinstance(value, str):
        raise ValueError(UNQUOTED)
    return value


class _ValueList(argparse.Action):
    """Action for `--beams 64 32` and `--beams 64,32`; jsonargparse itself only has `[64,32]`."""

    def __init__(self, **settings: Any) -> None:  # noqa: ANN401 - as argparse
        value_type, _ = _LISTS[settings["option_strings"][0]]
        metavar = "NAME" if value_type is str else "NUMBER"
        super().__init__(nargs="+", metavar=metavar, **settings)

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,  # noqa: ANN401 - as argparse
        option_string: str | None = None,
    ) -> None:
        """Set the tuple of the words after the option."""
        del parser, option_string
        words = [word for value in values for word in _split_word(value)]
        setattr(namespace, self.dest, self._converted(words, " ".join(values)))

    def of_file(self, value: object) -> tuple[object, ...]:
        """Convert the value in a file of settings; items of a list are taken as they are.

        Raises:
            argparse.ArgumentError: They are no numbers or names, or not as many as needed.
        """
        words = _split_word(value) if isinstance(value, str) else value
        values = list(words) if isinstance(words, list | tuple) else [words]
        return self._converted(values, " ".join(map(str, values)))

    def _converted(self, words: Sequence[object], given: str) -> tuple[object, ...]:
        option = self.option_strings[0]
        value_type, count = _LISTS[option]
        if value_type is str:
            if not all(isinstance(word, str) for word in words):
                raise argparse.ArgumentError(self, UNQUOTED)
            return tuple(words)
        try:
            if any(isinstance(word, bool) for word in words):
                raise ValueError
            parsed = tuple(value_type(str(word)) for word in words)
        except ValueError:
            raise argparse.ArgumentError(
                self, f"expected numbers, got {given}; write them last or as {option}=1,2"
            ) from None
        if count is not None and len(parsed) != count:
            raise argparse.ArgumentError(self, f"expected {count} numbers, got {len(parsed)}")
        return parsed


def _split_word(word: str) -> list[str]:
    """Split `64,16` or `[64,16]`; the path of an existing file or folder stays whole."""
    is_path = os.path.exists(word)  # noqa: PTH110 - Path.exists raises for long lists
    return [word] if is_path else word.strip("[]").split(",")


def _path_in_files(name: str, files: Sequence[Any] | None) -> Path | None:
    """Find an argument in files of settings, the last first; None: it is in none.

    Raises:
        argparse.ArgumentError: A file is a pipe, which can be read once.
    """
    for file in reversed(files or ()):
        if file is None:
            raise argparse.ArgumentError(
                None, f"--config is a pipe: give {name.upper()} on the command line, or a file"
            )
        settings = load_value(read_text(Path(str(file))))
        if isinstance(settings, dict) and settings.get(name) is not None:
            return Path(str(settings[name]))
    return None


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
