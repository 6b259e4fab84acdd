"""Whole numbers in the column of the truncation: flags, levels, track numbers."""

import pytest

from sightline.data.check import check_tree
from sightline.data.checks.truncations import TruncationTally
from sightline.data.formats.kitti_labels import read_labels
from tests.data.trees import write_object_tree

INSIDE = (300, 150, 340, 180)
AT_THE_SIDE, BELOW = (0, 150, 200, 300), (600, 300, 700, 374)
WHOLE_IMAGE = (0, 0, 1241, 374)


def label(truncation, box, name="Car"):
    corners = " ".join(str(number) for number in box)
    return f"{name} {truncation} 0 -10 {corners} 1.50 1.60 4.00 1.00 1.60 20.00 0.00\n"


@pytest.mark.parametrize(
    ("truncations", "box", "is_doubtful"),
    [
        ([1, 0] * 5, INSIDE, True),  # flags
        (range(10), INSIDE, True),  # numbers
        ([1, 0] * 4, INSIDE, False),  # too few
        ([1, 0] * 5, AT_THE_SIDE, False),
        ([1, 0] * 5, BELOW, False),
        ([1] * 9 + [0.25], INSIDE, False),
        ([-1] * 9, INSIDE, False),
    ],
)
def test_whole_numbers_of_objects_inside_the_image_are_doubted(
    tmp_path, truncations, box, is_doubtful
):
    tally = TruncationTally()
    for number, each in enumerate(truncations):
        path = tmp_path / f"{number}.txt"
        path.write_text(label(each, box) + label(0, WHOLE_IMAGE))
        tally.add(read_labels(path))
    doubt = tally.doubt()
    assert (doubt is not None) == is_doubtful
    if doubt is not None:
        large = sum(each >= 1 for each in truncations)
        total = 2 * len(truncations)
        assert doubt.startswith(f"give {large} of {total} objects a truncation of 1 or more and")


def test_one_box_beyond_the_image_does_not_move_its_border(tmp_path):
    path, tally = tmp_path / "labels.txt", TruncationTally()
    beyond = (1100, 100, 3000, 374)
    path.write_text("".join(label(1, (1000, 100, 1241, 374)) for _ in range(60)) + label(1, beyond))
    tally.add(read_labels(path))
    assert tally.doubt() is None


def test_regions_and_labels_without_objects_count_for_nothing(tmp_path):
    empty, regions = tmp_path / "empty.txt", tmp_path / "regions.txt"
    empty.write_text("")
    regions.write_text("".join(label(1, INSIDE, "DontCare") for _ in range(9)))
    tally = TruncationTally()
    assert tally.doubt() is None
    for path in (empty, regions):
        tally.add(read_labels(path))
    assert tally.doubt() is None


def test_check_tells_flags_in_place_of_truncations(tmp_path):
    names = [f"{number:06}" for number in range(6)]
    tree = write_object_tree(tmp_path, *names) / "training"
    for name in names:
        path = tree / "label_2" / f"{name}.txt"
        path.write_text(path.read_text().replace("Car 0.10", "Car 1"))
        path.write_text(path.read_text() + label(0, (0, 0, 39, 11)))
    told = [each for each in check_tree(tmp_path) if "probably flags" in each.problem]
    assert [each.path for each in told] == [tree / "label_2"]
    assert "scores ignore objects above 0.5" in told[0].problem


def test_labels_of_kitti_have_shares(kitti_root):
    tally, files = TruncationTally(), sorted((kitti_root / "training" / "label_2").glob("*.txt"))
    for path in files:
        tally.add(read_labels(path))
    assert tally.has_fraction
    assert tally.num_objects > len(files)
    assert tally.doubt() is None
