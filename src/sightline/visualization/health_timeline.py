"""Chart of the health of a drive's sensors over its frames."""

import itertools
import re
import textwrap
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from sightline.structures.health import ALARM_SCORE, FrameHealth, Health
from sightline.visualization.canvas import put_lines
from sightline.visualization.cells import MUTED
from sightline.visualization.chart import AXIS_TEXT_PX, BACKGROUND, Plot, put_axes, put_title
from sightline.visualization.colors import RGB
from sightline.visualization.lettering import put_text, text_width
from sightline.visualization.shares import lay_shares, put_share_legend

_WIDTH = 1000
_CHART_HEIGHT = 150
_MARGINS_PX = (52, 20, 28, 26)  # left, right, above, below
_LINE: RGB = (86, 180, 233)
_YAW: RGB = (20, 190, 140)
_ALARM: RGB = (190, 40, 40)
_LIMIT: RGB = (230, 120, 40)
_MAX_YAW_DEG = 4.0
_MAP_HEIGHT = 150
_NUM_TICKS = 6
_MAX_NAME_LETTERS = 12  # of a frame's name below a chart
_DIGITS = "0123456789"
_NOTE_LINE_PX = 18
_NOTE_LETTERS = 130  # per line of notes
_DENSE = 300  # number of frames above which lines are thin and without dots


