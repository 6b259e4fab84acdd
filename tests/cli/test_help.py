from inspect import signature

import pytest
from docstring_parser import parse

from sightline.cli.main import _commands


def flat(commands, words=()):
    for name, command in commands.items():
        if name == "_help" or not isinstance(command, dict):
            if callable(command):
                yield pytest.param(command, id=" ".join((*words, name)))
        else:
            yield from flat(command, (*words, name))


@pytest.mark.parametrize("command", list(flat(_commands())))
def test_the_help_of_a_command_tells_of_each_argument_in_whole_sentences(command):
    # A line of a docstring that is not indented cuts off what --help tells, without an error.
    told = {each.arg_name: each.description or "" for each in parse(command.__doc__).params}
    texts = {name: told.get(name, "") for name in signature(command).parameters}
    assert not {name for name, text in texts.items() if not text.endswith((".", ")"))}
