from inspect import signature
from pathlib import Path
from typing import Literal

import pytest
from docstring_parser import parse

from sightline.cli.help_formatter import plain_type
from sightline.cli.main import _commands, main


def flat(commands, words=()):
    for name, command in commands.items():
        if name == "_help" or not isinstance(command, dict):
            if callable(command):
                yield pytest.param(command, id=" ".join((*words, name)))
        else:
            yield from flat(command, (*words, name))


@pytest.mark.parametrize("command", list(flat(_commands())))
def test_the_help_of_a_command_describes_each_argument_in_whole_sentences(command):
    # An unindented line of a docstring cuts off the text of --help, without an error.
    descriptions = {each.arg_name: each.description or "" for each in parse(command.__doc__).params}
    texts = {name: descriptions.get(name, "") for name in signature(command).parameters}
    assert not {name for name, text in texts.items() if not text.endswith((".", ")"))}


@pytest.mark.parametrize(
    ("hint", "words"),
    [
        (Path, "path"),
        (Path | None, "path"),
        (int | None, "whole number"),
        (Literal["a", "b"] | None, "one of a, b"),
        (str | Path, "text or path"),
        (tuple[int, ...], None),
    ],
)
def test_types_are_named_in_words(hint, words):
    assert plain_type(hint) == words


@pytest.mark.parametrize("command", [["evaluate", "held-out"], ["perceive"], ["simulate"]])
def test_help_shows_no_python_types(command, capsys):
    with pytest.raises(SystemExit):
        main([*command, "--help"])
    printed = " ".join(capsys.readouterr().out.split())
    assert "(required, type: path)" in printed
    for word in ("class '", "Optional[", "Literal[", "null", "()"):
        assert word not in printed


@pytest.mark.parametrize("arguments", [("check",), ("fit", "--config", "depth-shiftconv-kitti")])
def test_help_holds_no_control_characters(arguments, capsys):
    with pytest.raises(SystemExit):
        main([*arguments, "--help"])
    printed = capsys.readouterr().out
    assert "--print_config[=flags]" in printed
    assert printed.replace("\n", "").isprintable()
