"""Refusal of outputs among the inputs, for all arguments of every command."""

import inspect
from collections.abc import Iterator
from pathlib import Path

import pytest

from sightline.cli.main import _commands, main
from sightline.cli.parser import _LISTS
from sightline.files.problem import plain_line
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.tasks import REGISTRY, find_task

FURTHER = {each.name for name in REGISTRY for each in find_task(name).outputs[1:]}
TASKS = {name.replace("-", "_") for name in REGISTRY}
OUTPUTS = {"out", "out_folder", "export", "json", "csv", "markdown", "plots", "picture", "page",
           "figures", "video", "rerun", *FURTHER}  # fmt: skip
RESULTS = {"results", "fit_results", "against", "predictions", "run"}
FILES = {"sample_list", "fit_list", "weights", "weights_without", "baseline", "healthy", "compare",
         "limits", "calibration", "gated", "ones", "early", "late", "camera", "lidar", "first",
         "second", "improved", "rig", "joined",
         *TASKS}  # fmt: skip
NO_FILES = {"method", "task", "suite", "cases", "show", "frames", "overlaps", "figure_frame",
            "camera_topic", "lidar_topic", "info_topic", "tasks", "training_frame",
            "host", "kinds"}  # fmt: skip
NEVER_TOGETHER = {
    "robustness": [
        ("page", (FILES | RESULTS | {"data"}) - {"compare"}),
        ("compare", OUTPUTS - {"page"}),
    ],
    "evaluate objects": [("against", {"csv", "markdown", "plots"})],
}
MESSAGES = (
    "would change",
    "lies in",
    "among the input results",
    "is no regular file",
    "would replace",
)


def commands(found=None, prefix="") -> Iterator[tuple[str, object]]:
    for name, command in (found or _commands()).items():
        if isinstance(command, dict):
            yield from commands({k: v for k, v in command.items() if k != "_help"} or {"": None},
                                f"{prefix}{name} ")  # fmt: skip
        elif callable(command):
            yield f"{prefix}{name}", command


COMMANDS = {name: command for name, command in commands() if name != "simulate"}  # reads nothing


def given(name, path, kind):
    """Value of a path for an argument."""
    if name == "healthy":
        return (f"camera={path}",)
    if name == "compare":
        return (str(path), str(path))
    if "list[str" in str(kind):
        return [str(path)]
    if "tuple[str" in str(kind):
        return (str(path),)
    return Path(path) if "Path" in str(kind) else str(path)


def pairs(command):
    """Yield arguments of an input and an output with the same path, or one inside the other."""
    parameters = inspect.signature(command).parameters
    kinds = {name: each.annotation for name, each in parameters.items()}
    outputs = [name for name in kinds if name in OUTPUTS]
    for name, kind in kinds.items():
        if name in OUTPUTS or ("Path" not in str(kind) and name not in FILES | RESULTS):
            continue
        if name in RESULTS:
            places = [("both", "both")]
        elif name in FILES:
            places = [("both/input.json", "both/input.json"), ("both/input.json", "both")]
        else:
            places = [("both", "both/new.json")]
        for output in outputs:
            for read, written in places:
                yield {name: given(name, read, kind), output: Path(written)}


def test_every_argument_that_is_a_text_is_known_to_be_a_file_or_none():
    for command in COMMANDS.values():
        for name, each in inspect.signature(command).parameters.items():
            is_text = any(word in str(each.annotation) for word in ("'str'", "str |", "[str"))
            if is_text and "Literal" not in str(each.annotation):
                assert name in FILES | RESULTS | OUTPUTS | NO_FILES, name


def test_every_option_with_several_values_takes_them_as_words():
    for command, function in commands():
        for name, each in inspect.signature(function).parameters.items():
            is_option = each.kind is each.KEYWORD_ONLY and each.annotation is not bool
            if is_option and "tuple[" in str(each.annotation):
                assert f"--{name.replace('_', '-')}" in _LISTS, f"{command} --{name}"


def test_every_command_with_inputs_is_walked():
    counts = {name: len(list(pairs(command))) for name, command in COMMANDS.items()}
    assert {name for name, count in counts.items() if not count} == {
        "demo", "tasks",
    }  # fmt: skip
    assert sum(counts.values()) > 100


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_no_output_takes_the_place_of_an_input(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "both").mkdir()
    (tmp_path / "both" / "input.json").write_text("mine")
    command = COMMANDS[name]
    parameters = inspect.signature(command).parameters
    defaults = {
        each: given(each, f"other/{each}", parameter.annotation)
        if parameter.default is parameter.empty
        else parameter.default
        for each, parameter in parameters.items()
    }
    if "data" in defaults:  # required, though it is optional in the signature
        defaults["data"] = Path("other")
    for pair in pairs(command):
        never = NEVER_TOGETHER.get(name, ())
        if any(each in pair and others & set(pair) for each, others in never):
            continue
        settings = defaults | pair
        if name == "robustness":
            settings |= {"data": None} if "compare" in pair else {"out_folder": Path("run")} | pair
        with pytest.raises(ValueError, match="|".join(MESSAGES)) as caught:
            command(**settings)
        assert plain_line(str(caught.value)) == str(caught.value)
        assert [path.name for path in (tmp_path / "both").iterdir()] == ["input.json"], pair
        assert (tmp_path / "both" / "input.json").read_text() == "mine"


def test_a_link_that_leads_to_itself_is_named_in_one_line(tmp_path, capsys):
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    commands = (
        ["check", loop],
        ["import", loop, tmp_path / "out"],
        ["predict", "depth-completion", PACKAGED_FRAMES, loop / "out", "--method", "nearest"],
    )
    for command in commands:
        assert main([str(word) for word in command]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert str(loop) in line


@pytest.mark.parametrize("name", ["x" * 256, "/".join(["x" * 200] * 21)])
def test_a_path_that_is_too_long_is_named_with_its_remedy(name, tmp_path, capsys):
    assert main(["check", str(tmp_path / name)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "the path is too long" in line
    assert line.endswith("choose a shorter one")
    assert len(line) < 300
