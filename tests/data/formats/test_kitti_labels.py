import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from sightline.data.formats.kitti_labels import (
    KittiObjects,
    parse_objects,
    read_labels,
    read_results,
    write_objects,
)

LABEL = b"Car 0.80 1 -2.09 1013.39 182.46 1241.00 374.00 1.57 1.65 3.35 4.43 1.65 5.20 -1.42"
RESULT = LABEL + b" 0.931"
REGION = b"DontCare -1 -1 -10 737.69 163.56 790.86 197.98 -1 -1 -1 -1000 -1000 -1000 -10"


def labels(data):
    return parse_objects(data, "000001.txt", with_scores=False)


def results(data):
    return parse_objects(data, "000001.txt", with_scores=True)


def test_every_field_comes_to_its_place():
    objects = results(b"Car 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15")
    assert objects.class_names == ("Car",)
    assert objects.truncation.tolist() == [1]
    assert objects.occlusion.tolist() == [2]
    assert objects.alpha.tolist() == [3]
    assert objects.boxes2d.tolist() == [[4, 5, 6, 7]]
    assert objects.dimensions_hwl.tolist() == [[8, 9, 10]]
    assert objects.locations.tolist() == [[11, 12, 13]]
    assert objects.rotation_y.tolist() == [14]
    assert objects.scores.tolist() == [15]


def test_labels_have_no_scores_and_keep_the_order_of_their_lines():
    objects = labels(LABEL + b"\n" + REGION + b"\n")
    assert objects.class_names == ("Car", "DontCare")
    assert len(objects) == 2
    assert objects.scores is None


@pytest.mark.parametrize("data", [b"", b"\n", b" \t\r\n\n \x0b"])
def test_a_file_without_lines_is_a_frame_without_objects(data):
    for objects in (labels(data), results(data)):
        assert len(objects) == 0
        assert objects.boxes2d.shape == (0, 4)
    assert results(data).scores.shape == (0,)


def test_blank_lines_tabs_and_windows_line_ends_are_passed_over():
    data = b"\r\n" + LABEL.replace(b" ", b"\t  ") + b"  \r\n\n\n" + REGION
    assert labels(data).class_names == ("Car", "DontCare")


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
def test_byte_order_marks_and_ends_of_lines_take_no_object_out(end):
    mark = b"\xef\xbb\xbf"
    objects = labels(end.join((mark + LABEL, REGION, mark + LABEL, b"")))
    assert objects.class_names == ("Car", "DontCare", "Car")
    assert results(mark + RESULT).class_names == ("Car",)


def test_only_ascii_white_space_parts_fields_as_in_c():
    objects = labels(LABEL.replace(b"Car", "Car\u00a0\u3000\x1c".encode()))
    assert objects.class_names == ("Car\u00a0\u3000\x1c",)


def test_labels_may_have_a_score_which_is_left_out():
    assert labels(RESULT + b"\n" + LABEL).scores is None


def test_a_class_with_an_underscore_is_read():
    assert labels(LABEL.replace(b"Car", b"Person_sitting")).truncation.tolist() == [0.8]


