import io
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from PIL import Image

from sightline.data.importing.bag_messages import (
    PictureFile,
    cloud_from_message,
    image_file_from_message,
    image_from_message,
    num_unread,
)
from tests.data.recordings import IMAGE


def message(pixels, encoding, *, step_px=0):
    height, width = pixels.shape[:2]
    rows = pixels.reshape(height, -1)
    padded = np.pad(rows, ((0, 0), (0, step_px)))
    return SimpleNamespace(
        encoding=encoding, height=height, width=width, step=padded.shape[1], data=padded.ravel()
    )


@pytest.mark.parametrize(
    ("encoding", "made"),
    [
        ("rgb8", lambda rgb: rgb),
        ("bgr8", lambda rgb: rgb[..., ::-1]),
        ("rgba8", lambda rgb: np.dstack((rgb, rgb[..., 0]))),
        ("bgra8", lambda rgb: np.dstack((rgb[..., ::-1], rgb[..., 0]))),
    ],
)
def test_colours_are_the_same_whatever_their_order_and_padding(encoding, made):
    rgb = IMAGE[:20, :30]
    for step_px in (0, 5):
        sent = message(np.ascontiguousarray(made(rgb)), encoding, step_px=step_px)
        np.testing.assert_array_equal(image_from_message(sent, "/camera"), rgb)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_a_bayer_pattern_is_named_by_its_first_two_rows(pattern):
    rgb = np.zeros((16, 16, 3), np.uint8)
    rgb[:] = (200, 120, 40)
    mosaic = np.empty((16, 16), np.uint8)
    for at, letter in enumerate(pattern):
        mosaic[at // 2 :: 2, at % 2 :: 2] = rgb[0, 0, "rgb".index(letter)]
    np.testing.assert_array_equal(
        image_from_message(message(mosaic, f"bayer_{pattern}8"), "/c"), rgb
    )


def test_grey_becomes_three_equal_channels():
    grey = IMAGE[:8, :9, 0]
    np.testing.assert_array_equal(
        image_from_message(message(grey, "mono8"), "/camera"), np.repeat(grey[..., None], 3, axis=2)
    )


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"encoding": "32FC1"}, "topic /camera holds images of encoding '32FC1', expected one of"),
        ({"height": 99}, "topic /camera holds an image of .* bytes, expected 99 rows"),
        ({"step": 3, "height": 21}, "cut short"),
        ({"step": 10**9, "height": 21}, "cut short"),
        ({"width": 0}, "topic /camera holds an image of 20x0"),
    ],
)
def test_an_image_that_cannot_be_read_names_its_topic(changes, expected):
    sent = message(IMAGE[:20, :30], "rgb8")
    vars(sent).update(changes)
    with pytest.raises(ValueError, match=expected):
        image_from_message(sent, "/camera")


