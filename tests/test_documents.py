"""What the documents, the site and the citation say holds."""

import json
import re
import shlex
import shutil
import tomllib
from pathlib import Path

import jsonargparse
import jsonschema
import pytest
import yaml
from packaging.version import Version

import sightline
from sightline.cli.main import _commands, main
from sightline.cli.parser import OneLineParser
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.tasks import PACKAGE_RECIPES
from sightline.training.arguments import resolve_recipes

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
DOCUMENTS = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
TRAINING = ("fit", "validate", "test")


def commands_of(text):
    """The words of each line `$ sightline ...`, and of those that it goes on in."""
    joined = re.sub(r" *\\\n *", " ", text)
    lines = re.findall(r"^\$ (sightline .*)$", joined, re.MULTILINE)
    return [tuple(shlex.split(line, comments=True)[1:]) for line in lines]


COMMANDS = sorted({words for path in DOCUMENTS for words in commands_of(path.read_text())})


def test_lines_that_go_on_and_remarks_are_understood():
    text = "$ sightline check A  # looks\n$ sightline show \\\n    A '0 1'\n$ pip install .\n"
    assert commands_of(text) == [("check", "A"), ("show", "A", "0 1")]


def test_there_are_commands_in_every_guide():
    assert len(COMMANDS) > 50
    for path in (ROOT / "docs" / "guides").glob("*.md"):
        assert commands_of(path.read_text()), path.name


@pytest.fixture(scope="module")
def commands():
    return _commands()


def parse(words, commands):
    """Parses a command and does not run it; a parser is good for one command only."""
    assert words[0] in commands, f"there is no command {words[0]}"
    parser = jsonargparse.auto_parser(
        {words[0]: commands[words[0]]}, prog="sightline", parser_class=OneLineParser
    )
    return parser.parse_args(list(words))


@pytest.mark.parametrize(
    "words", [each for each in COMMANDS if each[0] not in TRAINING], ids=" ".join
)
def test_a_command_of_the_documents_parses(words, commands):
    if words != ("--version",):
        assert parse(words, commands).subcommand == words[0]


@pytest.mark.parametrize(
    "words", [each for each in COMMANDS if each[0] == "robustness"], ids=" ".join
)
def test_a_bench_of_the_documents_has_a_folder_that_no_list_swallows(words, commands):
    given = parse(words, commands).robustness
    assert (given.out_folder is None) == (given.compare is not None)


def test_a_command_that_does_not_parse_is_noticed(commands, capsys):
    with pytest.raises(SystemExit):
        parse(("predict", "detection2d", "KITTI", "found", "--doors", "doors"), commands)
    assert "--doors" in capsys.readouterr().err


@pytest.mark.parametrize("words", [each for each in COMMANDS if each[0] in TRAINING], ids=" ".join)
def test_a_training_of_the_documents_names_settings_that_its_recipe_has(words, capsys):
    arguments = [word for word in words if word != "--print_config"]
    with pytest.raises(SystemExit) as done:
        main([*arguments, "--print_config"])
    assert done.value.code == 0
    recipe = words[words.index("--config") + 1]
    _, name = resolve_recipes(arguments[1:], PACKAGE_RECIPES)
    assert name == recipe
    assert yaml.safe_load(capsys.readouterr().out)["model"]["class_path"].startswith("sightline.")


def test_the_python_of_the_guide_to_broken_sensors_runs(tmp_path, monkeypatch):
    shutil.copytree(PACKAGED_FRAMES, tmp_path / "KITTI")
    monkeypatch.chdir(tmp_path)
    guide = (ROOT / "docs" / "guides" / "break_a_sensor.md").read_text()
    names = {}
    for block in re.findall(r"```python\n(.*?)```", guide, re.DOTALL):
        exec(block, names)
    assert names["broken"].camera_mask.any()
    assert "Car" in names["answer"].detections.class_names


def test_every_name_of_the_front_door_is_in_the_reference():
    pages = "".join(path.read_text() for path in (ROOT / "docs" / "reference").glob("*.md"))
    shown = set(re.findall(r"^::: sightline\.(\w+)$", pages, re.MULTILINE))
    assert shown == set(sightline.__all__) - {"__version__"}


def test_every_page_is_in_the_navigation():
    text = (ROOT / "mkdocs.yml").read_text()
    listed = set(re.findall(r"([\w/]+\.md)$", text, re.MULTILINE))
    pages = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    assert pages <= listed


def test_the_citation_is_valid():
    citation = yaml.load((ROOT / "CITATION.cff").read_text(), Loader=yaml.BaseLoader)
    schema = json.loads((ROOT / "tests" / "schemas" / "cff-1.2.0.json").read_text())
    jsonschema.Draft7Validator(schema).validate(citation)
    assert citation["license"] == PROJECT["license"]


def test_the_changelog_has_the_last_release_below_what_is_unreleased_newest_first():
    changelog = (ROOT / "CHANGELOG.md").read_text()
    headings = re.findall(r"^## \[(.+?)\](?: - (\d{4}-\d\d-\d\d))?$", changelog, re.MULTILINE)
    assert headings[0] == ("Unreleased", "")
    dates = [date for _, date in headings[1:]]
    assert all(dates)
    assert dates == sorted(dates, reverse=True)
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert (cited["version"], str(cited["date-released"])) == headings[1]


def test_a_checkout_has_no_version_of_a_release_that_it_is_not():
    text = (ROOT / "CHANGELOG.md").read_text().split("\n## ")
    version, release = Version(PROJECT["version"]), Version(text[2].partition("]")[0][1:])
    is_release = version == release and text[1].splitlines()[2].startswith("Lines for what comes")
    assert is_release or (version.is_devrelease and version > release)
