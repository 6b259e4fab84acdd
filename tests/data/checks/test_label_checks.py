from pathlib import Path

import pytest

from sightline.data.checks.label_checks import check_objects
from sightline.data.formats.kitti_labels import parse_objects, read_labels

CAR = "Car 0 0 -1.57 100 120 200 180 1.50 1.60 3.90 0.50 1.60 12.00 -1.53"
WALKER = "Pedestrian 0 0 -1.57 100 120 200 180 1.80 0.60 0.80 0.50 1.60 12.00 -1.53"
REGION = "DontCare -1 -1 -10 1 1 4 4 -1 -1 -1 -1000 -1000 -1000 -10"
PATH = Path("000001.txt")


def doubts(*lines: str, size: tuple[int, int] = (375, 1242)) -> list[str]:
    objects = parse_objects("\n".join(lines).encode(), PATH, with_scores=False)
    return [f"{each.problem}; {each.remedy}" for each in check_objects(objects, size, PATH)]


def test_sound_labels_raise_no_doubt():
    assert doubts(CAR, WALKER, REGION, CAR.replace("Car", "Misc")) == []


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("car", "write Car"),
        ("CAR", "write Car"),
        ("Automobile", "write Car"),
        ("pedestrian", "write Pedestrian"),
        ("person", "write Pedestrian"),
        ("Pedestrain", "write Pedestrian"),
        ("Bicycle", "write Cyclist or Misc"),
        ("Cyclsit", "write Cyclist"),
        ("vehicle.bus.rigid", "write Truck or Misc"),
        ("vehicle.van", "write Van"),
        ("human.pedestrian.adult", "write Pedestrian"),
        ("Trucks", "write Truck"),
        ("Pole", "write one of Car, Van"),
        ("Cart", "write one of Car, Van"),
        ("track", "write one of Car, Van"),
        ("vehicle.trailer", "write one of Car, Van"),
        ("dontcare", "write DontCare"),
        ("Car\u200b", "write Car"),
        ("Zebra", "write one of Car, Van"),
    ],
)
def test_class_names_that_are_none_are_doubted_with_what_is_meant(name, meant):
    (doubt,) = doubts(CAR, CAR.replace("Car", name))
    assert doubt.startswith("names 1 of 2 objects '")
    assert "no class of KITTI" in doubt
    assert meant in doubt
    assert doubt.isprintable()


def test_sizes_in_another_order_are_doubted_once_for_a_file():
    turned = CAR.replace("1.50 1.60 3.90", "3.90 1.60 1.50")
    (doubt,) = doubts(turned, turned.replace("12.00", "13.00"), CAR)
    assert "most objects probably in the order length, width, height" in doubt
    (doubt,) = doubts(CAR.replace("1.50 1.60 3.90", "1.60 3.90 1.50"))
    assert "in the order width, length, height" in doubt
    (doubt,) = doubts(WALKER.replace("1.80 0.60 0.80", "0.80 0.60 1.80"))
    assert "in the order length, width, height" in doubt
    assert doubts(turned, CAR, CAR.replace("12.00", "13.00")) == []  # one of three


def test_labels_in_other_units_are_doubted():
    assert "up to 390 m in size" in doubts(CAR.replace("1.50 1.60 3.90", "150 160 390"))[0]
    assert "as far away as 12000" in doubts(CAR.replace("12.00", "12000"))[0]
    assert (
        "relative to the image size" in doubts(CAR.replace("100 120 200 180", "0.1 0.2 0.3 0.4"))[0]
    )
    (doubt,) = doubts(CAR.replace("100 120 200 180", "-1 -1 -1 -1"))
    assert "has placeholders such as 0 0 0 0 for 1 of 1 2D boxes" in doubt


@pytest.mark.parametrize("angles", [("-1.57", "-88"), ("0", "360"), ("270", "-1.53")])
def test_angles_in_degrees_are_doubted_once_for_a_file(angles):
    alpha, rotation = angles
    turned = f"Car 0 0 {alpha} 100 120 200 180 1.50 1.60 3.90 0.50 1.60 12.00 {rotation}"
    (doubt,) = doubts(turned, CAR, turned.replace("12.00", "13.00"), REGION)
    assert "has angles beyond two pi at 2 of 4 objects" in doubt
    assert "probably in degrees; write radians" in doubt


def test_a_name_in_another_case_says_how_evaluation_counts_it():
    (doubt,) = doubts(CAR.replace("Car", "car"))
    assert "evaluation ignores case and reads them as Car" in doubt
    (doubt,) = doubts(CAR.replace("Car", "Zebra"))
    assert "detectors, training and evaluation ignore them" in doubt


def test_the_labels_of_kitti_raise_no_doubt(kitti_root):
    paths = sorted(kitti_root.glob("training/label_2/*.txt"))
    assert len(paths) == 90
    for path in paths:
        assert check_objects(read_labels(path), None, path) == []


