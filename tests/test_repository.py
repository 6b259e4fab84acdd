"""What holds for the repository as a whole."""

import re
import subprocess
from collections import Counter
from pathlib import Path

import pytest

from sightline.cli.main import _commands
from sightline.simulation.settings import PRESETS

ROOT = Path(__file__).parent.parent
MAX_LINES = 600
MAX_README_LINES = 120
MAX_README_WIDTH = 160


def tracked(pattern):
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", pattern],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if listed.returncode:
        pytest.skip("this is no git checkout")
    return [ROOT / name for name in listed.stdout.splitlines() if (ROOT / name).is_file()]


def test_every_python_file_can_be_read_in_one_sitting():
    sources = tracked("*.py")
    assert len(sources) > 20
    lengths = {path.name: len(path.read_text().splitlines()) for path in sources}
    assert {name: lines for name, lines in lengths.items() if lines > MAX_LINES} == {}


def test_the_readme_is_short():
    lines = (ROOT / "README.md").read_text().splitlines()
    assert len(lines) <= MAX_README_LINES
    assert [line for line in lines if len(line) > MAX_README_WIDTH] == []


def test_nothing_large_is_committed():
    weights = tracked("src/sightline/weights/*")
    others = [path for path in tracked(".") if path not in weights]
    assert [path.name for path in others if path.stat().st_size > 1 << 20] == []
    of_tasks = Counter[str]()
    for path in weights:
        of_tasks[path.name.partition("-")[0]] += path.stat().st_size
    assert {"depth", "detection2d", "detection3d"} <= of_tasks.keys()
    assert max(of_tasks.values()) <= 8e6


def test_every_file_that_the_documents_link_to_exists():
    links = [
        (document, target)
        for document in tracked("*.md")
        for target in re.findall(r"\]\(([^)#]+)[^)]*\)", document.read_text())
        if "://" not in target
    ]
    assert links
    missing = [link for link in links if not (link[0].parent / link[1]).exists()]
    assert missing == []


DOCUMENTS = {
    path: path.read_text() for path in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"))
}
ROOTS = ("", "src/", "src/sightline/")
SOURCES = {
    path.relative_to(ROOT).as_posix(): path
    for folder in ("src", "tests", "benchmarks", "docs")
    for path in (ROOT / folder).rglob("*.py")
}


def expanded(name):
    """The names that one with braces stands for, as a shell has it."""
    before, brace, rest = name.partition("{")
    if not brace:
        return [name]
    choices, _, after = rest.partition("}")
    return [full for choice in choices.split(",") for full in expanded(before + choice + after)]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_source_file_that_a_document_names_exists_with_what_is_said_to_be_in_it(document):
    named = re.findall(r"`([\w/{},*]+\.py)(?:: (\w+))?`", DOCUMENTS[document])
    for group, symbol in named:
        for name in expanded(group):
            pattern = re.compile(re.escape(name).replace(r"\*", "[^/]*"))
            found = [
                path
                for full, path in SOURCES.items()
                if any(pattern.fullmatch(full.removeprefix(root)) for root in ROOTS)
                or ("/" not in name and pattern.fullmatch(path.name))
            ]
            assert found, f"{document.name} names {name}"
            texts = [path.read_text() for path in found]
            assert not symbol or any(
                re.search(rf"^\s*(def|class) {symbol}\b", text, re.MULTILINE) for text in texts
            ), f"{document.name} names {symbol} in {name}"


def test_recipes_presets_benchmarks_and_targets_that_the_documents_name_are_there():
    package = ROOT / "src" / "sightline"
    known = {
        r"--config ([\w-]+)": {path.stem for path in (package / "recipes").glob("*.yaml")},
        r"--preset ([\w-]+)": set(PRESETS),
        r"python -m benchmarks\.(\w+)": {path.stem for path in (ROOT / "benchmarks").glob("*.py")},
        r"(?:\$ |`)make ([\w-]+)": set(
            re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
        ),
    }
    for pattern, names in known.items():
        named = {name for text in DOCUMENTS.values() for name in re.findall(pattern, text)}
        assert named, pattern
        assert named - names == set(), pattern


def test_every_command_that_the_documents_name_is_one():
    named = {
        each
        for text in DOCUMENTS.values()
        for each in re.findall(r"(?:\$ |`)sightline ([a-z]+) ?([\w-]*)", text)
    }
    commands = _commands()
    assert {("simulate", "street"), ("evaluate", "held-out")} <= named
    for command, argument in named:
        assert command in commands
        if command in ("predict", "evaluate", "reproduce") and argument:
            assert argument in commands[command] or argument.isupper(), f"{command} {argument}"
