import struct
import zlib
from itertools import product

import cv2
import numpy as np
import pytest
from PIL import Image

from sightline.data.formats.image_file import read_rgb, write_rgb
from sightline.data.formats.image_header import (
    MAX_PIXELS,
    parse_image_header,
    read_image_size,
    read_orientation,
)
from sightline.files.problem import FileError
from tests.data.trees import IMAGE_SIZE, depth_map, picture


def png(
    height: int, width: int, *, data: bytes = b"", bits: int = 8, colour_type: int = 2
) -> bytes:
    """A PNG with right checksums, whatever stands in it."""

    def chunk(kind: bytes, payload: bytes) -> bytes:
        checksum = zlib.crc32(kind + payload)
        return struct.pack(">I", len(payload)) + kind + payload + struct.pack(">I", checksum)

    header = struct.pack(">IIBBBBB", width, height, bits, colour_type, 0, 0, 0)
    chunks = chunk(b"IHDR", header)
    if colour_type == 3:
        chunks += chunk(b"PLTE", bytes(6))
    chunks += chunk(b"IDAT", zlib.compress(data, 9)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks


def test_png_pictures_survive_reading_and_writing(tmp_path):
    write_rgb(tmp_path / "0.png", picture())
    assert np.array_equal(read_rgb(tmp_path / "0.png"), picture())


def test_convention_the_first_channel_is_red(tmp_path):
    red = np.zeros((2, 3, 3), np.uint8)
    red[..., 0] = 255
    write_rgb(tmp_path / "0.png", red)
    write_rgb(tmp_path / "0.jpg", red)
    assert cv2.imread(str(tmp_path / "0.png"))[0, 0].tolist() == [0, 0, 255]  # OpenCV has BGR
    assert read_rgb(tmp_path / "0.png")[0, 0].tolist() == [255, 0, 0]
    assert np.abs(read_rgb(tmp_path / "0.jpg").astype(int) - red).max() < 8


@pytest.mark.parametrize("name", ["0.png", "0.jpg", "0.JPEG"])
def test_the_size_is_read_from_the_header_alone(tmp_path, name):
    write_rgb(tmp_path / name, picture())
    assert read_image_size(tmp_path / name) == IMAGE_SIZE
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:-100])
    assert read_image_size(tmp_path / name) == IMAGE_SIZE


def test_the_size_of_a_jpeg_is_found_behind_a_long_colour_profile(tmp_path):
    write_rgb(tmp_path / "0.jpg", picture())
    content = (tmp_path / "0.jpg").read_bytes()
    profile = b"\xff\xe2" + struct.pack(">H", 65000) + bytes(64998)
    (tmp_path / "0.jpg").write_bytes(content[:2] + 3 * profile + content[2:])
    assert read_image_size(tmp_path / "0.jpg") == IMAGE_SIZE
    assert read_rgb(tmp_path / "0.jpg").shape == (*IMAGE_SIZE, 3)


def test_huffman_tables_before_the_frame_are_not_mistaken_for_it():
    tables = b"\xff\xc4\x00\x0a\x08\x00\x01\x00\x02\x03\x00\x00"
    frame = b"\xff\xc0\x00\x11\x08\x00\x07\x00\x09\x03"
    header = parse_image_header(b"\xff\xd8" + tables + frame, "0.jpg")
    assert (header.size, header.bits_per_channel, header.channels) == ((7, 9), 8, 3)


