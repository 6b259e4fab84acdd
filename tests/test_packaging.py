"""What is published beside the code fits it: description, notice, workflow, hooks."""

import re
import tomllib
from pathlib import Path
from typing import get_args

import yaml

from sightline.files.problem import Extra

ROOT = Path(__file__).parents[1]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = SETTINGS["project"]


def test_the_description_for_a_package_index_has_no_links_to_files_that_are_not_there():
    hook = SETTINGS["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]
    text = (ROOT / "README.md").read_text()
    for rule in hook["substitutions"]:
        text = re.sub(rule["pattern"], rule["replacement"], text)
    targets = re.findall(r"\]\(([^)]*)\)", text)
    assert targets
    assert [target for target in targets if not target.startswith("https://")] == []
    assert "docs/pictures" not in text


def test_the_notice_names_every_library_that_is_installed_along():
    notice = (ROOT / "NOTICE").read_text().lower()
    extras = PROJECT["optional-dependencies"]
    required = [
        *PROJECT["dependencies"],
        *(each for extra in get_args(Extra) for each in extras[extra]),
    ]
    names = [re.match(r"[\w-]+", each).group() for each in required]
    called = {"torch": "pytorch"}
    assert [name for name in names if called.get(name, name).lower() not in notice] == []


def test_the_workflow_runs_the_whole_check_with_every_python_that_is_promised():
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "check.yml").read_text())
    job = workflow["jobs"]["check"]
    promised = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    assert job["strategy"]["matrix"]["python"] == promised
    assert [step["run"] for step in job["steps"] if "run" in step] == [".ci/run"]


def test_the_check_runs_targets_that_the_makefile_has():
    text = (ROOT / ".ci" / "run").read_text()
    lines = re.findall(r"^make (?:--jobs 2 )?([\w -]+)", text, re.MULTILINE)
    targets = [target for line in lines for target in line.split()]
    assert targets == ["test", "package", "demo"]
    known = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert set(targets) <= set(known)


def test_the_hooks_before_a_commit_are_tools_of_the_check():
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    assert [each["repo"] for each in hooks] == ["local"]
    lint = (ROOT / "Makefile").read_text().partition("\nlint:")[2].partition("\n\n")[0]
    for hook in hooks[0]["hooks"]:
        command = hook["entry"].removeprefix(".venv/bin/").removesuffix(" --force-exclude")
        assert f"$(BIN)/{command}" in lint