def test_columns_cannot_be_written_to():
    with pytest.raises(ValueError, match="read-only"):
        labels(LABEL).truncation[0] = 1


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (LABEL[:-6], "line 1 has 14 fields, but a label has 15; add rotation_y"),
        (LABEL + b"\n\nCar", "line 3 has 1 fields, but a label has 15; add truncation, occlusion"),
        (
            b"0 12 " + LABEL,
            "line 1 has 17 fields: frame and track number come before the class, as in KITTI track"
            "ing, .*; write a file for each frame without its first two fields, and",
        ),
        (b"# of frame 7\n" + LABEL, "line 1 is a comment, expected an object; remove the line"),
        (b"type truncated occluded alpha left\n" + LABEL, "line 1 is a heading or other text, .*;"),
        (b"Car nan nan nan\n" + LABEL, "line 1 has 4 fields, but a label has 15"),
        (LABEL.replace(b" ", b";"), "line 1 has 1 fields.*; separate fields by spaces, without ;"),
        (LABEL.replace(b" ", "\u2009".encode()), "line 1 has no-break or wide spaces"),
        (LABEL.replace(b" ", "\u00a0".encode()), "line 1 has no-break or wide spaces .*; separate"),
        (LABEL.replace(b" 1 ", " 1\u3000".encode()), "line 1 has no-break or wide spaces"),
        (b"2 0.5 0.5 0.1 0.2", "line 1 has 5 numbers, as YOLO labels have .*; convert them to"),
        (
            b"P0: 7.2e+02 0 6.1e+02 0 0 7.2e+02 1.7e+02 0 0 0 1 0",
            "line 1 begins with 'P0:' and numbers, as calibrations do; give the folder of label or",
        ),
        (
            b'[{"type":"Car"}]',
            "line 1 is JSON, expected an object of KITTI's: 15 fields .*; convert",
        ),
        (b'{\n  "objects": [7]\n}', "line 1 is JSON, expected"),
        (b"<annotation>", "line 1 is XML, expected an object of KITTI's"),
        (LABEL.replace(b"Car", b"[") + b"\nCar", "line 2 has 1 fields"),
        ("Car 0".encode("utf-16"), "is text in UTF-16, expected UTF-8; save it as plain text in U"),
        ("Car 0".encode("utf-16-le"), "holds a NUL byte at position 1: .* UTF-16"),
        (RESULT + b" 7", "line 1 has 17 fields, but a label has 15; remove the fields after rotat"),
        (
            LABEL.replace(b"Car", b"Person sitting"),
            "line 1 has spaces in its class 'Person sitting', .*; write Person_sitting, or the",
        ),
        (LABEL.replace(b"182.46", b"1x2"), "line 1: y_min is '1x2', not a number; write a"),
        (LABEL.replace(b"182.46", b"1_0"), "line 1: y_min is '1_0', not a number"),
        (LABEL.replace(b"182.46", b"0x1p3"), "line 1: y_min is '0x1p3', not a number"),
        (LABEL.replace(b"182.46", b"\xff"), "line 1: y_min is '\ufffd', not a number"),
        (LABEL.replace(b"182.46", b"nan"), "line 1: y_min is 'nan', not finite"),
        (LABEL.replace(b"182.46", b"-inf"), "line 1: y_min is '-inf', not finite"),
        (LABEL.replace(b"182.46", b"1e999"), "line 1: y_min is '1e999', not finite"),
        (LABEL.replace(b"182.46", b"-1e13"), "line 1: y_min is '-1e13', beyond 1e.12; write m"),
        (LABEL.replace(b"0.80 1 ", b"0.80 0.5 "), "line 1: occlusion is '0.5', not a whole"),
        (LABEL.replace(b"Car", b"C" * 65), "line 1: class is 'C+...', longer than 64 characters"),
        (LABEL.replace(b"Car", b"\xff\xfa"), "line 1: class is .*, not text in UTF-8"),
        (
            LABEL.replace(b"Car", b"C_r").replace(b"182.46", b"1_0"),
            "line 1: y_min is '1_0', not a num",
        ),
    ],
)
def test_a_bad_label_line_names_file_line_field_and_remedy(data, message):
    with pytest.raises(ValueError, match=f"^000001.txt: {message}") as caught:
        labels(data)
    assert "\n" not in str(caught.value)


def test_fields_parted_by_commas_are_told_so():
    with pytest.raises(ValueError, match=r"line 1 has 1 fields, .*; separate fields by spaces"):
        results(RESULT.replace(b" ", b","))


def test_a_result_line_without_score_says_so():
    with pytest.raises(ValueError, match=r"line 2 has 15 fields, but a result has 16; add score"):
        results(RESULT + b"\n" + LABEL)
    with pytest.raises(
        ValueError, match="17 fields, but a result has 16; remove the fields after sc"
    ):
        results(RESULT + b" 1")
    with pytest.raises(ValueError, match="has spaces in its class 'big red Car', expected one"):
        results(RESULT.replace(b"Car", b"big red Car"))
    with pytest.raises(ValueError, match="score is 'nan', not finite"):
        results(LABEL + b" nan")


def test_the_occlusion_of_a_result_may_be_any_number():
    assert results(RESULT.replace(b"0.80 1 ", b"0.80 0.5 ")).occlusion.tolist() == [0.5]


def test_files_that_cannot_be_read_are_named(tmp_path):
    for read in (read_labels, read_results):
        with pytest.raises(ValueError, match=r"none\.txt: cannot be read: no such file"):
            read(tmp_path / "none.txt")
        with pytest.raises(ValueError, match="is no regular file"):
            read(tmp_path)


def test_labels_are_written_as_kitti_writes_them(tmp_path):
    text = LABEL + b"\n" + REGION + b"\n"
    write_objects(tmp_path / "a.txt", labels(text))
    assert (tmp_path / "a.txt").read_bytes() == text