def test_a_note_on_the_cameras_orientation_is_not_followed(tmp_path):
    write_rgb(tmp_path / "0.jpg", picture())
    upright = read_rgb(tmp_path / "0.jpg")
    # One entry of TIFF's directory: orientation (0x112), one short number, 6: turn to the right.
    entry = b"\x00\x01" + b"\x01\x12\x00\x03\x00\x00\x00\x01\x00\x06\x00\x00" + bytes(4)
    note = b"Exif\x00\x00MM\x00\x2a\x00\x00\x00\x08" + entry
    content = (tmp_path / "0.jpg").read_bytes()
    marker = b"\xff\xe1" + struct.pack(">H", len(note) + 2) + note
    (tmp_path / "0.jpg").write_bytes(content[:2] + marker + content[2:])
    assert cv2.imread(str(tmp_path / "0.jpg")).shape == (*IMAGE_SIZE[::-1], 3)
    assert np.array_equal(read_rgb(tmp_path / "0.jpg"), upright)


def test_grey_pictures_become_three_equal_channels_and_opacity_goes(tmp_path):
    grey = picture()[..., 0]
    cv2.imwrite(str(tmp_path / "grey.png"), grey)
    assert np.array_equal(read_rgb(tmp_path / "grey.png"), np.stack([grey] * 3, axis=-1))
    cv2.imwrite(str(tmp_path / "opaque.png"), np.dstack((picture(), grey)))
    assert np.array_equal(read_rgb(tmp_path / "opaque.png"), picture()[..., ::-1])


def test_a_depth_map_is_no_picture(tmp_path):
    cv2.imwrite(str(tmp_path / "0.png"), (depth_map() * 256).astype(np.uint16))
    with pytest.raises(ValueError, match=r"0\.png: has 16 bits .* probably a depth map"):
        read_rgb(tmp_path / "0.png")
    cv2.imwrite(str(tmp_path / "1.png"), picture().astype(np.uint16) * 257)
    told = r"1\.png: has 16 bits per channel, expected a picture of 8; convert the camera's images"
    with pytest.raises(ValueError, match=told):
        read_rgb(tmp_path / "1.png")


@pytest.mark.parametrize("name", ["0.png", "0.jpg"])
@pytest.mark.parametrize("kept", [0.0, 0.01, 0.5, 0.95])
def test_a_picture_cut_short_is_refused_though_decoders_would_guess_the_rest(tmp_path, name, kept):
    write_rgb(tmp_path / name, picture(size=(200, 200)))
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[: int(kept * len(content))])
    with pytest.raises(ValueError, match=rf"{name}: is (cut short|neither a PNG nor a JPEG)"):
        read_rgb(tmp_path / name)


def test_other_formats_are_refused_by_name(tmp_path):
    cv2.imwrite(str(tmp_path / "0.bmp"), picture())
    with pytest.raises(ValueError, match=r"0\.bmp: is neither a PNG nor a JPEG picture"):
        read_rgb(tmp_path / "0.bmp")


@pytest.mark.parametrize("size", [(2**31 - 1, 2**31 - 1), (1, MAX_PIXELS + 1), (0, 5), (5, 0)])
def test_a_forged_size_is_refused_before_memory_is_taken(tmp_path, size):
    (tmp_path / "0.png").write_bytes(png(*size))
    with pytest.raises(ValueError, match=r"0\.png: declares \d+x\d+ pixels"):
        read_rgb(tmp_path / "0.png")


@pytest.mark.parametrize("size", [(1, 2**14), (2**14, 1), (3, 4)])
def test_a_size_that_the_pixels_do_not_fill_is_damage(tmp_path, size):
    (tmp_path / "0.png").write_bytes(png(*size, data=b"\0" * 7))
    with pytest.raises(ValueError, match=r"0\.png: is damaged: its pixels cannot be decoded"):
        read_rgb(tmp_path / "0.png")


def resized_jpeg(height: int, width: int, *, progressive: bool = False) -> bytes:
    """A JPEG of a few grey pixels that claims another size."""
    parameters = [cv2.IMWRITE_JPEG_PROGRESSIVE, int(progressive)]
    content = cv2.imencode(".jpg", np.full((8, 8, 3), 128, np.uint8), parameters)[1].tobytes()
    at = content.index(b"\xff\xc2" if progressive else b"\xff\xc0") + 5
    return content[:at] + struct.pack(">HH", height, width) + content[at + 4 :]


