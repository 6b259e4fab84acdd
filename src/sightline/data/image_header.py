"""What a picture's file says about itself before a pixel is decoded."""

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

MAX_PIXELS = 2**26
"""Larger pictures are refused unread: a forged header must not cost gigabytes of memory."""

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}  # by colour type; 3 is a palette of RGB
_JPEG_START, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
# Start-of-frame markers, which hold the size: C4, C8 and CC of the range are something else.
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_WITHOUT_LENGTH = frozenset({0x01, *range(0xD0, 0xD8)})
_REMEDY = "extract or convert the file again"


@dataclass(frozen=True, kw_only=True, slots=True)
class ImageHeader:
    """The picture that a file announces."""

    file_format: Literal["png", "jpeg"]
    size: tuple[int, int]
    """Height, width [px]."""
    bits_per_channel: int
    channels: int
    """1 grey, 2 grey and opacity, 3 colour (or a palette of colours), 4 colour and opacity."""


def read_image_size(path: Path | str) -> tuple[int, int]:
    """Height and width [px] of a PNG or JPEG file, from its header: the pixels stay unread.

    Raises:
        ValueError: The file is neither PNG nor JPEG, or is cut short within the header.
    """
    with Path(path).open("rb") as file:
        # A JPEG may carry a thumbnail or a colour profile of up to 64 kB each before its size.
        return parse_image_header(file.read(2**19), path).size


def parse_image_header(content: bytes, source: Path | str) -> ImageHeader:
    """Reads the header at the front of `content`.

    Args:
        content: The file, or its beginning.
        source: What errors call it.

    Raises:
        ValueError: `content` is no PNG or JPEG, breaks off, or announces a size of zero or of more
            than `MAX_PIXELS`.
    """
    try:
        header = _parse(content)
    except (struct.error, IndexError) as error:
        raise ValueError(f"{source} is cut short within its header; {_REMEDY}") from error
    if header is None:
        raise ValueError(f"{source} is neither a PNG nor a JPEG picture; {_REMEDY}")
    height, width = header.size
    if not 0 < height * width <= MAX_PIXELS:
        raise ValueError(
            f"{source} announces {height}x{width} pixels (height x width), expected 1 to "
            f"{MAX_PIXELS} of them; {_REMEDY}"
        )
    return header


def check_complete(content: bytes, header: ImageHeader, source: Path | str) -> None:
    """Refuses a PNG or JPEG file that is cut short or, in the case of PNG, was altered.

    Decoders differ in what they make of such files: some invent the missing rows.

    Raises:
        ValueError: The file breaks off, or a checksum is wrong.
    """
    if header.file_format == "jpeg":
        if _JPEG_END not in content[-1024:]:  # some cameras write their own notes after the end
            raise ValueError(f"{source} is cut short: its JPEG end mark is missing; {_REMEDY}")
        return
    view, position = memoryview(content), len(_PNG_SIGNATURE)
    while position + 12 <= len(content):
        (length,) = struct.unpack_from(">I", content, position)
        kind, end = content[position + 4 : position + 8], position + 12 + length
        if end > len(content):
            break
        (stated,) = struct.unpack_from(">I", content, end - 4)
        if zlib.crc32(view[position + 4 : end - 4]) != stated:
            raise ValueError(f"{source} is damaged: a PNG checksum is wrong; {_REMEDY}")
        if kind == b"IEND":
            return
        position = end
    raise ValueError(f"{source} is cut short: its PNG end mark is missing; {_REMEDY}")


def _parse(content: bytes) -> ImageHeader | None:
    if content.startswith(_PNG_SIGNATURE):
        kind, width, height, bits, colour_type = struct.unpack_from(">4sIIBB", content, 12)
        if kind != b"IHDR" or colour_type not in _PNG_CHANNELS:
            return None
        return ImageHeader(
            file_format="png",
            size=(height, width),
            bits_per_channel=bits,
            channels=_PNG_CHANNELS[colour_type],
        )
    return _parse_jpeg(content) if content.startswith(_JPEG_START) else None


def _parse_jpeg(content: bytes) -> ImageHeader | None:
    position = len(_JPEG_START)
    while content[position] == 0xFF:
        marker = content[position + 1]
        if marker == 0xFF or marker in _JPEG_WITHOUT_LENGTH:
            position += 1 if marker == 0xFF else 2
            continue
        if marker in _JPEG_FRAMES:
            bits, height, width, channels = struct.unpack_from(">BHHB", content, position + 4)
            return ImageHeader(
                file_format="jpeg", size=(height, width), bits_per_channel=bits, channels=channels
            )
        (length,) = struct.unpack_from(">H", content, position + 2)
        position += 2 + length
    return None
