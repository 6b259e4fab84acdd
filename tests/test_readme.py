"""The README's lines do what it says."""

import re
import shutil
from pathlib import Path

import pytest

from sightline.cli.main import main
from sightline.simulation.packaged import PACKAGED_FRAMES

ROOT = Path(__file__).parent.parent
RESULTS = (ROOT / "docs" / "results.md", *(ROOT / "docs" / "results").glob("*.md"))
README = (ROOT / "README.md").read_text()
MARKED = dict(
    re.findall(r"<!-- tests/test_readme.py runs [^>]*-->\n```(\w+)\n(.*?)```", README, re.DOTALL)
)
COMMANDS = [line.removeprefix("$ ") for line in MARKED["console"].splitlines()]


def test_every_figure_of_the_readme_on_how_good_it_is_stands_in_the_results():
    results = "".join(page.read_text() for page in RESULTS)
    section = README.partition("\n## How good it is\n")[2].partition("\n## ")[0]
    figures = set(re.findall(r"\d[\d.,]*\d|\d", re.sub(r"\[[^\]]*\]\([^)]*\)", "", section)))
    assert len(figures) > 40
    assert {
        each
        for each in figures
        if not re.search(rf"(?<![\d.]){re.escape(each)}(?![\d.]\d)", results)
    } == set()
    for interval in re.findall(r"\[[\d, ]+\]", section):
        assert interval in results


@pytest.fixture(scope="module")
def folder_with_frames(tmp_path_factory):
    folder = tmp_path_factory.mktemp("readme")
    shutil.copytree(PACKAGED_FRAMES, folder / "KITTI")
    return folder


def test_the_readme_has_commands_and_python_to_run():
    assert set(MARKED) == {"console", "python"}
    assert all(command.startswith("sightline ") for command in COMMANDS)


def test_the_commands_of_the_readme_run_one_after_the_other(
    folder_with_frames, monkeypatch, capsys
):
    """In one process, without the seconds that each would need to import its libraries."""
    monkeypatch.chdir(folder_with_frames)
    for command in COMMANDS:
        status = main(command.split()[1:])
        printed = capsys.readouterr()
        assert status == 0, f"{command}: {printed.err}"
        assert printed.out
    for written in (
        "000001.png",
        "depth/000000.png",
        "depth.json",
        "found/000001.txt",
        "gates/000000.png",
        "objects.json",
    ):
        assert (folder_with_frames / written).stat().st_size > 0


def test_the_python_of_the_readme_runs(folder_with_frames, monkeypatch):
    monkeypatch.chdir(folder_with_frames)
    names = {}
    exec(MARKED["python"], names)
    assert names["dense"].depth_m.shape == names["sample"].image_size
    assert names["dense"].valid.any()
    assert len(names["answer"].detections.scores)