@pytest.mark.parametrize("read", [read_rgb, read_image_size])
@pytest.mark.parametrize(
    "content",
    [
        resized_jpeg(8192, 8192),
        resized_jpeg(8192, 8192, progressive=True),
        png(8192, 8192),
        png(8192, 8192, bits=1, colour_type=0),
    ],
    ids=["jpeg", "progressive jpeg", "png", "png of one bit"],
)
def test_a_file_too_short_for_the_pixels_that_it_claims_is_no_picture(tmp_path, read, content):
    (tmp_path / "0.png").write_bytes(content)
    with pytest.raises(FileError, match=r"declares 8192x8192 pixels .* more than its \d+ bytes"):
        read(tmp_path / "0.png")


def jpeg_without_data(height: int, width: int, *, shape: tuple[int, ...] = (8, 8)) -> bytes:
    """A JPEG that ends behind the header of its first scan, and claims a size."""
    content = cv2.imencode(".jpg", np.full(shape, 128, np.uint8))[1].tobytes()
    at, scan = content.index(b"\xff\xc0") + 5, content.index(b"\xff\xda")
    content = content[:at] + struct.pack(">HH", height, width) + content[at + 4 :]
    return content[: scan + 2 + struct.unpack_from(">H", content, scan + 2)[0]] + b"\xff\xd9"


@pytest.mark.parametrize("size", [(375, 1242), (1024, 1242), (8192, 8192)])
@pytest.mark.parametrize("shape", [(8, 8), (8, 8, 3)], ids=["grey", "colour"])
@pytest.mark.parametrize("note_bytes", [0, 40_000])
def test_a_jpeg_without_data_is_no_picture_however_long_its_header(
    tmp_path, size, shape, note_bytes
):
    content = jpeg_without_data(*size, shape=shape)
    note = b"\xff\xfe" + struct.pack(">H", note_bytes + 2) + bytes(note_bytes)
    (tmp_path / "0.jpg").write_bytes(content[:2] + note + content[2:])
    said = r"(is cut short: it has 0 bytes of picture data|more than its \d+ bytes can hold)"
    with pytest.raises(FileError, match=rf"0\.jpg: .*{said}"):
        read_rgb(tmp_path / "0.jpg")


def test_bytes_behind_the_scans_header_are_too_few_for_a_bit_a_block(tmp_path):
    content = jpeg_without_data(8192, 8192)
    (tmp_path / "0.jpg").write_bytes(content[:-2] + bytes(131_071) + content[-2:])
    expected = r"has 131071 bytes of picture data .* at least 131072 for 8192x8192 pixels"
    with pytest.raises(FileError, match=expected):
        read_rgb(tmp_path / "0.jpg")


