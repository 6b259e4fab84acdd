"""Parser of picture headers, before any pixel is decoded."""

import math
import re
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sightline.files.plain_file import check_regular, read_bytes, read_start
from sightline.files.problem import FileError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
"""Suffixes of picture files, the preferred one first."""
MAX_PIXELS = 2**26
"""Largest number of pixels of a picture: a forged header must not cost gigabytes of memory."""

MAX_FILE_BYTES = 2**29
"""Largest size of a file: `MAX_PIXELS` of 16 bits in three channels need less."""

_MAX_HEADER_BYTES = 2**20  # a JPEG may carry a colour profile in parts of 64 kB before its size
_MAX_PARTS = 2**17  # chunks of a PNG; segments of a JPEG
# Decoding takes time for each pixel of each scan; cameras write one, progressive encoders ten.
_MAX_SCANNED_PIXELS = 16 * MAX_PIXELS
# Largest expansion of a byte: deflate's matches of 258 bytes take two bits each; in a JPEG each
# block of 8x8 pixels takes at least one bit, of its mean's Huffman code.
_PNG_BYTES_PER_BYTE = 1032
_JPEG_BLOCK_PX = 8
_JPEG_BLOCKS_PER_BYTE = 8
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_PALETTE = 3  # colour type of a palette of RGB
_PNG_CHANNELS = {0: 1, 2: 3, _PNG_PALETTE: 3, 4: 2, 6: 4}  # by colour type
_JPEG_START, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
_JPEG_SCAN = b"\xff\xda"
# Within a scan's data FF 00 is a data byte, and FF D0 to D7 are restart markers.
_JPEG_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
# Start-of-frame markers, which contain the size, of the kinds that cameras write: Huffman-coded,
# baseline, extended and progressive. Others (lossless, arithmetic) are refused.
_JPEG_FRAMES = frozenset({0xC0, 0xC1, 0xC2})
# Segments allowed before the frame: tables, restart interval, application data and comments.
# Decoders differ in how they skip anything else, and might find another size.
_JPEG_TABLES = frozenset({0xC4, 0xDB, 0xDD, *range(0xE0, 0xF0), 0xFE})
_EXIF_MARKER, _EXIF_START = 0xE1, b"Exif\0\0"
_ORIENTATION_TAG = 0x0112
_OTHER_FORMATS = (
    (b"BM", "BMP"),
    (b"II*\0", "TIFF"),
    (b"MM\0*", "TIFF"),
    (b"GIF8", "GIF"),
    (b"RIFF", "WebP"),
    (b"P5", "PGM"),
    (b"P6", "PPM"),
    (b"<", "a web page"),
)
_REMEDY = "extract or convert the file again"


@dataclass(frozen=True, kw_only=True, slots=True)
class ImageHeader:
    """Picture properties in a file's header."""

    file_format: Literal["png", "jpeg"]
    size: tuple[int, int]
    """Height, width [px]."""
    bits_per_channel: int
    channels: int
    """1 grey, 2 grey and alpha, 3 colour (or a palette of colours), 4 colour and alpha."""
    bits_per_pixel: int
    """Bits per pixel in the file; with a palette, those of the colour index."""


def read_image_header(path: Path | str) -> ImageHeader:
    """Properties of a PNG or JPEG file; its pixels stay unread.

    Raises:
        FileError: The file is neither PNG nor JPEG, has a truncated header, or is too short for its
            number of pixels.
    """
    file_bytes = check_regular(path, max_bytes=MAX_FILE_BYTES, remedy=_REMEDY)
    start = read_start(path, _MAX_HEADER_BYTES, max_bytes=MAX_FILE_BYTES, remedy=_REMEDY)
    return parse_image_header(start, path, file_bytes=file_bytes)


def read_complete_header(path: Path | str) -> ImageHeader:
    """Properties of a PNG or JPEG file that is complete; its pixels are not decoded.

    Raises:
        FileError: As `read_image_header` and `check_complete`.
    """
    content = read_bytes(path, max_bytes=MAX_FILE_BYTES, remedy=_REMEDY)
    header = parse_image_header(content, path)
    check_complete(content, header, path)
    return header


def read_image_size(path: Path | str) -> tuple[int, int]:
    """Height and width [px] of a PNG or JPEG file; errors as in `read_image_header`."""
    return read_image_header(path).size


