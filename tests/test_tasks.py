import subprocess
import sys
from dataclasses import replace

import pytest

from sightline import tasks
from sightline.cli.main import main
from sightline.files.weights_header import shipped_names
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.tasks import Task, choose_task, find_task, task_names, weights_of
from tests.depth_completion.networks import write_tiny_weights
from tests.toy_task import registration
from tests.toy_task.registration import FinderTask


@pytest.mark.parametrize("name", task_names())
def test_a_task_declares_what_the_registry_says(name):
    task = find_task(name)
    assert isinstance(task, Task)
    assert task.name == name
    assert task.outputs
    assert len({output.name for output in task.outputs}) == len(task.outputs)
    assert task.default_weights is None or task.default_weights in weights_of(task)


def test_all_weights_that_come_with_the_package_are_of_a_task():
    owned = [each for name in task_names() for each in weights_of(find_task(name))]
    assert sorted(owned) == list(shipped_names())


def test_a_task_is_chosen_by_its_name_then_by_its_weights_and_else_is_the_first(tmp_path):
    weights = write_tiny_weights(tmp_path / "tiny.safetensors")
    first = find_task(task_names()[0])
    assert choose_task(None, None) is first
    assert choose_task(None, weights) is find_task("depth-completion")
    assert choose_task("depth-completion", None) is find_task("depth-completion")


def test_a_task_that_there_is_not_is_refused_with_those_that_there_are(tmp_path):
    with pytest.raises(ValueError, match="no task tarot; name one of depth-completion"):
        find_task("tarot")
    weights = write_tiny_weights(tmp_path / "tiny.safetensors", task="tarot")
    with pytest.raises(ValueError, match=r"tiny\.safetensors holds weights for tarot, a task that"):
        choose_task(None, weights)


def test_the_registry_and_what_tasks_declare_need_no_heavy_library():
    script = (
        "import sys; from sightline.tasks import *\n"
        "for name in task_names(): weights_of(find_task(name)); recipes_of(find_task(name))\n"
        "print(sorted({'torch', 'numba', 'scipy', 'cv2'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout == "[]\n"


def _place(monkeypatch, **members):
    """Declare the toy task with other members; those that are None are left out."""
    own = {name: member for name, member in vars(FinderTask).items() if name[0] != "_"} | members
    declared = {
        name: member for name, member in own.items() if member is not None or name not in members
    }
    monkeypatch.setattr(registration, "TASK", type("Declared", (), declared)())
    monkeypatch.setitem(tasks.REGISTRY, "toy-finder", "tests.toy_task.registration:TASK")


@pytest.mark.parametrize(
    ("members", "fault"),
    [
        ({"detects_around": None, "demo": None}, "lacks detects_around, demo of sightline.tasks"),
        ({"outputs": ()}, "has no outputs"),
        (
            {"outputs": (replace(FinderTask.outputs[0], name="x/y"),)},
            "has an output named 'x/y', expected letters, digits and _",
        ),
        (
            {"outputs": (FinderTask.outputs[0], replace(FinderTask.outputs[0], name="more"))},
            "has two outputs of one key: likely_cells, likely_cells",
        ),
        ({"outputs": FinderTask.outputs * 2}, "has two outputs of one name: cells, highest, cells"),
        (
            {"outputs": (replace(FinderTask.outputs[0], suffix="npy"),)},
            "has the output cells with suffix 'npy', expected a dot first",
        ),
        (
            {"outputs": (replace(FinderTask.outputs[0], further="depth"),)},
            "has the output cells with the key depth, which lines of perceive use already",
        ),
    ],
)
def test_a_task_that_is_declared_wrongly_is_told(monkeypatch, capsys, members, fault):
    _place(monkeypatch, **members)
    with pytest.raises(ValueError, match=f"^tests.toy_task.registration:TASK {fault}"):
        find_task("toy-finder")
    assert main(["tasks"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_class_in_place_of_a_task_is_told(monkeypatch):
    monkeypatch.setattr(registration, "TASK", FinderTask)
    monkeypatch.setitem(tasks.REGISTRY, "toy-finder", "tests.toy_task.registration:TASK")
    with pytest.raises(ValueError, match=r"TASK is a class, expected .*; write FinderTask\(\);"):
        find_task("toy-finder")


def test_a_task_that_makes_no_predictor_is_told(monkeypatch, tmp_path, capsys):
    _place(monkeypatch, predictor=lambda _self, **_: None, methods=("cells",))
    given = ["predict", "toy-finder", str(PACKAGED_FRAMES), str(tmp_path / "out")]
    assert main([*given, "--method", "cells"]) == 2
    assert "the predictor is None, expected an object" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["weights", "out", "workers", "method", "config", "help"])
def test_an_output_with_the_name_of_an_option_is_told(monkeypatch, capsys, name):
    first, second = FinderTask.outputs
    _place(monkeypatch, outputs=(first, replace(second, name=name)))
    assert main(["predict", "toy-finder", "D", "O"]) == 2
    assert f"toy-finder has an output or switch named {name}, which" in capsys.readouterr().err


def test_every_place_in_the_registry_is_in_the_package():
    assert all(place.startswith("sightline.") for place in tasks.REGISTRY.values())


def test_a_method_loaded_as_weights_is_told_as_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(
        ValueError, match=r"adaptive is a method .*; make DepthCompleter\(.adaptive"
    ):
        tasks.load("adaptive")