@pytest.mark.parametrize("settings", [[], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]])
@pytest.mark.parametrize("behind", [bytes(5000), b"\xff" * 5000, bytes(range(255)) * 20])
def test_data_behind_the_end_of_a_jpeg_are_no_matter(tmp_path, settings, behind):
    whole = cv2.imencode(".jpg", picture(), settings)[1].tobytes()
    (tmp_path / "whole.jpg").write_bytes(whole)
    (tmp_path / "longer.jpg").write_bytes(whole + behind)  # as phones write a video there
    assert np.array_equal(read_rgb(tmp_path / "longer.jpg"), read_rgb(tmp_path / "whole.jpg"))
    (tmp_path / "cut.jpg").write_bytes(whole[: len(whole) * 2 // 3] + bytes(5000))
    with pytest.raises(FileError, match="is cut short: its JPEG end mark is missing"):
        read_rgb(tmp_path / "cut.jpg")


def test_a_thumbnail_among_a_cameras_notes_is_no_data_of_the_picture(tmp_path):
    thumbnail = cv2.imencode(".jpg", picture(size=(160, 120)))[1].tobytes()
    note = b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
    whole = cv2.imencode(".jpg", picture())[1].tobytes()
    (tmp_path / "0.jpg").write_bytes(whole[:2] + note + whole[2:])
    assert read_rgb(tmp_path / "0.jpg").shape == (*IMAGE_SIZE, 3)
    empty = jpeg_without_data(375, 1242)
    (tmp_path / "0.jpg").write_bytes(empty[:2] + note + empty[2:])
    with pytest.raises(FileError, match="has 0 bytes of picture data"):
        read_rgb(tmp_path / "0.jpg")


each_encoder = pytest.mark.parametrize(
    "encoder",
    [
        [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive, cv2.IMWRITE_JPEG_OPTIMIZE, optimised]
        for progressive, optimised in product((0, 1), (0, 1))
    ],
    ids=["baseline", "optimised", "progressive", "optimised progressive"],
)
SUBSAMPLINGS = (
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR_411,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR_440,
)


@each_encoder
@pytest.mark.parametrize("size", [(1, 1), (9, 17), (375, 1242)])
@pytest.mark.parametrize("channels", [(), (3,)], ids=["grey", "colour"])
def test_the_smallest_jpegs_that_encoders_make_are_still_pictures(
    tmp_path, encoder, size, channels
):
    black = np.zeros((*size, *channels), np.uint8)
    for quality, restart, subsampling in product((1, 50, 100), (0, 1, 7), SUBSAMPLINGS):
        options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_RST_INTERVAL, restart]
        options += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, subsampling]
        cv2.imwrite(str(tmp_path / "0.jpg"), black, encoder + options)
        assert read_rgb(tmp_path / "0.jpg").shape == (*size, 3)


@each_encoder
def test_the_smallest_jpegs_of_the_largest_pictures_are_still_pictures(tmp_path, encoder):
    black = np.zeros((8192, 8192), np.uint8)
    cv2.imwrite(str(tmp_path / "0.jpg"), black, [*encoder, cv2.IMWRITE_JPEG_QUALITY, 1])
    assert read_rgb(tmp_path / "0.jpg").max() <= 1


