"""Sizes of labels in feet or decimetres."""

import shutil

import numpy as np
import pytest

from sightline.data.check import check_tree
from sightline.data.checks.label_units import doubt_about_units
from sightline.data.formats.kitti_labels import parse_objects
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.data.recordings import write_recording
from tests.data.trees import write_object_tree

SIZES = {"Car": (1.5, 1.6, 3.9), "Pedestrian": (1.7, 0.6, 0.8), "Cyclist": (1.7, 0.6, 1.7)}
FOOT_M = 0.3048


def lines(names, factors, places=(1, 1, 1)):
    """Labels with sizes, and places, times factors."""
    written = []
    for number, name in enumerate(names):
        sizes = " ".join(
            f"{size * factor:.2f}" for size, factor in zip(SIZES[name], factors, strict=True)
        )
        where = " ".join(f"{x * by:.2f}" for x, by in zip((number, 1.6, 12), places, strict=True))
        written.append(f"{name} 0 0 -1.5 5 3 {20 + number} 9 {sizes} {where} -1.5\n")
    return "".join(written)


def doubt(names, factors):
    text = lines(names, factors).encode()
    return doubt_about_units([parse_objects(text, "labels", with_scores=False)])


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (1 / FOOT_M, "3.2 times the usual ones: Car (2) has a median height, width, length of"),
        (1 / FOOT_M, "4.92, 5.25, 12.8, expected about 1.53, 1.63, 3.88 m; they are probably in f"),
        (10, "probably in decimetres"),
        (FOOT_M, "probably converted from feet, but are in metres"),
    ],
)
def test_sizes_of_three_objects_off_by_the_factor_of_a_unit_are_told(factor, said):
    for names in (("Car", "Car", "Pedestrian"), ("Cyclist", "Car", "Car")):
        assert said in doubt(names, (factor,) * 3)
    assert doubt(("Car", "Car"), (factor,) * 3) is None


@pytest.mark.parametrize("factors", [(1,) * 3, (2,) * 3, (0.5,) * 3, (3, 1, 1), (2.2, 1.6, 4.2)])
def test_other_sizes_are_no_doubt(factors):
    assert doubt(("Car", "Pedestrian", "Cyclist", "Car"), factors) is None


@pytest.mark.parametrize("kind", ["tree", "recording"])
def test_labels_in_feet_are_blamed_not_the_clouds(tmp_path, kind):
    if kind == "tree":
        labels = write_object_tree(tmp_path, "000001", "000002") / "training" / "label_2"
    else:
        labels = write_recording(tmp_path, ("000001", "000002")) / "labels"
        labels.mkdir(exist_ok=True)
    for path in ("000001", "000002"):
        feet = (1 / FOOT_M,) * 3
        (labels / f"{path}.txt").write_text(lines(("Car", "Pedestrian"), feet, feet))
    (told,) = (each for each in check_tree(tmp_path) if "feet" in each.problem)
    assert told.path == labels
    assert "write sizes, and x, y, z, in metres (a foot is 0.3048 m)" in told.remedy


def test_real_labels_in_feet_are_told_instead_of_clouds_in_another_unit(tmp_path):
    root = shutil.copytree(PACKAGED_FRAMES, tmp_path / "data")
    labels = sorted(root.rglob("label_2/*.txt"))
    for path in labels:
        rows = [line.split() for line in path.read_text().splitlines()]
        for row in rows:
            if row[0] != "DontCare":
                row[8:14] = [f"{each:.2f}" for each in np.array(row[8:14], float) / FOOT_M]
        path.write_text("\n".join(map(" ".join, rows)) + "\n")
    told = [each for each in check_tree(root) if each.path == labels[0].parent]
    assert ["in feet" in each.problem for each in told] == [True]
    assert not any("clouds not in metres" in each.problem for each in check_tree(root))
