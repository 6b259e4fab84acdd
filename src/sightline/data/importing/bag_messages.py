"""What ROS messages hold, as files of a recording."""

from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from sightline.data.image_file import decode_pixels
from sightline.data.image_header import parse_image_header
from sightline.data.point_files import columns_of
from sightline.data.problem import FileError

_COLOR: Final[dict[str, tuple[int, int | None]]] = {
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
"""Channels and OpenCV's conversion of each encoding."""

_POINT_TYPES: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""numpy's names of the numbers that sensor_msgs/PointField gives its types."""


def picture_of(message: Any, topic: str) -> UInt8[np.ndarray, "height width 3"]:  # noqa: ANN401
    """The picture of an Image message, as RGB.

    Raises:
        ValueError: Its encoding is none of 8 bits that is known, or it is cut short; names the
            topic.
    """
    if message.encoding not in _COLOR:
        raise ValueError(
            f"topic {topic} holds images of encoding {message.encoding!r}, expected one of "
            f"{', '.join(_COLOR)}; republish it as rgb8, or choose another by --camera-topic"
        )
    channels, conversion = _COLOR[message.encoding]
    height, width, step = int(message.height), int(message.width), int(message.step)
    flat = np.frombuffer(memoryview(message.data), np.uint8)
    if min(height, width) < 1 or step < width * channels or flat.size < height * step:
        raise ValueError(
            f"topic {topic} holds an image of {flat.size} bytes, expected {height} rows of {step} "
            "bytes; it is cut short"
        )
    rows = flat[: height * step].reshape(height, step)[:, : width * channels]
    pixels = np.ascontiguousarray(rows.reshape(height, width, channels))
    try:
        rgb = pixels if conversion is None else cv2.cvtColor(pixels, conversion)
    except cv2.error as error:
        raise ValueError(
            f"topic {topic} holds an image of {height}x{width} (height x width), which encoding "
            f"{message.encoding!r} cannot have; republish it as rgb8"
        ) from error
    return np.ascontiguousarray(rgb, dtype=np.uint8)


def picture_file_of(message: Any, topic: str) -> tuple[str, bytes, tuple[int, int]]:  # noqa: ANN401
    """The file in a CompressedImage message: its suffix, its bytes as they are, height and width.

    Raises:
        ValueError: It is no whole JPEG or PNG of 8 bits; names the topic.
    """
    content = bytes(memoryview(message.data))
    source = f"topic {topic} ({message.format})"
    try:
        header = parse_image_header(content, source)
        decode_pixels(content, header, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION, source)
    except FileError as error:
        raise FileError(
            source, error.problem.problem, "choose another by --camera-topic, or republish as Image"
        ) from error
    if header.bits_per_channel > 8:
        raise ValueError(
            f"topic {topic} holds pictures of {header.bits_per_channel} bits, expected 8: they are "
            "perhaps depth; choose another by --camera-topic"
        )
    return (".jpg" if header.file_format == "jpeg" else ".png"), content, header.size


def cloud_of(message: Any, topic: str) -> Float32[np.ndarray, "num_points 4"]:  # noqa: ANN401
    """x, y, z and intensity (else 0) of a PointCloud2 message, in its frame and units.

    Raises:
        ValueError: It lacks a coordinate, its fields do not fit its points, or it is cut short;
            names the topic.
    """
    layout = _layout_of(message, topic)
    height, width, row_step = int(message.height), int(message.width), int(message.row_step)
    flat = np.frombuffer(memoryview(message.data), np.uint8)
    if row_step < width * message.point_step or flat.size < height * row_step:
        raise ValueError(
            f"topic {topic} holds a cloud of {flat.size} bytes, expected {height} rows of "
            f"{row_step} bytes; it is cut short"
        )
    rows = flat[: height * row_step].reshape(height, row_step)[:, : width * message.point_step]
    return columns_of(np.ascontiguousarray(rows).view(layout).ravel(), f"topic {topic}")


def _layout_of(message: Any, topic: str) -> np.dtype[Any]:  # noqa: ANN401
    """A point's fields; of several of one name, which drivers use for gaps, the first."""
    order = ">" if message.is_bigendian else "<"
    fields: dict[str, Any] = {}
    for field in message.fields:
        if field.datatype in _POINT_TYPES:
            fields.setdefault(field.name, field)
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
