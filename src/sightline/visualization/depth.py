"""Depth maps and their errors as colours."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from sightline.geometry.wrong_types import named_arguments
from sightline.structures.predictions import DepthMap
from sightline.visualization.cells import MUTED
from sightline.visualization.colors import DEPTH_SCALE, ERROR_SCALE, INVALID, RGB, ColorScale
from sightline.visualization.lettering import put_text, text_width

GUESS_SHADE = 0.55
"""Brightness of guessed depths in pictures."""
MISSING: RGB = (112, 48, 100)
"""Colour in an error map of pixels with true depth but no predicted depth."""


@named_arguments
def colorize_depth(
    depth_m: Float[Tensor, "height width"],
    *,
    scale: ColorScale = DEPTH_SCALE,
    point_size_px: int = 1,
) -> UInt8[np.ndarray, "height width 3"]:
    """Colour a depth map [m]; pixels without a depth (0, negative or not finite) are dark.

    Args:
        depth_m: Metres along the optical axis.
        scale: Colours of the depths.
        point_size_px: Size of the squares drawn for single measurements of a sparse map, the
            nearest on top; odd.
    """
    depth = _known(depth_m)
    if point_size_px > 1:
        square = np.ones((point_size_px, point_size_px), np.uint8)
        far = np.where(depth > 0, depth, np.float32(np.inf))
        nearest = cv2.erode(far, square, borderType=cv2.BORDER_REPLICATE)
        depth = np.where(np.isfinite(nearest), nearest, np.float32(0))
    picture = np.full((*depth.shape, 3), INVALID, np.uint8)
    picture[depth > 0] = scale.colors(depth[depth > 0])
    return picture


@named_arguments
def draw_depth(depth: DepthMap) -> UInt8[np.ndarray, "height width 3"]:
    """Colour the trusted values of a completed map; guesses from the image are drawn darker."""
    picture = colorize_depth(depth.shown_m)
    if depth.guessed is not None:
        is_guessed = depth.guessed.numpy(force=True)
        picture[is_guessed] = (picture[is_guessed] * GUESS_SHADE).astype(np.uint8)
    return picture


@named_arguments
def colorize_error(
    predicted_m: Float[Tensor, "height width"],
    truth_m: Float[Tensor, "height width"],
    *,
    scale: ColorScale = ERROR_SCALE,
    point_size_px: int = 1,
) -> UInt8[np.ndarray, "height width 3"]:
    """Colour predicted minus true depth; pixels without truth are dark.

    Pixels with truth but without a predicted value are `MISSING`.

    Args:
        predicted_m: Predicted depth [m]; 0, negative or not finite: no value.
        truth_m: True depth [m]; 0, negative or not finite: no value.
        scale: Colours of the differences.
        point_size_px: Size of the squares drawn for single pixels of a sparse truth, the largest
            error on top; odd.

    Raises:
        ValueError: The maps have different sizes.
    """
    predicted, truth = _known(predicted_m), _known(truth_m)
    if predicted.shape != truth.shape:
        raise ValueError(
            f"predicted_m is of shape {predicted.shape}, truth_m of {truth.shape}; give maps of "
            "one image"
        )
    picture = np.full((*truth.shape, 3), INVALID, np.uint8)
    scored = (truth > 0) & (predicted > 0)
    missing = (truth > 0) & (predicted == 0)
    error = np.where(scored, predicted - truth, np.float32(0))
    if point_size_px > 1:
        square = np.ones((point_size_px, point_size_px), np.uint8)
        lowest, highest = cv2.erode(error, square), cv2.dilate(error, square)
        error = np.where(-lowest > highest, lowest, highest)
        scored = cv2.dilate(scored.astype(np.uint8), square) > 0
        missing = (cv2.dilate(missing.astype(np.uint8), square) > 0) & ~scored
    picture[scored] = scale.colors(error[scored])
    picture[missing] = MISSING
    return picture


@named_arguments
def put_legend(
    canvas: UInt8[np.ndarray, "height width 3"],
    scale: ColorScale,
    *,
    right: int,
    top: int,
    width_px: int = 300,
    hole: str = "",
) -> None:
    """Draw a scale's bar with its marks in metres, its right end at column `right`.

    Args:
        canvas: Canvas to draw on.
        scale: Scale of the bar.
        right: Column of the bar's right end.
        top: Row of the bar's upper side.
        width_px: Width of the bar.
        hole: Caption for pixels without a value, left of the bar; empty: no caption.
    """
    left, height = right - width_px, 8
    if hole:
        _put_hole(canvas, hole, left - 16, top)
    bar = scale.table[np.linspace(0, 255, width_px).astype(np.int64)]
    canvas[top : top + height, left:right] = bar
    sign = "+" if scale.kind == "symmetric_log" else ""
    for tick, position in zip(scale.ticks_m, scale.positions(np.array(scale.ticks_m)), strict=True):
        text = f"{tick:{sign}g}" if tick else "0"
        column = left + round(float(position) * (width_px - 1))
        canvas[top + height : top + height + 3, column] = MUTED
        text_left = min(max(column - text_width(text, 8) // 2, left - 4), right)
        put_text(canvas, text, text_left, top + height + 14, height_px=8, color=MUTED)
    after = text_left + text_width(text, 8) + 4
    put_text(canvas, "m", after, top + height + 14, height_px=8, color=MUTED)


def _put_hole(canvas: UInt8[np.ndarray, "height width 3"], hole: str, right: int, top: int) -> None:
    """Draw the colour of pixels without a value, and its caption, which ends at column `right`."""
    left = right - text_width(hole, 8)
    put_text(canvas, hole, left, top + 9, height_px=8, color=MUTED)
    cv2.rectangle(canvas, (left - 16, top), (left - 6, top + 9), MUTED, 1)
    canvas[top + 1 : top + 9, left - 15 : left - 6] = INVALID


def _known(depth_m: Float[Tensor, "height width"]) -> Float[np.ndarray, "height width"]:
    depth = depth_m.detach().cpu().float().numpy()
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))
