import pickle
from pathlib import Path

from sightline.data.problem import FileError, Problem


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
