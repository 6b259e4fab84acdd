import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
_BLOCK = re.compile(r"```(?:python|yaml)\n# (\S+)\n(.*?)```", re.DOTALL)
_LEFT_OUT = re.compile(r"^ *# \.\.\.\n\n?", re.MULTILINE)
_RIDDLES = re.compile(r"(Of|What|Those|That|Whose|Which|By|As|But|And|So many)\b")
_THIRD_PERSON = re.compile(
    r"(Adds|Completes|Computes|Converts|Creates|Draws|Makes|Prints|Reads|Refuses|Removes|Returns|"
    r"Runs|Stores|Warns|Writes) (a|all|an|each|every|no|one|the)\b"
)
EXAMPLES = _BLOCK.findall((ROOT / "STYLE.md").read_text())


def test_there_are_eight_sections_with_an_example_each():
    assert len(re.findall(r"^## \d\. ", (ROOT / "STYLE.md").read_text(), re.MULTILINE)) == 8
    assert len(EXAMPLES) >= 8


@pytest.mark.parametrize(("path", "example"), EXAMPLES, ids=[path for path, _ in EXAMPLES])
def test_an_example_of_style_is_the_code_as_it_is(path, example):
    code = (ROOT / path).read_text()
    for part in _LEFT_OUT.split(example):
        assert part in code


def docstrings(path):
    """Docstrings of a file, those of attributes among them, with their lines."""
    for node in ast.walk(ast.parse(path.read_text())):
        body = getattr(node, "body", None)
        for statement in body if isinstance(body, list) else ():  # a lambda's is an expression
            value = getattr(statement, "value", None)
            if isinstance(statement, ast.Expr) and isinstance(getattr(value, "value", None), str):
                yield statement.lineno, value.value.strip()


@pytest.mark.parametrize("folder", ["src", "benchmarks", "docs"])
def test_no_docstring_begins_as_a_riddle_or_in_the_third_person(folder):
    files = sorted((ROOT / folder).rglob("*.py"))
    assert files
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text.splitlines()[0]}"
        for path in files
        for line, text in docstrings(path)
        if _RIDDLES.match(text) or _THIRD_PERSON.match(text)
    ]
    assert found == []
