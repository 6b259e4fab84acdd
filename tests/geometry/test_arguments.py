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
    known = ("depth-best", "detection2d-best", "detection3d-best")
    assert nearest("depth-bst", known) == "perhaps depth-best is meant; "
    assert nearest("Depth_Best", known) == "perhaps depth-best is meant; "
    assert nearest("detection2d", known) == "perhaps detection2d-best is meant; "
    assert nearest("xyz", known) == nearest("", known) == ""


def test_several_names_are_a_collection_of_those_that_there_are():
    known = ("image", "points")
    assert plain_names("parts", ["points"], known) == ("points",)
    for wrong in ("image", 3):
        with pytest.raises(
            TypeError, match=r"parts is of type .*, expected several names, such as"
        ):
            plain_names("parts", wrong, known)
    with pytest.raises(ValueError, match="parts holds 'imgae'; perhaps image is meant; name some"):
        plain_names("parts", ["imgae"], known)
    with pytest.raises(ValueError, match="parts holds 3; name some of image, points"):
        plain_names("parts", [3], known)