def read_orientation(path: Path | str) -> int:
    """EXIF orientation of a picture file: 2 to 8 where viewers turn or mirror it, else 1.

    Readers use pixels as stored; OpenCV's own functions and viewers follow the tag.

    Raises:
        FileError: The file cannot be read, or is no regular file.
    """
    start = read_start(path, _MAX_HEADER_BYTES, max_bytes=MAX_FILE_BYTES, remedy=_REMEDY)
    try:
        if start.startswith(_PNG_SIGNATURE):
            return _orientation(_png_exif(start))
        return _orientation(_jpeg_exif(start)) if start.startswith(_JPEG_START) else 1
    except (struct.error, IndexError):
        return 1  # damage is reported where pixels are read


def _orientation(tiff: bytes) -> int:
    """Orientation in EXIF data, 1 to 8; 1 if there is none.

    They are a TIFF file: byte order, place of a table, and entries of tag, type and value.
    """
    if not tiff:
        return 1
    order = ">" if tiff.startswith(b"MM") else "<"
    (table,) = struct.unpack_from(f"{order}I", tiff, 4)
    (num_entries,) = struct.unpack_from(f"{order}H", tiff, table)
    for entry in range(table + 2, table + 2 + 12 * num_entries, 12):
        tag, _, _, value = struct.unpack_from(f"{order}HHIH", tiff, entry)
        if tag == _ORIENTATION_TAG:
            return value if 1 <= value <= 8 else 1
    return 1


def _png_exif(content: bytes) -> bytes:
    """EXIF data of a PNG ahead of its pixels; empty if there are none."""
    position = len(_PNG_SIGNATURE)
    while position + 12 <= len(content):
        length, kind = struct.unpack_from(">I4s", content, position)
        if kind in (b"eXIf", b"IDAT"):
            return content[position + 8 : position + 8 + length] if kind == b"eXIf" else b""
        position += 12 + length
    return b""


def _jpeg_exif(content: bytes) -> bytes:
    """EXIF data in the first such segment of a JPEG; empty if there are none."""
    position = len(_JPEG_START)
    while content[position] == 0xFF and content[position + 1] in _JPEG_TABLES:
        (length,) = struct.unpack_from(">H", content, position + 2)
        body = content[position + 4 : position + 2 + length]
        if content[position + 1] == _EXIF_MARKER and body.startswith(_EXIF_START):
            return body[len(_EXIF_START) :]
        position += 2 + max(length, 2)
    return b""


def parse_image_header(
    content: bytes, source: Path | str, *, file_bytes: int | None = None
) -> ImageHeader:
    """Read the header at the front of `content`.

    Args:
        content: The file, or its beginning.
        source: Name of the file in errors.
        file_bytes: Length of the whole file, if `content` is only its beginning.

    Raises:
        FileError: `content` is no PNG or JPEG, is truncated, or has a size of zero, of more than
            `MAX_PIXELS` or of more pixels than fit in a file of its length.
    """
    try:
        header = _parse(content)
    except (struct.error, IndexError) as error:
        raise FileError(source, "is cut short within its header", _REMEDY) from error
    if header is None:
        other = next((name for begin, name in _OTHER_FORMATS if content.startswith(begin)), None)
        cause = "" if other is None else f": its first bytes are those of {other}"
        cause = cause if content else ": it is empty"
        raise FileError(source, f"is neither a PNG nor a JPEG picture{cause}", _REMEDY)
    height, width = header.size
    declared = f"declares {height}x{width} pixels (height x width)"
    if not 0 < height * width <= MAX_PIXELS:
        raise FileError(source, f"{declared}, expected 1 to {MAX_PIXELS} of them", _REMEDY)
    file_bytes = len(content) if file_bytes is None else file_bytes
    if file_bytes < _min_bytes(header):
        raise FileError(
            source,
            f"{declared}, more than its {file_bytes} bytes can hold: it is cut short",
            _REMEDY,
        )
    return header


