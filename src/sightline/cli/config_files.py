"""Files of settings for a command: `--config FILE`."""

import difflib
import inspect
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

from sightline.cli.parser import load_value
from sightline.files.plain_text import read_piped_text, read_text, shortened
from sightline.files.problem import FileError

_OPTION = "--config"
_PRINTING = "--print_config"


def with_config_first(arguments: Sequence[str], commands: Mapping[str, Any]) -> list[str]:
    """Move `--config FILE` behind the command, so that all other arguments replace its values.

    Args:
        arguments: Words of the command line.
        commands: Functions by command, or mappings of commands below it.

    Raises:
        FileError: A file has a setting that the command does not take.
        ValueError: A file stands before the command, or is its output or another input, too.
    """
    command: Any = commands
    num_names = 0
    while isinstance(command, Mapping) and command.get(next(iter(arguments[num_names:]), "")):
        command = command[arguments[num_names]]
        num_names += 1
    if not callable(command):
        _refuse_before_command(*arguments[: num_names + 1])
        return list(arguments)
    given, others = _split(arguments[num_names:])
    settings = [_checked(path, others, command) for path in map(Path, given)]
    return [*arguments[:num_names], *(f"{_OPTION}={each}" for each in settings), *others]


def _refuse_before_command(*words: str) -> None:
    *names, option = words or ("",)
    option = option.partition("=")[0]
    if option in (_OPTION, _PRINTING):
        example = " ".join(["sightline", *names, "COMMAND", option])
        raise ValueError(
            f"{option} stands before the command whose settings it is about; give it behind, as in "
            f"{example}{' FILE' if option == _OPTION else ''}"
        )


def _split(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Separate the files of settings from other words."""
    given: list[str] = []
    others: list[str] = []
    remaining = iter(words)
    for word in remaining:
        path = next(remaining, None) if word == _OPTION else None
        if path is not None:
            given.append(path)
        elif word.startswith(f"{_OPTION}="):
            given.append(word.removeprefix(f"{_OPTION}="))
        else:
            others.append(word)
    return given, others


def check_settings_files(words: Sequence[str]) -> None:
    """Read the files of settings among a training's words: its parser names none in errors.

    Raises:
        FileError: A file cannot be read, is no YAML, or has no settings.
    """
    for path in map(Path, _split(words)[0]):
        if path.is_file():
            _read(path)


def _checked(path: Path, words: Sequence[str], command: Any) -> Path | str:  # noqa: ANN401
    """Check a file of settings for the parser; a pipe's text, as that can be read once."""
    if path.is_file():
        settings = _read(path)
        _check_names(path, settings, command)
        _check_alone(path, settings, words)
    elif path.is_fifo():
        text = read_piped_text(path)
        _check_names(path, _parsed(path, text), command)
        return text
    return path  # a missing one is refused by the parser


def _check_alone(path: Path, settings: Mapping[str, object], words: Sequence[str]) -> None:
    """Refuse a file of settings that is also an output or another input."""
    values = [str(each) for each in settings.values()]
    values += [word.partition("=")[2] if word.startswith("--") else word for word in words]
    for value in values:
        with suppress(OSError, ValueError):  # no path, such as a text that is too long
            if value and path.samefile(value):
                break
    else:
        return
    raise ValueError(
        f"{_OPTION} {path} is also {shortened(value)} among the other arguments, so that it might "
        "be replaced; give another path for one"
    )


def _read(path: Path) -> Mapping[str, object]:
    return _parsed(path, read_text(path))


def _parsed(path: Path, text: str) -> Mapping[str, object]:
    try:
        settings = load_value(text)
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a number of thousands of digits
        raise FileError(path, str(error), "correct the settings") from error
    if not isinstance(settings, dict) or not settings:
        raise FileError(path, "holds no settings", "write a line for each, as in workers: 2")
    return settings


def _check_names(path: Path, settings: Mapping[str, object], command: Any) -> None:  # noqa: ANN401
    known = list(inspect.signature(command).parameters)
    for key in settings:
        if key not in known:
            close = difflib.get_close_matches(str(key).replace("-", "_"), known, n=1)
            remedy = f"perhaps {close[0]} is meant" if close else f"expected {', '.join(known)}"
            raise FileError(
                path, f"has the setting {shortened(str(key))}, which the command lacks", remedy
            )
