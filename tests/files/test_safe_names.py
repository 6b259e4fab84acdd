import pytest

from sightline.data.layouts.frame_lists import read_sample_list
from sightline.files.problem import FileError
from sightline.files.safe_names import checked_name, path_below


@pytest.mark.parametrize("name", ["scene-0061", "n015-2018 11h21", "Straße", "n" * 200])
def test_a_plain_name_is_returned_as_it_is(name):
    assert checked_name(name, "scene.json", "row 1: the name") == name


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("", "is empty"),
        ("..", "begins with a dot"),
        (".ssh", "begins with a dot"),
        (" a", "begins with a dot or a space"),
        ("a/b", "holds a separator"),
        ("a\\b", "holds a separator"),
        ("a\nb", "holds a control character"),
        ("a\x00b", "holds a control character"),
        ("a\u202eb", r"holds U\+202E \(right-to-left override\), which cannot be seen"),
        ("a\u202f1", r"holds U\+202F \(narrow no-break space\), which looks like a plain space"),
        ("a\ue000", r"holds U\+E000 \(no known character\), which cannot be seen"),
        ("\ud800", "is not UTF-8, expected"),
        ("stra\udcdfe", r"is not UTF-8 \(Latin-1, from an older archive\?\)"),
        ("ä" * 101, "has more than 200 bytes"),
        (7, "is no text"),
    ],
)
def test_any_other_name_is_refused_with_its_place_in_one_printable_line(name, fault):
    with pytest.raises(FileError, match=rf"scene.json: row 1: the name .* {fault}") as caught:
        checked_name(name, "scene.json", "row 1: the name")
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    "relative",
    ["/etc/passwd", "../a", "a/../../b", "a//b", "./a", "a/.ssh/b", "C:/a", "a\\..\\b", "", None],
)
def test_a_path_that_leads_out_of_its_root_is_refused(tmp_path, relative):
    with pytest.raises(FileError, match=r"t.json: row 2: the filename is .*, expected a relative"):
        path_below(tmp_path, relative, "t.json", "row 2: the filename")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("stra\udcdfe", r"'stra.udcdfe', which is not UTF-8 \(Latin-1, from .*, expected a rel"),
        ("a/b\u00a0", r"'a/b.xa0', of which a part holds U\+00A0 \(no-break space\), which"),
        ("../a", r"'../a', of which a part is '\.\.', expected"),
        ("C:", "'C:', which is a drive"),
    ],
)
def test_frames_that_are_named_get_the_fault_of_their_name(tmp_path, name, said):
    with pytest.raises(FileError, match=f"frame 1 is {said}.*where files have this name, rename"):
        read_sample_list([name], tmp_path)


def test_a_path_below_its_root_is_resolved_whether_or_not_it_is_there(tmp_path):
    path = path_below(tmp_path, "samples/CAM/a b.jpg", "t.json", "row 2: the filename")
    assert path == tmp_path / "samples" / "CAM" / "a b.jpg"


def test_a_link_within_the_data_set_is_followed_and_one_that_leads_out_refused(tmp_path):
    root = tmp_path / "data"
    (root / "a").mkdir(parents=True)
    for name, target in (("inside", root / "a"), ("outside", tmp_path / "private")):
        (root / name).symlink_to(target)
    assert path_below(root, "inside", "t.json", "row 2") == root / "inside"
    with pytest.raises(FileError, match=r"row 2 names .*outside, a link that leads out"):
        path_below(root, "outside", "t.json", "row 2")


def test_a_list_of_frames_holds_no_paths_that_lead_elsewhere(tmp_path):
    path = tmp_path / "list.txt"
    path.write_text("000001\n../../secret\n")
    with pytest.raises(FileError, match=r"list.txt: frame 2 is '../../secret'"):
        read_sample_list(path, tmp_path)


def test_a_path_of_windows_gets_its_own_remedy(tmp_path):
    with pytest.raises(FileError, match=r"plain names with / between them; replace each"):
        path_below(tmp_path, "samples\\CAM_FRONT\\0.jpg", "sample_data.json", "row 1: the filename")
