"""Error messages for invalid commands, in the user's terms."""

import re
from collections.abc import Callable, Sequence
from typing import Final

UNQUOTED: Final = (
    "expected a name, got what YAML reads as another value; write it in quotes, as '000010'"
)
"""Refusal of a number in a file of settings, where a name is expected."""

_TYPES: Final = {"int": "a whole number", "float": "a number"}


def plain_refusal(message: str, program: str) -> str:
    """Rewrite a message of jsonargparse without its own terms, with a pointer to the help.

    Args:
        message: Message of jsonargparse; unknown ones are kept.
        program: Name of the parser, including the commands.
    """
    program = program.replace(" [options]", "")
    for pattern, rewrite in _RULES:
        if match := re.fullmatch(pattern, message.strip(), re.DOTALL):
            name, *commands = program.split()
            text, help_of = rewrite(commands, *match.groups())
            return f"{text}; see {' '.join([name, *help_of])} --help"
    return f"{message}; see {program} --help"


_Refusal = tuple[str, Sequence[str]]
"""Message, and the commands with the relevant help."""


def _wrong_value(commands: Sequence[str], key: str, kinds: str, value: str) -> _Refusal:
    option = f"--{key.replace('_', '-')}"
    literals = re.search(r"typing\.Literal\[(.*?)\]", kinds)
    numbers = [text for name, text in _TYPES.items() if f"<class '{name}'>" in kinds]
    if literals:
        expected = "one of " + literals.group(1).replace("'", "")
    elif numbers:
        expected = numbers[0]
    elif "<class 'str'>" in kinds or "Path" in kinds:
        return _no_name(commands, key)
    else:
        expected = "another value"
    return f"{option}: expected {expected}, got {value}", commands


def _no_name(commands: Sequence[str], key: str) -> _Refusal:
    return f"{key} in a file of settings: {UNQUOTED}", commands


def _no_settings(commands: Sequence[str]) -> _Refusal:
    return (
        "--config names a file without settings; write a line for each, as in data: KITTI",
        commands,
    )


def _faulty_settings(commands: Sequence[str], problem: str) -> _Refusal:
    return f"--config: {problem}; correct the settings", commands


def _no_list(commands: Sequence[str], key: str) -> _Refusal:
    return f"{key.upper()} in a file of settings: expected a list, such as [a, b]", commands


def _unknown_setting(_commands: Sequence[str], command: str) -> _Refusal:
    return f"--config has a setting that {command} does not take; correct its name", [command]


def _missing(commands: Sequence[str], keys: str) -> _Refusal:
    names = [key.split(".") for key in keys.split(", ")]
    commands = names[0][:-1] or commands
    lacking = " and ".join(name[-1].upper() for name in names)
    return f"{' '.join(commands) or 'the command'} needs {lacking}", commands


def _no_command(commands: Sequence[str], parent: str | None, known: str) -> _Refusal:
    commands = parent.rstrip(".").split(".") if parent else commands
    listed = ", ".join(name.strip() for name in known.split(","))
    return f"{' '.join(commands) or 'sightline'} needs a command: {listed}", commands


def _wrong_command(commands: Sequence[str], given: str, known: str) -> _Refusal:
    listed = known.replace("'", "")
    return f"there is no command {' '.join([*commands, given])}; name one of {listed}", commands


_RULES: Final[tuple[tuple[str, Callable[..., _Refusal]], ...]] = (
    (r'Parser key "(\w+)":\s+Expected an? (.*)\. Got value: (.*)', _wrong_value),
    (r'Parser key "(\w+)":.*Subtypes: \[(.*)\]\s+Errors:.*Given value: (.*)', _wrong_value),
    (r'Parser key "(\w+)":.*(?:does not support item assignment|is not iterable)', _no_list),
    (r'Parser key "(\w+)":.*not \'?(?:int|float|bool|list|dict|date)\'?', _no_name),
    (rf'Parser key "(\w+)": {re.escape(UNQUOTED)}', _no_name),
    (r"Unexpected config:.*", _no_settings),
    (r"Problems parsing config:\s+(.*)", _faulty_settings),
    (r"'([\w-]+)'", _unknown_setting),  # of a KeyError that names the command
    (r"the following arguments are required: (.*)", _missing),
    (r'expected "([\w.-]+\.)?subcommand" to be one of \{(.*)\}, but it was not .*', _no_command),
    (r"argument subcommand: invalid choice: '(.*?)' \(choose from (.*)\)",
     _wrong_command),
)  # fmt: skip