def draw_health(
    frames: Sequence[FrameHealth], notes: Sequence[str] = ()
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw scores and alarms of camera, LiDAR and alignment, the yaw error, and faulty regions.

    Alarms are red; frames with a score below the orange line are bad. The maps at the bottom show
    the share of the frames in which a part of the image, or of the LiDAR's view ahead, had no data.

    Args:
        frames: Frames in the order of the drive, at least one.
        notes: Lines of text at the bottom: the limits used, warnings.

    Raises:
        ValueError: There is no frame.
    """
    if not frames:
        raise ValueError("a picture of health needs at least one frame")
    healths = [frame.health for frame in frames]
    alarms = [frame.alarms for frame in frames]
    series = (
        ("camera", [each.camera for each in healths], [each.camera for each in alarms]),
        ("LiDAR", [each.lidar for each in healths], [each.lidar for each in alarms]),
        ("alignment", [each.alignment for each in healths], [each.alignment for each in alarms]),
    )
    charts = [_score_chart(frames, *each) for each in series]
    return np.concatenate((*charts, _yaw_chart(frames), _maps(frames), _note_lines(notes)))


def _blank(height: int) -> UInt8[np.ndarray, "height width 3"]:
    return np.full((height, _WIDTH, 3), BACKGROUND, np.uint8)


def _plot() -> Plot:
    left, right, above, below = _MARGINS_PX
    return Plot(left=left, right=_WIDTH - right, top=above, bottom=_CHART_HEIGHT - below)


def _place(number: int, count: int) -> float:
    """Position of a frame's middle on the horizontal axis, as a share of its length."""
    return (number + 0.5) / count


def _ticks(frames: Sequence[FrameHealth]) -> list[tuple[float, str]]:
    count = len(frames)
    chosen = np.unique(np.linspace(0, count - 1, min(_NUM_TICKS, count)).astype(np.int64))
    names = _short_names([frames[int(n)].health.sample_id for n in chosen])
    return [(_place(int(n), count), name) for n, name in zip(chosen, names, strict=True)]


def _short_names(names: Sequence[str]) -> list[str]:
    """Shorten names: without leading zeros, and without common letters at the ends if long.

    Numbers stay whole: the common prefix ends before the digits of a number, the common ending
    begins after them.
    """
    if len(names) > 1 and max(map(len, names)) > _MAX_NAME_LETTERS:
        prefix = _common_prefix(names).rstrip(_DIGITS)
        if prefix not in names:
            names = [name.removeprefix(prefix) for name in names]
        ending = _common_prefix([name[::-1] for name in names])[::-1].lstrip(_DIGITS)
        if ending not in names:
            names = [name.removesuffix(ending) for name in names]
    bare = [re.sub(r"^0+(?=[0-9])", "", name) for name in names]
    return [n if len(n) <= _MAX_NAME_LETTERS else f"..{n[-_MAX_NAME_LETTERS:]}" for n in bare]


def _common_prefix(names: Sequence[str]) -> str:
    letters = itertools.takewhile(lambda each: len(set(each)) == 1, zip(*names, strict=False))
    return "".join(each[0] for each in letters)


def _score_chart(
    frames: Sequence[FrameHealth],
    name: str,
    healths: Sequence[Health | None],
    alarms: Sequence[bool],
) -> UInt8[np.ndarray, "height width 3"]:
    canvas, plot, count = _blank(_CHART_HEIGHT), _plot(), len(frames)
    for number in np.flatnonzero(alarms):
        start, end = (round(plot.column(edge / count)) for edge in (number, number + 1))
        area = canvas[plot.top : plot.bottom, start : max(end, start + 1)]
        area[:] = np.rint(0.45 * np.array(_ALARM) + 0.55 * area)
    put_axes(canvas, plot, columns=_ticks(frames))
    limit = [[[plot.left, plot.row(ALARM_SCORE)], [plot.right, plot.row(ALARM_SCORE)]]]
    put_lines(canvas, np.array(limit, dtype=np.float64), _LIMIT)
    _put_series(canvas, plot, [None if each is None else each.score for each in healths], _LINE)
    put_title(canvas, plot, name)
    return canvas


def _yaw_chart(frames: Sequence[FrameHealth]) -> UInt8[np.ndarray, "height width 3"]:
    canvas, plot = _blank(_CHART_HEIGHT), _plot()
    degrees = np.linspace(-_MAX_YAW_DEG, _MAX_YAW_DEG, 5).tolist()
    marks = [(0.5 + deg / (2 * _MAX_YAW_DEG), f"{deg:+.0f}") for deg in degrees]
    put_axes(canvas, plot, columns=_ticks(frames), rows=marks)
    shares = [
        None
        if frame.health.yaw_deg is None
        else float(np.clip(0.5 + frame.health.yaw_deg / (2 * _MAX_YAW_DEG), 0, 1))
        for frame in frames
    ]
    _put_series(canvas, plot, shares, _YAW)
    put_title(canvas, plot, "yaw of the LiDAR against the camera, degrees")
    return canvas


def _put_series(
    canvas: UInt8[np.ndarray, "height width 3"],
    plot: Plot,
    shares: Sequence[float | None],
    color: RGB,
) -> None:
    """Draw a line over the frames, with a dot for each; frames without a value are left out."""
    count = len(shares)
    is_dense = count > _DENSE
    places = [
        None if share is None else (plot.column(_place(n, count)), plot.row(share))
        for n, share in enumerate(shares)
    ]
    for first, second in itertools.pairwise(places):
        if first is not None and second is not None:
            put_lines(canvas, np.array([[first, second]]), color, width_px=1 if is_dense else 2)
    for place in places:
        if place is not None and not is_dense:
            center = (round(place[0]), round(place[1]))
            cv2.circle(canvas, center, 2, color, -1, cv2.LINE_AA)


def _maps(frames: Sequence[FrameHealth]) -> UInt8[np.ndarray, "height width 3"]:
    canvas = _blank(_MAP_HEIGHT)
    titles = ("image: share of the frames that show nothing", "ahead of the LiDAR: likewise")
    series = (
        [frame.health.camera_regions for frame in frames],
        [frame.health.lidar_regions for frame in frames],
    )
    left, right, above, below = _MARGINS_PX
    width = (_WIDTH - left - right - 20) // 2
    for number, (title, regions) in enumerate(zip(titles, series, strict=True)):
        start = left + number * (width + 20)
        area = canvas[above : _MAP_HEIGHT - below, start : start + width]
        area[:] = lay_shares(np.full_like(area, 255), _mean_regions(regions))
        put_text(canvas, title, start, above - 9, height_px=AXIS_TEXT_PX, color=MUTED)
    put_share_legend(
        canvas, "never", "always", right=_WIDTH - right, top=_MAP_HEIGHT - below + 9, color=MUTED
    )
    text = "left to right as the car sees it"
    text_left = _WIDTH - right - 260 - text_width(text, AXIS_TEXT_PX)
    put_text(canvas, text, text_left, _MAP_HEIGHT - below + 18, height_px=AXIS_TEXT_PX, color=MUTED)
    return canvas


def _note_lines(notes: Sequence[str]) -> UInt8[np.ndarray, "height width 3"]:
    lines = [line for note in notes for line in textwrap.wrap(note, _NOTE_LETTERS)]
    canvas = _blank(len(lines) * _NOTE_LINE_PX + (_NOTE_LINE_PX if lines else 0))
    for number, line in enumerate(lines, start=1):
        baseline = number * _NOTE_LINE_PX
        put_text(canvas, line, _MARGINS_PX[0], baseline, height_px=AXIS_TEXT_PX, color=MUTED)
    return canvas


def _mean_regions(
    regions: Sequence[Bool[np.ndarray, "_ _"]],
) -> Float64[np.ndarray, "mean_rows mean_columns"]:
    """Mean of masks, stretched to the finest of them: an absent sensor has one cell."""
    finest = max(regions, key=lambda each: each.size).shape
    size = (int(finest[1]), int(finest[0]))
    stretched = [
        cv2.resize(each.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) for each in regions
    ]
    return np.asarray(np.mean(stretched, axis=0), dtype=np.float64)
