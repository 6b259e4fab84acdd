"""Conversion of ROS messages to the contents of a recording."""

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from sightline.data.checks.frame_checks import is_blank
from sightline.data.formats.image_file import decode_pixels
from sightline.data.formats.image_header import parse_image_header
from sightline.data.formats.point_files import columns_of
from sightline.data.formats.point_rows import USED_NAMES, plain_name, warn_of_repeated
from sightline.files.plain_text import shortened
from sightline.files.problem import FileError
from sightline.geometry.user_warning import warn_user

_ENCODINGS: Final[dict[str, tuple[int, int | None]]] = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "8UC1": (1, cv2.COLOR_GRAY2RGB),
    "8UC3": (3, cv2.COLOR_BGR2RGB),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2RGB),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2),
}
"""Number of channels and OpenCV conversion of each encoding."""

_BAYER: Final = "bayer_"
_POINT_TYPES: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy types by the type numbers of sensor_msgs/PointField."""


def image_from_message(message: Any, topic: str) -> UInt8[np.ndarray, "height width 3"]:  # noqa: ANN401
    """Decode an Image message to RGB.

    Raises:
        ValueError: Its encoding is not a known one of 8 bits, or it is truncated; names the topic.
    """
    topic = shortened(topic)
    color = _ENCODINGS.get(_normalised_encoding(message.encoding))
    if color is None:
        raise ValueError(
            f"topic {topic} holds images of encoding {_quoted(message.encoding)}, expected one of "
            f"{', '.join(_ENCODINGS)}; republish it as rgb8, or choose another by --camera-topic"
        )
    channels, conversion = color
    height, width = int(message.height), int(message.width)
    flat = np.frombuffer(memoryview(message.data), np.uint8)
    if min(height, width) < 1:
        raise ValueError(f"topic {topic} holds an image of {height}x{width} (height x width)")
    rows = _unpadded_rows(
        flat, height, width * channels, int(message.step), f"topic {topic}", "an image"
    )
    pixels = np.ascontiguousarray(rows.reshape(height, width, channels))
    try:
        rgb = pixels if conversion is None else cv2.cvtColor(pixels, conversion)
    except cv2.error as error:
        raise ValueError(
            f"topic {topic} holds an image of {height}x{width} (height x width), which encoding "
            f"{_quoted(message.encoding)} cannot have; republish it as rgb8"
        ) from error
    return np.ascontiguousarray(rgb, dtype=np.uint8)


def image_size_from_message(message: Any) -> tuple[int, int]:  # noqa: ANN401
    """Height and width [px] of an Image or CompressedImage message.

    Raises:
        ValueError: The compressed picture cannot be read.
    """
    if hasattr(message, "format"):
        return parse_image_header(bytes(memoryview(message.data)), "the picture").size
    return int(message.height), int(message.width)


@dataclass(frozen=True, kw_only=True, slots=True)
class PictureFile:
    """Contents of a picture file."""

    suffix: str
    content: bytes
    size: tuple[int, int]
    """Height, width [px]."""
    is_blank: bool
    """Whether the picture has a single colour."""


def image_file_from_message(message: Any, topic: str) -> PictureFile:  # noqa: ANN401
    """Extract the file in a CompressedImage message, with unchanged bytes.

    A Bayer mosaic, which publishers compress as a grey picture, becomes a PNG in colour.

    Raises:
        ValueError: The file is no complete JPEG or PNG of 8 bits; names the topic.
    """
    topic, content = shortened(topic), bytes(memoryview(message.data))
    source = f"topic {topic} ({shortened(str(message.format), 40)})"
    try:
        header = parse_image_header(content, source)
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        pixels = decode_pixels(content, header, flags, source)
    except FileError as error:
        raise FileError(
            source, error.problem.problem, "choose another by --camera-topic, or republish as Image"
        ) from error
    if header.bits_per_channel > 8:
        raise ValueError(
            f"topic {topic} holds pictures of {header.bits_per_channel} bits, expected 8: they are "
            "perhaps depth; choose another by --camera-topic"
        )
    encoding, _, compression = str(message.format).partition(";")
    _, conversion = _ENCODINGS.get(_normalised_encoding(encoding), (0, None))
    if header.channels == 1 and encoding.strip().lower().startswith(_BAYER):
        if conversion is None:
            raise ValueError(
                f"{source} holds the mosaics of an unknown pattern; republish it as Image, or "
                "choose another by --camera-topic"
            )
        rgb = cv2.cvtColor(np.ascontiguousarray(pixels[..., 0]), conversion)
        _, png = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
        return PictureFile(
            suffix=".png", content=png.tobytes(), size=header.size, is_blank=is_blank(pixels)
        )
    if header.channels > 1 and "compressed rgb" in compression.lower():
        warn_user(
            f"{source}: some publishers exchange red and blue in pictures of this format, which "
            "are kept as they are; look at one, and republish them as Image if sky is brown",
        )
    return PictureFile(
        suffix=".jpg" if header.file_format == "jpeg" else ".png",
        content=content,
        size=header.size,
        is_blank=is_blank(pixels),
    )


def cloud_from_message(message: Any, topic: str) -> Float32[np.ndarray, "num_points 4"]:  # noqa: ANN401
    """Read x, y, z and intensity (0 if missing) of a PointCloud2 message, in its frame and units.

    Raises:
        ValueError: It lacks a coordinate, its fields do not fit its points, or it is truncated;
            names the topic.
    """
    topic = shortened(topic)
    layout = _point_layout(message, topic)
    height, width = int(message.height), int(message.width)
    flat = np.frombuffer(memoryview(message.data), np.uint8)
    if height * width == 0 and flat.size:
        raise ValueError(
            f"topic {topic} holds a cloud of {height}x{width} points (height x width), but "
            f"{flat.size} bytes of points"
        )
    row_bytes = width * int(message.point_step)
    row_step = int(message.row_step)
    rows = _unpadded_rows(flat, height, row_bytes, row_step, f"topic {topic}", "a cloud")
    return columns_of(np.ascontiguousarray(rows).view(layout).ravel(), f"topic {topic}")


def num_unread(message: Any) -> int:  # noqa: ANN401
    """Number of points of a cloud, or rows of an image, in a valid message beyond its size.

    Padding after rows is not counted if it is shorter than a point of a cloud.
    """
    is_cloud = hasattr(message, "point_step")
    if is_cloud:
        step, item_bytes = int(message.row_step), int(message.point_step)
    else:
        step, item_bytes = int(message.step), _ENCODINGS[_normalised_encoding(message.encoding)][0]
    row_bytes = int(message.width) * item_bytes
    padded_bytes = max(step, row_bytes)
    if is_cloud and padded_bytes - row_bytes >= item_bytes:
        padded_bytes = row_bytes
    more_bytes = len(message.data) - int(message.height) * padded_bytes
    return max(more_bytes, 0) // (item_bytes if is_cloud else padded_bytes)


def _quoted(value: object) -> str:
    return f"'{shortened(str(value), 40)}'"


def _normalised_encoding(encoding: str) -> str:
    """Name of an encoding as in `_ENCODINGS`: in lower case except for OpenCV's 8UC3."""
    lower = str(encoding).strip().lower()
    return lower.replace("uc", "UC") if lower in ("8uc1", "8uc3") else lower


