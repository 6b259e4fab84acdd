import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
_BLOCK = re.compile(r"```(?:python|yaml)\n# (\S+)\n(.*?)```", re.DOTALL)
_LEFT_OUT = re.compile(r"^ *# \.\.\.\n\n?", re.MULTILINE)
EXAMPLES = _BLOCK.findall((ROOT / "STYLE.md").read_text())


def test_there_are_eight_sections_with_an_example_each():
    assert len(re.findall(r"^## \d\. ", (ROOT / "STYLE.md").read_text(), re.MULTILINE)) == 8
    assert len(EXAMPLES) >= 8


@pytest.mark.parametrize(("path", "example"), EXAMPLES, ids=[path for path, _ in EXAMPLES])
def test_an_example_of_style_is_the_code_as_it_is(path, example):
    code = (ROOT / path).read_text()
    for part in _LEFT_OUT.split(example):
        assert part in code