def test_scores_keep_all_digits_and_other_fields_as_many_as_asked_for(tmp_path):
    objects = results(LABEL.replace(b"1013.39", b"1013.3912345678901") + b" -0.1234567890123456")
    for decimals, x_min in ((2, 1013.39), (4, 1013.3912), (None, 1013.3912345678901)):
        write_objects(tmp_path / "a.txt", objects, decimals=decimals)
        again = read_results(tmp_path / "a.txt")
        assert again.boxes2d[0, 0] == x_min
        assert again.scores.tolist() == [-0.1234567890123456]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"class_names": ("a car",)}, "line 1: class is 'a car', expected one word: rename it"),
        ({"class_names": ("",)}, "line 1: class is '', expected one word"),
        (
            {"class_names": ("c" * 65,)},
            "line 1: class is longer than 64 characters: write a shorter",
        ),
        ({"alpha": np.array([math.nan])}, "line 1: alpha is nan, not finite"),
        ({"occlusion": np.array([0.5])}, "line 1: occlusion is 0.5, not a whole number"),
        ({"locations": np.full((1, 3), 1e30)}, "line 1: x is 1e.30, beyond 1e.12: write metres"),
    ],
)
def test_what_no_reader_would_understand_is_not_written(tmp_path, change, message):
    with pytest.raises(ValueError, match=f"a.txt cannot be written, {message}"):
        write_objects(tmp_path / "a.txt", replace(labels(LABEL), **change))
    assert not list(tmp_path.iterdir())


def test_columns_of_different_lengths_are_refused():
    with pytest.raises(ValueError, match=r"columns of one length, got .*'class_names': 2"):
        replace(labels(LABEL), class_names=("Car", "Van"))


def test_scores_that_are_no_numbers_are_refused():
    with pytest.raises(ValueError, match="1 scores are NaN, expected numbers"):
        replace(labels(LABEL), scores=np.array([np.nan]))


scores = st.floats(allow_nan=False, allow_infinity=False)
numbers = st.floats(-1e12, 1e12)
names = st.text(st.characters(codec="utf-8"), min_size=1, max_size=8).filter(
    lambda name: name.encode().split() == [name.encode()]
)


@st.composite
def columns(draw):
    # not a KittiObjects yet: the shape checks draw random numbers, which a strategy must not
    count = draw(st.integers(0, 3))

    def column(width=None, numbers=numbers):
        shape = count if width is None else (count, width)
        size = count * (width or 1)
        values = draw(st.lists(numbers, min_size=size, max_size=size))
        return np.array(values, dtype=np.float64).reshape(shape)

    whole = draw(st.lists(st.integers(-1, 3), min_size=count, max_size=count))
    return dict(  # noqa: C408 - read as the record that it becomes
        class_names=tuple(draw(st.lists(names, min_size=count, max_size=count))),
        truncation=column(),
        occlusion=np.array(whole, dtype=np.float64),
        alpha=column(),
        boxes2d=column(4),
        dimensions_hwl=column(3),
        locations=column(3),
        rotation_y=column(),
        scores=column(numbers=scores) if draw(st.booleans()) else None,
    )


@given(columns=columns())
def test_written_with_all_digits_any_record_reads_back_the_same(tmp_path_factory, columns):
    objects = KittiObjects(**columns)
    path = tmp_path_factory.mktemp("labels") / "a.txt"
    write_objects(path, objects, decimals=None)
    again = read_labels(path) if objects.scores is None else read_results(path)
    assert again.class_names == objects.class_names
    for name in KittiObjects.__dataclass_fields__:
        if name not in ("class_names", "scores"):
            np.testing.assert_array_equal(getattr(again, name), getattr(objects, name))
    if objects.scores is not None:
        np.testing.assert_array_equal(again.scores, objects.scores)


@example(b"\x85 1 \xa0", False)
@example(LABEL.replace(b"Car", b"_"), False)
@given(
    data=st.binary() | st.text("Car 0123456789.-einfa_x\n").map(str.encode), scored=st.booleans()
)
def test_any_bytes_give_a_record_or_an_error_that_names_the_file(data, scored):
    message = "000001.txt: "
    try:
        assert np.isfinite(parse_objects(data, "000001.txt", with_scores=scored).boxes2d).all()
    except ValueError as error:
        message = str(error)
    assert message.startswith("000001.txt: ")
    assert message.isprintable()


@given(place=st.integers(0, len(RESULT) - 1), byte=st.integers(0, 255), scored=st.booleans())
def test_any_damaged_byte_gives_a_record_or_an_error_that_names_the_file(place, byte, scored):
    data = RESULT[:place] + bytes([byte]) + RESULT[place + 1 :]
    test_any_bytes_give_a_record_or_an_error_that_names_the_file.hypothesis.inner_test(data, scored)