def test_a_picture_that_was_sent_as_a_file_stays_as_it_is():
    _, encoded = cv2.imencode(".jpg", IMAGE)
    sent = SimpleNamespace(format="jpeg", data=encoded.ravel())
    assert image_file_from_message(sent, "/camera") == PictureFile(
        suffix=".jpg", content=encoded.tobytes(), size=IMAGE.shape[:2], is_blank=False
    )
    sent.data = encoded.ravel()[: len(encoded) // 2]
    with pytest.raises(ValueError, match=r"topic /camera.* is cut short"):
        image_file_from_message(sent, "/camera")
    _, depth = cv2.imencode(".png", np.zeros((4, 5), np.uint16))
    with pytest.raises(ValueError, match="pictures of 16 bits, expected 8"):
        image_file_from_message(SimpleNamespace(format="16UC1", data=depth.ravel()), "/camera")
    _, webp = cv2.imencode(".webp", IMAGE)
    with pytest.raises(ValueError, match=r"topic /camera \(webp\).* another by --camera-topic"):
        image_file_from_message(SimpleNamespace(format="webp", data=webp.ravel()), "/camera")


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("compression", ["jpeg compressed ", "png compressed bayer", ""])
def test_a_compressed_mosaic_becomes_a_picture_in_colour(pattern, compression):
    mosaic = np.empty((16, 16), np.uint8)
    for at, letter in enumerate(pattern):
        mosaic[at // 2 :: 2, at % 2 :: 2] = (200, 120, 40)["rgb".index(letter)]
    _, encoded = cv2.imencode(".png", mosaic)
    sent = SimpleNamespace(format=f"bayer_{pattern}8; {compression}", data=encoded.ravel())
    file = image_file_from_message(sent, "/camera")
    assert (file.suffix, file.size, file.is_blank) == (".png", (16, 16), False)
    bgr = cv2.imdecode(np.frombuffer(file.content, np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(bgr, np.broadcast_to((40, 120, 200), bgr.shape))


def test_a_mosaic_of_an_unknown_pattern_is_refused_and_one_in_colour_is_kept():
    _, grey = cv2.imencode(".png", IMAGE[:16, :16, 0])
    sent = SimpleNamespace(format="bayer_rgbw8; png compressed", data=grey.ravel())
    with pytest.raises(ValueError, match=r"mosaics of an unknown pattern; republish it as Image"):
        image_file_from_message(sent, "/camera")
    _, colour = cv2.imencode(".png", IMAGE[:16, :16])
    sent = SimpleNamespace(format="bayer_rggb8; png compressed bgr8", data=colour.ravel())
    assert image_file_from_message(sent, "/camera").content == colour.tobytes()


def test_pictures_whose_red_and_blue_may_be_exchanged_are_told():
    _, encoded = cv2.imencode(".png", IMAGE)
    sent = SimpleNamespace(format="bgr8; png compressed rgb8", data=encoded.ravel())
    with pytest.warns(UserWarning, match="exchange red and blue in pictures of this format"):
        file = image_file_from_message(sent, "/camera")
    assert file.content == encoded.tobytes()


def test_a_note_of_the_orientation_in_a_picture_is_not_followed():
    rotated = Image.Exif()
    rotated[0x0112] = 6
    Image.fromarray(IMAGE).save(file := io.BytesIO(), "JPEG", exif=rotated)
    sent = SimpleNamespace(format="jpeg", data=np.frombuffer(file.getvalue(), np.uint8))
    assert image_file_from_message(sent, "/camera").size == IMAGE.shape[:2]


def test_an_image_of_a_size_that_its_encoding_cannot_have_names_its_topic():
    sent = message(np.zeros((4, 5, 2), np.uint8), "yuv422")
    with pytest.raises(ValueError, match=r"topic /camera holds an image of 4x5 .* 'yuv422' cannot"):
        image_from_message(sent, "/camera")


def cloud(layout, rows, *, height=1, row_gap=0, is_bigendian=False):
    values = np.zeros((height, len(rows) // height), layout)
    for name in layout.names:
        values[name] = np.arange(len(rows)).reshape(height, -1) + 10 * len(name)
    datatypes = {"f4": 7, "f8": 8, "u1": 2, "u2": 4}
    fields = [
        SimpleNamespace(name=name, offset=offset, count=1, datatype=datatypes[kind.str[1:]])
        for name, (kind, offset) in layout.fields.items()
    ]
    raw = values.view(np.uint8).reshape(height, -1)
    return values, SimpleNamespace(
        fields=fields,
        height=height,
        width=len(rows) // height,
        point_step=layout.itemsize,
        row_step=raw.shape[1] + row_gap,
        is_bigendian=is_bigendian,
        data=np.pad(raw, ((0, 0), (0, row_gap))).ravel(),
    )


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("height", "row_gap"), [(1, 0), (2, 0), (3, 8)])
def test_a_cloud_is_read_whatever_its_layout(order, height, row_gap):
    layout = np.dtype(
        {
            "names": ["x", "y", "z", "ring", "reflectivity"],
            "formats": [f"{order}f4", f"{order}f8", f"{order}f4", f"{order}u2", "u1"],
            "offsets": [0, 8, 16, 20, 30],
            "itemsize": 32,
        }
    )
    values, sent = cloud(
        layout, range(6), height=height, row_gap=row_gap, is_bigendian=order == ">"
    )
    expected = np.stack([values[name].ravel() for name in ("x", "y", "z", "reflectivity")], axis=1)
    np.testing.assert_array_equal(cloud_from_message(sent, "/points"), expected)


def test_a_cloud_without_a_coordinate_names_its_topic_and_its_fields():
    layout = np.dtype([("x", "<f4"), ("y", "<f4"), ("range", "<f4")])
    _, sent = cloud(layout, range(4))
    with pytest.raises(ValueError, match="topic /points: has the fields x, y, range, but not z"):
        cloud_from_message(sent, "/points")
    sent.width = 5
    with pytest.raises(ValueError, match="topic /points holds a cloud of 48 bytes, expected 1"):
        cloud_from_message(sent, "/points")
    sent.width = 0
    with pytest.raises(ValueError, match=r"holds a cloud of 1x0 points .* but 48 bytes"):
        cloud_from_message(sent, "/points")


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("row_step", [0, 7, 10**9])
def test_a_length_of_rows_that_is_not_that_of_the_bytes_is_not_believed(order, row_step):
    layout = np.dtype([(name, f"{order}f4") for name in ("x", "y", "z", "intensity")])
    values, sent = cloud(layout, range(6), height=2, is_bigendian=order == ">")
    expected = np.stack([values[name].ravel() for name in layout.names], axis=1)
    sent.row_step = row_step
    np.testing.assert_array_equal(cloud_from_message(sent, "/points"), expected)
    picture = message(IMAGE[:20, :30], "rgb8")
    picture.step = row_step
    np.testing.assert_array_equal(image_from_message(picture, "/camera"), IMAGE[:20, :30])
    assert num_unread(sent) == num_unread(picture) == 0


def test_the_last_row_may_lack_the_bytes_that_fill_it_up():
    layout = np.dtype([(name, "<f4") for name in ("x", "y", "z", "intensity")])
    values, sent = cloud(layout, range(6), height=3, row_gap=8)
    sent.data = sent.data[:-8]
    np.testing.assert_array_equal(cloud_from_message(sent, "/points")[:, 2], values["z"].ravel())


@pytest.mark.parametrize("row_gap", [0, 8])
def test_points_and_rows_beyond_the_size_of_a_message_are_counted(row_gap):
    layout = np.dtype([(name, "<f4") for name in ("x", "y", "z", "intensity")])
    _, sent = cloud(layout, range(12), height=3, row_gap=row_gap)
    assert num_unread(sent) == 0
    sent.data = sent.data[: len(sent.data) - row_gap]
    assert num_unread(sent) == 0
    sent.data = np.pad(sent.data, (0, row_gap + 15))
    assert num_unread(sent) == 0  # less than a point
    sent.data = np.pad(sent.data, (0, 1 + 16))
    assert num_unread(sent) == 2
    picture = message(IMAGE[:20, :30], "rgb8", step_px=row_gap)
    assert num_unread(picture) == 0
    picture.data = np.pad(picture.data, (0, picture.step - 1))
    assert num_unread(picture) == 0  # less than a row
    picture.height = 15
    assert num_unread(picture) == 5


@pytest.mark.parametrize("row_step", [48, 96])  # reduced together with the width, or kept
def test_a_width_below_that_of_the_data_leaves_points_unread(row_step):
    layout = np.dtype([(name, "<f4") for name in ("x", "y", "z", "intensity")])
    _, sent = cloud(layout, range(6))
    sent.width, sent.row_step = 3, row_step
    assert num_unread(sent) == 3
    assert len(cloud_from_message(sent, "/points")) == 3


@pytest.mark.parametrize("encoding", ["RGB8", " rgb8", "8uc3", "8UC3"])
def test_the_case_of_an_encoding_does_not_count(encoding):
    rgb = IMAGE[:20, :30]
    sent = rgb if "rgb" in encoding.lower() else np.ascontiguousarray(rgb[..., ::-1])
    np.testing.assert_array_equal(image_from_message(message(sent, encoding), "/camera"), rgb)


def test_fields_that_stand_for_gaps_may_share_a_name_and_those_beyond_a_point_are_refused():
    layout = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("i", "<f4"), ("gap", "<f4")])
    values, sent = cloud(layout, range(4))
    sent.fields.append(sent.fields[-1])
    np.testing.assert_array_equal(cloud_from_message(sent, "/points")[:, 2], values["z"].ravel())
    sent.fields[0].offset = 18
    with pytest.raises(ValueError, match="topic /points holds a cloud whose fields do not fit"):
        cloud_from_message(sent, "/points")


def test_a_coordinate_of_an_unknown_type_is_named_as_such():
    _, sent = cloud(np.dtype([(name, "<f4") for name in ("x", "y", "z")]), range(4))
    sent.fields[2].datatype = 99
    with pytest.raises(
        ValueError, match="/points holds a cloud whose field z has the unknown type"
    ):
        cloud_from_message(sent, "/points")


def test_an_intensity_of_an_unknown_type_is_left_out_with_a_warning():
    layout = np.dtype([(name, "<f4") for name in ("x", "y", "z", "intensity")])
    values, sent = cloud(layout, range(4))
    sent.fields[3].datatype = 99
    with (
        pytest.warns(UserWarning, match="field intensity has the unknown type 99"),
        pytest.warns(UserWarning, match="no intensity field"),
    ):
        points = cloud_from_message(sent, "/points")
    np.testing.assert_array_equal(points[:, 2], values["z"].ravel())
    assert not points[:, 3].any()


def test_the_first_of_two_coordinates_with_one_name_is_used_with_a_warning():
    layout = np.dtype([(name, "<f4") for name in ("x", "y", "z", "intensity", "other")])
    values, sent = cloud(layout, range(4))
    sent.fields[4].name = "x"
    with pytest.warns(UserWarning, match="several fields named x"):
        points = cloud_from_message(sent, "/points")
    np.testing.assert_array_equal(points[:, 0], values["x"].ravel())
