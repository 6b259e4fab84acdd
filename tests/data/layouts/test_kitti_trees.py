import pytest

from sightline.data.layouts.kitti_trees import suggest_frames


@pytest.mark.parametrize(
    ("asked", "meant"),
    [
        ("1", "perhaps 000001 is meant; "),
        ("0000012", "perhaps 000012 is meant; "),
        ("00001x", "perhaps 000012 or 000001 is meant; "),
        ("street", ""),
        ("", ""),
        ("٣", ""),
    ],
)
def test_frames_with_the_same_number_or_a_similar_name_are_suggested(asked, meant):
    known = ("000001", "000012", "notes")
    assert suggest_frames(asked, known) == f"{meant}there are 3, from 000001 to notes"
