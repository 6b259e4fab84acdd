import pickle
import tomllib
from pathlib import Path
from typing import get_args

import pytest

from sightline.files.problem import (
    Extra,
    FileError,
    Problem,
    error_text,
    escaped,
    install_command,
    memory_fault,
    plain_line,
)

ROOT = Path(__file__).parents[2]


def test_an_error_of_a_file_holds_path_problem_and_remedy_and_reads_as_one_line():
    error = FileError("a/b.bin", "holds 17 bytes", "extract\nit again")
    assert error.problem == Problem(
        path=Path("a/b.bin"), problem="holds 17 bytes", remedy="extract\nit again"
    )
    assert str(error) == "a/b.bin: holds 17 bytes; extract it again"
    assert isinstance(error, ValueError)


def test_an_error_of_a_file_comes_whole_out_of_another_process():
    error = FileError(Path("b.bin"), "is empty", "write it again")
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again)) == (FileError, str(error))
    assert again.problem == error.problem


def test_names_out_of_data_cannot_write_to_the_terminal():
    error = FileError("a\x1b[31mb\udce9.bin", "is 'x\x1b]0;y\x07'\nno problems", "rename it")
    assert str(error).isprintable()
    assert "\\x1b[31mb\\udce9.bin" in str(error)


def test_a_line_for_people_holds_nothing_that_steers_a_screen():
    assert plain_line("a\n b\t\x1b[2J \u202e\udce9 é") == r"a b \x1b[2J \u202e\udce9 é"
    assert escaped("  a\nb") == r"  a\nb"


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory: you tried"),
        RuntimeError("Exception from src/inference/src/dev/plugin.cpp:54: can't alloc\n"),
        RuntimeError("std::bad_alloc"),
        ImportError("libtorch.so: failed to map segment from shared object"),
        RuntimeError("(-4:Insufficient memory) Failed to allocate 99 bytes"),
    ],
)
def test_want_of_memory_is_known_by_whichever_error_a_library_raises(error):
    assert "memory ran out; use fewer workers" in memory_fault(error)


def test_other_errors_are_no_want_of_memory():
    assert memory_fault(RuntimeError("shapes do not match")) is None


@pytest.mark.parametrize("extra", get_args(Extra))
def test_a_hint_installs_an_extra_that_the_project_has_from_its_own_folder(extra):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert extra in project["optional-dependencies"]
    assert install_command(extra).startswith(f"pip install '.[{extra}]'")


def test_no_hint_names_a_package_of_an_index_where_there_is_none():
    for path in (ROOT / "src").rglob("*.py"):
        assert "sightline[" not in path.read_text(), path


def test_a_lack_of_permission_is_told_with_the_path_and_how_to_get_it():
    error = PermissionError(13, "Permission denied", "data/calib")
    text = "data/calib: permission denied; give this user access to it and its folder"
    assert error_text(error) == text
    assert error_text(ValueError("other")) == "other"
