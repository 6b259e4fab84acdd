"""Colours of classes and of measured values, distinguishable for colour-blind people."""

from collections.abc import Sized
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float, UInt8

RGB = tuple[int, int, int]

INVALID: RGB = (17, 19, 24)
"""Colour of pixels without a value."""

CURVE_COLORS: tuple[RGB, ...] = (
    (86, 180, 233),
    (240, 150, 20),
    (20, 190, 140),
    (204, 121, 167),
)
"""Colours of the curves of a chart, in their order."""

_CLASS_COLORS: dict[str, RGB] = {
    "Car": (86, 180, 233),
    "Van": (64, 120, 240),
    "Truck": (204, 121, 167),
    "Tram": (240, 228, 66),
    "Pedestrian": (240, 150, 20),
    "Person_sitting": (226, 94, 20),
    "Cyclist": (20, 190, 140),
    "Misc": (190, 190, 190),
    "DontCare": (130, 130, 130),
}
_UNKNOWN_CLASS: RGB = (235, 235, 235)


def class_color(class_name: str) -> RGB:
    """Colour of a KITTI class; white for any other.

    After the palette of Okabe and Ito 2008 ("Color universal design"), whose blue and greens are
    lightened here because pictures of streets are dark.
    """
    return _CLASS_COLORS.get(class_name, _UNKNOWN_CLASS)


def check_columns(num_boxes: int, **columns: Sized | None) -> None:
    """Refuse columns whose length is not the number of boxes.

    Args:
        num_boxes: Number of boxes.
        columns: Columns by name, such as `class_names`; None: not given.

    Raises:
        ValueError: A length differs.
    """
    for name, column in columns.items():
        if column is not None and len(column) != num_boxes:
            words = name.replace("_", " ")
            raise ValueError(
                f"{num_boxes} boxes cannot be drawn with {len(column)} {words}; give one for each "
                "box"
            )


@dataclass(frozen=True, kw_only=True, slots=True)
class BoxStyle:
    """Style of a 3D box in a picture, beside its colour."""

    is_dashed: bool = False
    """Dashed edges of the box."""
    is_filled: bool = True
    """Filled front of the box in the image, and filled outline from above."""


@dataclass(frozen=True, kw_only=True)
class ColorScale:
    """Mapping of measured values to colours, with the legend's marks."""

    kind: Literal["log", "symmetric_log"]
    """`symmetric_log` has a sign: logarithmic away from zero, linear within `lowest_m` of it."""
    lowest_m: float
    highest_m: float
    """Largest value; values beyond either end have the colour of that end."""
    ticks_m: tuple[float, ...]
    table: UInt8[np.ndarray, "256 3"]
    """RGB of the positions 0 to 1."""

    def positions(self, values_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Positions of values [m] on the scale, 0 to 1."""
        share: Float[np.ndarray, "*shape"]
        if self.kind == "log":
            clipped = np.clip(values_m, self.lowest_m, self.highest_m)
            share = np.log(clipped / self.lowest_m) / np.log(self.highest_m / self.lowest_m)
            return share
        size = np.log1p(np.minimum(np.abs(values_m), self.highest_m) / self.lowest_m)
        share = np.sign(values_m) * size / np.log1p(self.highest_m / self.lowest_m)
        return 0.5 + 0.5 * share

    def colors(self, values_m: Float[np.ndarray, "*shape"]) -> UInt8[np.ndarray, "*shape 3"]:
        """RGB of values [m]."""
        rgb: UInt8[np.ndarray, "*shape 3"]
        rgb = self.table[np.rint(255 * self.positions(values_m)).astype(np.int64)]
        return rgb


def _ramp(color_map: int, first: int, last: int) -> UInt8[np.ndarray, "256 3"]:
    """Part of one of OpenCV's colour maps, in RGB."""
    levels = np.rint(np.linspace(first, last, 256)).astype(np.uint8)
    bgr = cv2.applyColorMap(levels[:, None], color_map)
    return np.ascontiguousarray(bgr[:, 0, ::-1])


def _blue_grey_orange() -> UInt8[np.ndarray, "256 3"]:
    anchors = np.array(
        [[20, 60, 190], [80, 160, 235], [222, 224, 226], [240, 160, 60], [190, 50, 10]]
    )
    positions = np.linspace(0, 1, len(anchors))
    columns = [np.interp(np.linspace(0, 1, 256), positions, channel) for channel in anchors.T]
    table: UInt8[np.ndarray, "256 3"] = np.rint(np.stack(columns, axis=-1)).astype(np.uint8)
    return table


DEPTH_SCALE = ColorScale(
    kind="log",
    lowest_m=2.0,
    highest_m=80.0,
    ticks_m=(2.0, 5.0, 10.0, 20.0, 40.0, 80.0),
    table=_ramp(cv2.COLORMAP_VIRIDIS, 255, 45),
)
"""Depth and range: logarithmic, because errors of depth grow with it; near is yellow, far violet.

Viridis (Smith and van der Walt 2015), with perceptually even steps, without its darkest end, which
would look like a missing value.
"""

UNCERTAINTY_SCALE = ColorScale(
    kind="log",
    lowest_m=0.05,
    highest_m=10.0,
    ticks_m=(0.05, 0.2, 1.0, 3.0, 10.0),
    table=_ramp(cv2.COLORMAP_INFERNO, 75, 255),
)
"""Expected errors of depth: violet if small, pale yellow if large (Inferno, as above)."""

ERROR_SCALE = ColorScale(
    kind="symmetric_log",
    lowest_m=0.1,
    highest_m=10.0,
    ticks_m=(-10.0, -1.0, -0.1, 0.0, 0.1, 1.0, 10.0),
    table=_blue_grey_orange(),
)
"""Predicted minus true depth: blue if too near, orange if too far, grey if correct."""