def test_lines_of_equal_values_are_told_once_for_a_file():
    (doubt,) = doubts(CAR, WALKER, CAR, WALKER, CAR, REGION)
    assert (
        "repeats 3 of 6 objects with equal values in every field, such as object 1 (Car)" in doubt
    )
    assert doubts(CAR, CAR.replace("12.00", "12.01"), CAR.replace("Car", "Van")) == []


@pytest.mark.parametrize(
    ("truncation", "remedy"),
    [
        ("2", "0 to 1: they are probably KITTI tracking's levels 0 to 2"),
        ("87", "0 to 1: divide them by 100 if they are in percent"),
        ("-0.50", "0 to 1, or -1 where it is not known"),
        ("-1", None),
        ("1.00", None),
        ("0.31", None),
    ],
)
def test_a_truncation_is_a_share_or_unknown(truncation, remedy):
    told = doubts(CAR.replace("Car 0", f"Car {truncation}", 1), WALKER)
    said = "has 1 of 2 truncations other than -1 or 0 to 1, such as "
    assert told == ([] if remedy is None else [each for each in told if said in each])
    assert remedy is None or remedy in told[0]


def test_angles_from_0_to_2_pi_are_told_once_for_a_file():
    turned = CAR.replace("-1.57", "4.71").replace("-1.53", "4.75")
    (doubt,) = doubts(turned, turned.replace("12.00", "13.00"), WALKER)
    assert doubt.startswith("has angles outside -pi to pi at 2 of 3 objects; subtract 2 pi from")


def test_sizes_in_another_order_are_doubted_under_names_in_small_letters():
    turned = CAR.replace("1.50 1.60 3.90", "3.90 1.60 1.50").replace("Car", "car")
    assert any("in the order length, width, height" in each for each in doubts(turned))


def test_thousands_of_faults_are_a_few_lines():
    lines = [f"x{number} 0 9 0 9 9 1 1 0 1 1 1 1 {number} 9" for number in range(3000)]
    told = doubts(*lines)
    assert len(told) < 40
    assert any("names 2995 more of 3000 objects by 2995 more names" in each for each in told)
    assert any("has an occlusion other than -1 to 3 at 2995 more of 3000" in each for each in told)


def test_2d_boxes_that_fit_only_in_another_convention_are_doubted_once_for_a_file():
    wide = [CAR.replace("100 120 200 180", f"{x} 150 90 60") for x in (300, 700, 1100)]
    (doubt,) = doubts(*wide)
    assert "has 3 of 3 2D boxes that end before they begin or lie far outside the image" in doubt
    assert "all are probably x_min, y_min, width, height or centre x, centre y, width" in doubt
    turned = CAR.replace("100 120 200 180", "150 700 200 900")
    (doubt,) = doubts(*(turned.replace("12.00", f"1{place}.00") for place in range(3)))
    assert "probably y_min, x_min, y_max, x_max" in doubt
    (doubt,) = doubts(CAR, CAR.replace("12.00", "13.00"), WALKER, wide[0])  # one of four
    assert doubt.startswith("object 4 of 4 (Car) has a 2D box with its maximum below its minimum")


@pytest.mark.parametrize(
    ("sizes", "order"),
    [
        ("1.50 3.90 1.66", "height, length, width"),
        ("1.66 3.90 1.50", "width, length, height"),
        ("3.90 1.50 1.66", "length, height, width"),
        ("3.90 1.66 1.50", "length, width, height"),
    ],
)
def test_the_order_of_sizes_is_the_one_that_fits_a_class_best(sizes, order):
    turned = CAR.replace("1.50 1.60 3.90", sizes)
    (doubt,) = doubts(*(turned.replace("12.00", f"{12 + place}") for place in range(30)))
    assert f"probably in the order {order}, expected height, width, length" in doubt
    (doubt,) = doubts(CAR.replace("1.50 1.60 3.90", sizes))  # height and width of a car are alike
    assert order in doubt
    assert " or " in doubt


def test_sizes_below_those_of_every_road_user_are_doubted():
    (doubt,) = doubts(CAR.replace("1.50 1.60 3.90", "0.0015 0.0016 0.0039"))
    assert doubt == "has no object larger than 0.0039 m; write sizes, and x, y, z, in metres"
    assert doubts(CAR.replace("1.50 1.60 3.90", "0.0015 0.0016 0.0039"), WALKER) == []


@pytest.mark.parametrize("fill", ["-1 -1 -1 -1 -1 -1 -1", "0 0 0 0 0 0 0", "0 0 0 -1 -1 -1 0"])
def test_fields_filled_by_tools_for_2d_labels_are_no_3d_boxes(fill):
    filled = [" ".join(each.split()[:8]) + f" {fill}" for each in (CAR, WALKER)]
    assert doubts(*filled) == []
    (doubt,) = doubts(CAR.replace("1.50 1.60 3.90", "0 0 0"))
    assert "has a 3D box of a size that is not positive" in doubt


def test_placeholders_of_regions_are_no_3d_boxes():
    assert doubts(CAR, REGION.replace("-1 -1 -1 -1000 -1000 -1000", "0 0 0 0 0 0")) == []
    assert doubts(CAR, REGION.replace("-1000 -1000", "-1000 1000")) == []