def _unpadded_rows(
    flat: UInt8[np.ndarray, " size"],
    height: int,
    row_bytes: int,
    step: int,
    source: str,
    content: str,
) -> UInt8[np.ndarray, "height row_bytes"]:
    """Rows of an image or a cloud without padding bytes.

    Some drivers set the length of a row to 0 or keep it from before a filter; it is ignored if the
    number of bytes is exactly that of rows without padding.

    Raises:
        ValueError: There are too few bytes for the rows.
    """
    needed = height * row_bytes
    if step > row_bytes and flat.size != needed:
        last = flat.size - (height - 1) * step  # the last row may lack its padding
        if row_bytes <= last:
            return np.lib.stride_tricks.as_strided(flat, (height, row_bytes), (step, 1))
        row_bytes, needed = step, height * step
    if flat.size < needed:
        raise ValueError(
            f"{source} holds {content} of {flat.size} bytes, expected {height} rows of {row_bytes} "
            "bytes; it is cut short"
        )
    return flat[:needed].reshape(height, row_bytes)


def _point_layout(message: Any, topic: str) -> np.dtype[Any]:  # noqa: ANN401
    """Fields of a point; of fields with equal names, which drivers use for gaps, only the first."""
    order = ">" if message.is_bigendian else "<"
    fields: dict[str, Any] = {}
    warn_of_repeated(field.name for field in message.fields)
    for field in message.fields:
        name = plain_name(field.name)
        if field.datatype in _POINT_TYPES:
            fields.setdefault(field.name, field)
        elif name in USED_NAMES:
            problem = (
                f"topic {topic} holds a cloud whose field {field.name} has the unknown type "
                f"{field.datatype}, expected 1 to {len(_POINT_TYPES)}"
            )
            if name in ("x", "y", "z"):
                raise ValueError(f"{problem}; choose another by --lidar-topic")
            warn_user(f"{problem}: it is left out; publish it as float32")
    formats = [f"{order}{_POINT_TYPES[field.datatype]}" for field in fields.values()]
    counts = [max(int(field.count), 1) for field in fields.values()]
    try:
        return np.dtype(
            {
                "names": list(fields),
                "formats": [
                    kind if count == 1 else (kind, (count,))
                    for kind, count in zip(formats, counts, strict=True)
                ],
                "offsets": [int(field.offset) for field in fields.values()],
                "itemsize": int(message.point_step),
            }
        )
    except ValueError as error:
        raise ValueError(
            f"topic {topic} holds a cloud whose fields do not fit its points of "
            f"{message.point_step} bytes ({error}); choose another by --lidar-topic"
        ) from error
