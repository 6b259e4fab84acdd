import pytest

from sightline.data.formats.kitti_labels import read_results
from sightline.joining.files import kitti_from_objects, write_objects
from tests.joining.scenes import make_sample
from tests.structures.test_objects import three_objects


def test_a_result_file_holds_both_boxes_of_the_objects_inside_the_image(tmp_path):
    write_objects(tmp_path / "000000.txt", make_sample(), three_objects())
    found = read_results(tmp_path / "000000.txt")
    assert found.class_names == ("Car", "Cyclist")
    assert found.scores.tolist() == pytest.approx([0.9, 0.25])
    assert found.boxes2d[0].tolist() == [1.0, 2.0, 30.0, 20.0]
    assert found.dimensions_hwl.tolist() == [[1.5, 2.0, 4.0], [-1.0, -1.0, -1.0]]
    # Camera: x right, y down to the bottom's centre, z forward.
    assert found.locations[0].tolist() == pytest.approx([-1.0, 1.67, 8.73])
    assert found.locations[1].tolist() == [-1000.0] * 3


def test_results_in_space_are_the_objects_with_a_3d_box_and_its_score():
    found = kitti_from_objects(three_objects(), make_sample(), in_space=True)
    assert found.class_names == ("Car",)
    assert found.scores.tolist() == [0.75]