def test_the_smallest_pngs_that_encoders_make_are_still_pictures(tmp_path):
    black = np.zeros((1024, 1024, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "0.png"), black, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    assert read_rgb(tmp_path / "0.png").max() == 0


@pytest.mark.parametrize("bits", [1, 8])
def test_a_palette_has_one_number_a_pixel_however_well_it_packs(tmp_path, bits):
    black = bytes(400 * (1 + 3000 * bits // 8))  # a row begins with the number of its filter
    (tmp_path / "0.png").write_bytes(png(400, 3000, data=black, bits=bits, colour_type=3))
    assert read_rgb(tmp_path / "0.png").shape == (400, 3000, 3)


@pytest.mark.parametrize("marker", [0x00, 0x02, 0xBF, 0xC3, 0xC9, 0xD9, 0xDA])
def test_a_segment_that_decoders_pass_over_does_not_hide_the_frame_from_the_check(marker):
    frame = b"\xff\xc0\x00\x11\x08%s%s\x03"
    hidden = frame % (struct.pack(">H", 44000), struct.pack(">H", 44000))
    shown = frame % (struct.pack(">H", 8), struct.pack(">H", 8))
    bomb = b"\xff\xd8\xff%c%s" % (marker, struct.pack(">H", 2 + len(hidden))) + hidden + shown
    with pytest.raises(FileError, match="neither a PNG nor a JPEG picture"):
        parse_image_header(bomb, "0.jpg")


def test_scans_that_would_keep_a_decoder_busy_for_minutes_are_refused_undecoded(tmp_path):
    content = resized_jpeg(4096, 8192, progressive=True)
    last = content[content.rindex(b"\xff\xda") : -2]
    bomb = content[:-2] + bytes(2**16) + 2000 * last + content[-2:]
    (tmp_path / "0.jpg").write_bytes(bomb)
    with pytest.raises(FileError, match=r"has 20\d\d scans of 4096x8192 pixels .* up to 32"):
        read_rgb(tmp_path / "0.jpg")


def test_a_header_of_many_empty_segments_is_answered_at_once():
    endless = b"\xff\xd8" + b"\xff\xe0\x00\x02" * 2**20
    with pytest.raises(FileError, match="cut short within its header"):
        parse_image_header(endless, "0.jpg")
    with pytest.raises(FileError, match="cut short within its header"):
        parse_image_header(b"\xff\xd8" + b"\xff\xe0\x00\x00" * 2**20, "0.jpg")


def test_headers_tell_bits_and_channels():
    header = parse_image_header(png(3, 4, bits=16, colour_type=0), "0.png")
    assert (header.size, header.bits_per_channel, header.channels) == ((3, 4), 16, 1)


def test_a_name_without_a_known_end_or_a_picture_without_pixels_is_not_written(tmp_path):
    with pytest.raises(ValueError, match="expected a name that ends in"):
        write_rgb(tmp_path / "0.tiff", picture())
    with pytest.raises(ValueError, match="at least one pixel"):
        write_rgb(tmp_path / "0.png", picture()[:0])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("suffix", "name"), [(".bmp", "BMP"), (".tiff", "TIFF"), (".webp", "WebP"), (".ppm", "PPM")]
)
def test_pictures_of_other_formats_are_named_by_their_first_bytes(tmp_path, suffix, name):
    _, encoded = cv2.imencode(suffix, np.zeros((4, 6, 3), np.uint8))
    (tmp_path / "a.png").write_bytes(encoded.tobytes())
    with pytest.raises(FileError, match=f"neither a PNG nor a JPEG picture: .* {name};"):
        read_rgb(tmp_path / "a.png")


def with_exif(content: bytes, order: str, orientation: int) -> bytes:
    """A JPEG with an EXIF segment of two entries, behind its first segment."""
    table = struct.pack(
        f"{order}HHHIHHHHIHHI", 2, 0x010F, 3, 1, 7, 0, 0x0112, 3, 1, orientation, 0, 0
    )
    tiff = (b"MM" if order == ">" else b"II") + struct.pack(f"{order}HI", 42, 8) + table
    body = b"Exif\0\0" + tiff
    end = 4 + struct.unpack(">H", content[4:6])[0]
    segment = b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body
    return content[:end] + segment + content[end:]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("orientation", range(10))
def test_the_exif_orientation_is_read_and_pixels_are_as_stored(tmp_path, order, orientation):
    path = tmp_path / "0.jpg"
    write_rgb(path, picture())
    assert read_orientation(path) == 1
    stored = read_rgb(path)
    path.write_bytes(with_exif(path.read_bytes(), order, orientation))
    assert read_orientation(path) == (orientation if 1 <= orientation <= 8 else 1)
    assert np.array_equal(read_rgb(path), stored)
    turned = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
    assert np.array_equal(turned, stored) == (read_orientation(path) == 1)


def test_the_exif_orientation_of_a_png_is_read_too(tmp_path):
    path = tmp_path / "0.png"
    tags = Image.Exif()
    tags[0x0112] = 6
    Image.fromarray(picture()).save(path, exif=tags)
    assert read_orientation(path) == 6
    assert np.array_equal(read_rgb(path), picture())
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"eXIf") + 12])
    assert read_orientation(path) in (1, 6)


def test_files_without_an_orientation_or_cut_short_are_upright(tmp_path):
    path = tmp_path / "0.jpg"
    write_rgb(path, picture())
    content = with_exif(path.read_bytes(), "<", 6)
    for length in range(60):
        path.write_bytes(content[:length])
        assert read_orientation(path) in (1, 6)
    write_rgb(tmp_path / "0.png", picture())
    assert read_orientation(tmp_path / "0.png") == 1
