from pathlib import Path

import pytest

from sightline.geometry.arguments import nearest, plain_names, plain_path, plain_text


def test_texts_and_paths_are_taken_and_other_types_named():
    assert plain_text("name", "000042") == "000042"
    assert plain_path("path", "a/b", "a folder") == Path("a/b")
    with pytest.raises(TypeError, match=r"^name is of type int, expected text; give a name$"):
        plain_text("name", 42)
    with pytest.raises(TypeError, match=r"^path is of type NoneType, expected a folder$"):
        plain_path("path", None, "a folder")


def test_misspelt_names_are_told_the_nearest():
    names = ("depth-best", "detection2d-best", "detection3d-best")
    assert nearest("depth-bst", names) == "perhaps depth-best is meant; "
    assert nearest("Depth_Best", names) == "perhaps depth-best is meant; "
    assert nearest("detection2d", names) == "perhaps detection2d-best is meant; "
    assert nearest("xyz", names) == nearest("", names) == ""


def test_several_names_are_a_collection_of_those_that_there_are():
    names = ("image", "points")
    assert plain_names("parts", ["points"], names) == ("points",)
    for wrong in ("image", 3):
        with pytest.raises(
            TypeError, match=r"parts is of type .*, expected several names, such as"
        ):
            plain_names("parts", wrong, names)
    with pytest.raises(ValueError, match="parts contains 'imgae'; perhaps image is meant; choose"):
        plain_names("parts", ["imgae"], names)
    with pytest.raises(ValueError, match="parts contains 3; choose from image, points"):
        plain_names("parts", [3], names)
