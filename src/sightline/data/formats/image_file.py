"""Reader and writer of camera pictures in PNG and JPEG."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8, UInt16

from sightline.data.formats.image_header import (
    IMAGE_SUFFIXES,
    MAX_FILE_BYTES,
    ImageHeader,
    check_complete,
    parse_image_header,
)
from sightline.data.formats.quiet_decoder import decode_quietly
from sightline.files.atomic import atomic_write_bytes
from sightline.files.plain_file import read_bytes
from sightline.files.plain_text import shortened
from sightline.files.problem import FileError
from sightline.geometry.wrong_types import named_arguments

_JPEG_QUALITY = 95
_REMEDY = "extract it again"


def read_rgb(path: Path | str) -> UInt8[np.ndarray, "height width 3"]:
    """Read a picture with 8 bits per channel as RGB; grey becomes three equal channels.

    The orientation tag of the file is ignored: a calibration refers to the pixels as stored.

    Raises:
        FileError: The file is no complete PNG or JPEG, or has 16 bits per channel.
    """
    return decode_rgb(read_bytes(path, max_bytes=MAX_FILE_BYTES, remedy=_REMEDY), path)


def decode_rgb(content: bytes, path: Path | str) -> UInt8[np.ndarray, "height width 3"]:
    """Decode the contents of a picture's file; see `read_rgb`.

    Args:
        content: Contents of the file.
        path: Name of the file in errors.

    Raises:
        FileError: As `read_rgb`.
    """
    header = parse_image_header(content, path)
    if header.bits_per_channel > 8:
        raise FileError(
            path,
            f"has {header.bits_per_channel} bits per channel, expected a picture of 8"
            + ("; it is probably a depth map" if header.channels == 1 else ""),
            "convert the camera's images to 8 bits"
            + (", or name their folder" if header.channels == 1 else ""),
        )
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    bgr = decode_pixels(content, header, flags, path)
    return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB, dst=bgr).astype(np.uint8, copy=False)


def read_png16(
    path: Path | str, *, expected: str, remedy: str
) -> UInt16[np.ndarray, "height width"]:
    """Read a map from a PNG of one channel with 16 bits.

    Args:
        path: The file.
        expected: Expected contents, for errors.
        remedy: Remedy, for errors.

    Raises:
        FileError: The file has another format, is truncated or damaged.
    """
    content = read_bytes(path, max_bytes=MAX_FILE_BYTES, remedy=_REMEDY)
    header = parse_image_header(content, path)
    if (header.file_format, header.bits_per_channel, header.channels) != ("png", 16, 1):
        raise FileError(
            path,
            f"is a {header.file_format.upper()} of {header.channels} channels with "
            f"{header.bits_per_channel} bits, expected {expected}",
            remedy,
        )
    flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    return decode_pixels(content, header, flags, path).astype(np.uint16, copy=False)


def decode_pixels(
    content: bytes, header: ImageHeader, flags: int, source: Path | str
) -> UInt8[np.ndarray, "height width 3"] | UInt16[np.ndarray, "height width"]:
    """Decode the pixels of a file: three channels, or one of 16 bits, of the header's size.

    Args:
        content: Contents of the file.
        header: Header of the file.
        flags: OpenCV's `IMREAD_...`.
        source: Name of the file in errors.

    Raises:
        FileError: The file is truncated or damaged.
    """
    check_complete(content, header, source)
    shape = (*header.size, 3) if flags & cv2.IMREAD_COLOR else header.size
    try:
        pixels, damage = decode_quietly(content, flags)
    except cv2.error:  # a side longer than OpenCV supports
        pixels, damage = None, ""
    if pixels is None or pixels.shape != shape:
        raise FileError(source, "is damaged: its pixels cannot be decoded", _REMEDY)
    if damage:
        raise FileError(source, f"is damaged: {shortened(damage)}", _REMEDY)
    return pixels


def _describe_array(picture: object) -> str:
    """Description of an invalid picture, for errors."""
    if not hasattr(picture, "dtype") or not hasattr(picture, "shape"):
        return type(picture).__name__
    return f"{picture.dtype} of shape {tuple(picture.shape)}"


@named_arguments
def write_rgb(path: Path | str, image: UInt8[np.ndarray, "height width 3"]) -> None:
    """Write a picture atomically: `.png` lossless, `.jpg` with quality 95.

    Examples:
        >>> import numpy as np, sightline, tempfile
        >>> from sightline.data.formats.image_file import read_rgb
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     sightline.write_rgb(f"{folder}/grey.png", np.full((4, 6, 3), 128, np.uint8))
        ...     read_rgb(f"{folder}/grey.png").shape
        (4, 6, 3)

    Raises:
        ValueError: The name has another suffix, or the picture has no pixel or another type or
            shape.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in IMAGE_SUFFIXES:
        raise ValueError(
            f"{path} cannot be written: expected a name that ends in {', '.join(IMAGE_SUFFIXES)}"
        )
    is_array = isinstance(image, np.ndarray)
    if not is_array or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        from sightline.structures.arrays import image_remedy

        remedy = "for a sample give image.permute(1, 2, 0).numpy()"
        raise ValueError(
            f"{path} cannot be written: the picture is {_describe_array(image)}, expected a uint8 "
            f"array of height, width, 3; {image_remedy(image) if is_array else remedy}"
        )
    if image.size == 0:
        raise ValueError(f"{path} cannot be written: a picture needs at least one pixel")
    # An explicit compression level takes twice the time of OpenCV's default for the same size.
    parameters = [] if suffix == ".png" else [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    bgr = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2BGR)
    _, encoded = cv2.imencode(suffix, bgr, parameters)
    atomic_write_bytes(path, encoded.tobytes())
