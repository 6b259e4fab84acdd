"""Writer of videos for browsers."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from jaxtyping import UInt8

from sightline.files.atomic import atomic_path
from sightline.files.problem import install_command
from sightline.geometry.user_warning import warn_user

_QUALITY = "23"  # x264's constant rate factor: 0 is lossless, 51 the worst
_MIN_FPS, _MAX_FPS = 0.01, 240.0


class _Sink(Protocol):
    """Interface that takes the pictures of a video in order."""

    def write(self, picture: UInt8[np.ndarray, "height width 3"]) -> None: ...


def write_video(
    path: Path, pictures: Iterable[UInt8[np.ndarray, "height width 3"]], *, fps: float = 10.0
) -> int:
    """Write an MP4 atomically; return the number of frames.

    The codec is H.264, which browsers play, if PyAV is installed (extra `viz`); else MPEG-4 Part 2,
    which players play and browsers do not, with a warning.

    Args:
        path: The file; its name ends in .mp4.
        pictures: RGB, all of one size of even numbers; drawn one at a time.
        fps: Frames per second.

    Raises:
        ValueError: The name ends otherwise, there is no picture, the sizes differ or are odd, or
            the rate is not in range.
    """
    check_video(path, fps)
    count = 0
    with atomic_path(path) as temporary:
        remaining = iter(pictures)
        first = next(remaining, None)
        if first is None:
            raise ValueError(f"{path} cannot be written: there are no frames; give at least one")
        height, width = first.shape[:2]
        if height % 2 or width % 2:
            raise ValueError(
                f"{path} cannot be written: frames of {width}x{height} px (width x height), "
                "expected even numbers; pad or crop them"
            )
        with _open_sink(temporary, (height, width), fps) as sink:
            for picture in _check_sizes(first, remaining, path):
                sink.write(picture)
                count += 1
    return count


def check_video(path: Path, fps: float) -> None:
    """Refuse an invalid video, before frames are made for it.

    Raises:
        ValueError: The name does not end in .mp4, or the rate is not in range.
    """
    if path.suffix.lower() != ".mp4":
        raise ValueError(f"{path} cannot be written: expected a name that ends in .mp4")
    if not _MIN_FPS <= fps <= _MAX_FPS:
        raise ValueError(
            f"a video of {fps} frames per second cannot be written; give {_MIN_FPS:g} to "
            f"{_MAX_FPS:g}"
        )


def _check_sizes(
    first: UInt8[np.ndarray, "height width 3"],
    others: Iterator[UInt8[np.ndarray, "_height _width 3"]],
    path: Path,
) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    yield first
    for picture in others:
        if picture.shape != first.shape:
            raise ValueError(
                f"{path} cannot be written: a frame of {picture.shape[1]}x{picture.shape[0]} px "
                f"follows one of {first.shape[1]}x{first.shape[0]}; give all frames the same size"
            )
        yield picture


@contextmanager
def _open_sink(path: Path, size: tuple[int, int], fps: float) -> Iterator[_Sink]:
    if find_spec("av") is not None and "libx264" in import_module("av").codecs_available:
        with _h264_sink(path, size, fps) as sink:
            yield sink
        return
    warn_user(
        "the video is MPEG-4 Part 2, which browsers do not play; for H.264: "
        f"{install_command('viz')}",
    )
    writer = cv2.VideoWriter(
        str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"mp4v"), fps, size[::-1]
    )
    if not writer.isOpened():
        raise ValueError(
            f"OpenCV cannot write {path.name}; for PyAV's videos: {install_command('viz')}"
        )
    try:
        yield _OpenCVSink(writer)
    finally:
        writer.release()


class _OpenCVSink:
    def __init__(self, writer: cv2.VideoWriter) -> None:
        self._writer = writer

    def write(self, picture: UInt8[np.ndarray, "height width 3"]) -> None:
        self._writer.write(cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2BGR))


@contextmanager
def _h264_sink(path: Path, size: tuple[int, int], fps: float) -> Iterator[_Sink]:
    import av

    # Index first, so that a browser can start before it has the whole file.
    with av.open(str(path), "w", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1000))
        stream.height, stream.width = size
        stream.pix_fmt = "yuv420p"  # the only format that every browser supports
        stream.options = {"crf": _QUALITY}

        class Sink:
            def write(self, picture: UInt8[np.ndarray, "height width 3"]) -> None:
                frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
                container.mux(stream.encode(frame))

        yield Sink()
        container.mux(stream.encode(None))
