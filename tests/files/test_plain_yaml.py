import pytest

from sightline.files.plain_yaml import read_yaml
from sightline.files.problem import FileError


def read(tmp_path, content: str | bytes) -> object:
    path = tmp_path / "calibration.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_yaml(path, "see the guide")


@pytest.mark.parametrize(
    "content",
    [
        "a: [1, 2.5]\nb: {c: text}\n",
        '{\n\t"a": [1, 2.5],\n\t"b": {"c": "text"}\n}',
        b'\xef\xbb\xbf{"a": [1, 2.5], "b": {"c": "text"}}',
        "a: [1, 2.5]\rb: {c: text}\r",
    ],
)
def test_yaml_and_json_give_the_same_values(tmp_path, content):
    assert read(tmp_path, content) == {"a": [1, 2.5], "b": {"c": "text"}}


def test_aliases_stand_for_values_as_dumps_write_them(tmp_path):
    assert read(tmp_path, "a: &a [1, 2]\nb: [*a, *a]\n") == {"a": [1, 2], "b": [[1, 2]] * 2}


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (
            "a0: &a0 [x]\n"
            + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 10)),
            r"line 6 stands for more than 65536 values by its aliases",
        ),
        ("a: &a [*a]\n", r"line 1 has an alias \(\*\) of a value that contains it"),
        ("a: &a {x: 1}\nb: {<<: *a}\n", "line 2 has a merge or no key"),
        ("b: {<<: {x: 1}}\n", "line 1 has a merge or no key"),
        ("? [1, 2]\n: 3\n", "line 1 has a merge or no key"),
        ("a: 1\nb: 2\na: 3\n", "line 3 has 'a' a second time"),
        ("[" * 50_000, "nested more than 12 deep"),
        ('{"a":' * 10_000, "nested more than 12 deep"),
        ("- " * 10_000, "nested more than 12 deep"),
        (
            "%YAML:1.0\n---\na: 1\n",
            "begins with OpenCV's header %YAML:.*; remove the line; see the",
        ),
        ("a: [1\n", "is neither YAML nor JSON: line 2, column 1"),
        ("a: !!python/object:os.system {}\n", "is neither YAML nor JSON: line 1"),
        *(
            (f"a: {value}\n", "is neither YAML nor JSON")
            for value in ("!!bool x", "!!timestamp x", "!!int [1]", "2011-13-45")
        ),
        (" " * 2**18, "bytes long, expected up to"),
    ],
)
def test_bombs_and_broken_files_are_refused_in_one_line(tmp_path, content, complaint):
    with pytest.raises(FileError, match=complaint) as caught:
        read(tmp_path, content)
    assert caught.value.problem.path == tmp_path / "calibration.yaml"
    assert caught.value.problem.remedy
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("number", ["1:" * 180 + "1.5", "1" + ":1" * 60_000, "1:30"])
def test_numbers_of_base_60_are_text(tmp_path, number):
    assert read(tmp_path, f"a: {number}\nb: -1.5e+3\nc: 16") == {"a": number, "b": -1500.0, "c": 16}


@pytest.mark.parametrize("number", ["0700", "0x1F", "0b11", "7_00", "7_00.5"])
def test_numbers_of_other_bases_and_in_groups_are_refused_by_line(tmp_path, number):
    with pytest.raises(FileError, match=f"line 2 has the number {number}, expected decimal"):
        read(tmp_path, f"a: 1\nb: [{number}]\n")
    assert read(tmp_path, f"b: '{number}'") == {"b": number}


def test_exponents_need_neither_point_nor_sign_as_in_json(tmp_path):
    text = "a: [7e2, -1E-3, 2.5e+1, 2.5e1, .5e1, .inf, +0, -0.5, 1.e1]"
    expected = [700.0, -0.001, 25.0, 25.0, 5.0, float("inf"), 0, -0.5, 10.0]
    assert read(tmp_path, text) == {"a": expected}


def test_a_control_character_is_named(tmp_path):
    with pytest.raises(FileError, match=r"it holds the control character '.x1b'"):
        read(tmp_path, "a: \x1b[31m")
