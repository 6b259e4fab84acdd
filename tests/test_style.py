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
SMALL_FILES = {
    "cli/tasks.py": "a command",
    "depth_completion/method_names.py": "imports nothing: the command line reads it",
    "depth_completion/mirrored_prediction.py": "predictor.py is full",
    "depth_completion/network_task.py": "registration and predictor both need it",
    "detection2d/network_task.py": "registration and predictor both need it",
    "detection2d/robustness.py": "has its place in every task",
    "detection3d/classes.py": "settings of both designs need it",
    "detection3d/network_task.py": "registration and predictor both need it",
    "evaluation/auroc.py": "a measure of its own, with a reference",
    "evaluation/inputs.py": "two evaluations that do not import each other need it",
    "export/graph.py": "what a task gives to the room",
    "export/names.py": "imports nothing: the command line reads it",
    "geometry/kitti_mount.py": "without PyTorch, as checks of data start at once",
    "geometry/picture_checks.py": "without PyTorch, as checks of data start at once",
    "geometry/user_warning.py": "used by all other folders",
    "geometry/rotations.py": "without PyTorch, as checks of data start at once",
    "health/alignment_checks.py": "stands beside camera_checks and lidar_checks",
    "health/sphere.py": "the lowest of the room",
    "jobs/worker.py": "libraries' threads, apart from the pools that it protects",
    "ops/each_sweep.py": "several ops need it",
    "papers/two_stage_rows.py": "table and figures both need it",
    "simulation/arrays.py": "names of types that the whole room shares",
    "simulation/packaged.py": "imports nothing: examples and tests read it",
    "simulation/tables.py": "many files read their table by it",
    "visualization/cells.py": "the lowest of the room",
    "visualization/zoom.py": "the sheet and the row both need it",
}
"""Modules of fewer than 40 lines, each with the reason why it is no part of another."""
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


def test_a_file_below_40_lines_has_a_reason():
    room = ROOT / "src" / "sightline"
    lengths = {
        path.relative_to(room).as_posix(): len(path.read_text().splitlines())
        for path in room.rglob("*.py")
        if path.name != "__init__.py"
    }
    assert sorted(path for path, length in lengths.items() if length < 40) == sorted(SMALL_FILES)
    assert [path for path, length in lengths.items() if length > 500] == []