def _min_bytes(header: ImageHeader) -> int:
    """Smallest length of a complete file of this picture; in a JPEG, of its scans' data."""
    height, width = header.size
    if header.file_format == "jpeg":
        blocks = math.ceil(height / _JPEG_BLOCK_PX) * math.ceil(width / _JPEG_BLOCK_PX)
        return math.ceil(blocks / _JPEG_BLOCKS_PER_BYTE)
    return height * (width * header.bits_per_pixel // 8) // _PNG_BYTES_PER_BYTE


def check_complete(content: bytes, header: ImageHeader, source: Path | str) -> None:
    """Refuse a truncated PNG or JPEG file, or an altered PNG.

    Decoders handle such files differently: some invent the missing rows. Files that would take a
    decoder minutes are refused, too.

    Raises:
        FileError: The file is truncated, a checksum is wrong, or a JPEG has far too many scans or
            too little data in them.
    """
    if header.file_format == "png":
        _check_png_chunks(content, source)
        return
    scan_bytes, end = _scanned_bytes(content)
    # Thumbnails in segments before the picture are counted, too, which adds a few.
    num_scans = content.count(_JPEG_SCAN, 0, end)
    height, width = header.size
    if num_scans * height * width > _MAX_SCANNED_PIXELS:
        raise FileError(
            source,
            f"has {num_scans} scans of {height}x{width} pixels (height x width), expected up to "
            f"{_MAX_SCANNED_PIXELS // (height * width)}",
            _REMEDY,
        )
    # Some cameras write data after the end, phones a video; damaged scans may hide the end.
    if end is None and _JPEG_END not in content[-1024:]:
        raise FileError(source, "is cut short: its JPEG end mark is missing", _REMEDY)
    min_bytes = _min_bytes(header)
    if scan_bytes < min_bytes:
        raise FileError(
            source,
            f"is cut short: it has {scan_bytes} bytes of picture data behind its header, expected "
            f"at least {min_bytes} for {height}x{width} pixels (height x width)",
            _REMEDY,
        )


def _scanned_bytes(content: bytes) -> tuple[int, int | None]:
    """Length of a JPEG's scan data without headers, and place of its end mark; None: it lacks.

    Thumbnails in segments are skipped.
    """
    num_bytes, position = 0, len(_JPEG_START)
    for _ in range(_MAX_PARTS):
        marker = _JPEG_MARKER.search(content, position)
        if marker is None:
            break
        if marker[0] == _JPEG_END:
            return num_bytes, marker.start()
        length = int.from_bytes(content[marker.end() : marker.end() + 2], "big")
        position = marker.end() + max(length, 2)
        if marker[0] == _JPEG_SCAN:
            following = _JPEG_MARKER.search(content, position)
            end = len(content) if following is None else following.start()
            num_bytes, position = num_bytes + end - position, end
    return num_bytes, None


def _check_png_chunks(content: bytes, source: Path | str) -> None:
    view, position = memoryview(content), len(_PNG_SIGNATURE)
    for _ in range(_MAX_PARTS):
        if position + 12 > len(content):
            break
        (length,) = struct.unpack_from(">I", content, position)
        kind, end = content[position + 4 : position + 8], position + 12 + length
        if end > len(content):
            break
        (stored_checksum,) = struct.unpack_from(">I", content, end - 4)
        if zlib.crc32(view[position + 4 : end - 4]) != stored_checksum:
            raise FileError(source, "is damaged: a PNG checksum is wrong", _REMEDY)
        if kind == b"IEND":
            return
        position = end
    raise FileError(source, "is cut short: its PNG end mark is missing", _REMEDY)


def _parse(content: bytes) -> ImageHeader | None:
    if content.startswith(_PNG_SIGNATURE):
        kind, width, height, bits, colour_type = struct.unpack_from(">4sIIBB", content, 12)
        if kind != b"IHDR" or colour_type not in _PNG_CHANNELS:
            return None
        channels = _PNG_CHANNELS[colour_type]
        return ImageHeader(
            file_format="png",
            size=(height, width),
            bits_per_channel=bits,
            channels=channels,
            bits_per_pixel=bits if colour_type == _PNG_PALETTE else bits * channels,
        )
    return _parse_jpeg(content) if content.startswith(_JPEG_START) else None


def _parse_jpeg(content: bytes) -> ImageHeader | None:
    position = len(_JPEG_START)
    content = content[:_MAX_HEADER_BYTES]
    while content[position] == 0xFF:
        marker = content[position + 1]
        if marker == 0xFF:  # padding
            position += 1
            continue
        if marker in _JPEG_FRAMES:
            bits, height, width, channels = struct.unpack_from(">BHHB", content, position + 4)
            return ImageHeader(
                file_format="jpeg",
                size=(height, width),
                bits_per_channel=bits,
                channels=channels,
                bits_per_pixel=bits * channels,
            )
        if marker not in _JPEG_TABLES:
            return None
        (length,) = struct.unpack_from(">H", content, position + 2)
        position += 2 + max(length, 2)  # the length includes its own bytes
    return None
