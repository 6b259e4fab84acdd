"""Compiled kernel that draws streaks into an image one after the other."""

import numpy as np
from jaxtyping import Float32, Float64

from sightline.ops.compiled import compiled


@compiled
def draw_streaks(
    levels: Float32[np.ndarray, "channels height width"],
    ends_px: Float64[np.ndarray, "num_streaks 4"],
    widths_px: Float64[np.ndarray, " num_streaks"],
    opacities: Float64[np.ndarray, " num_streaks"],
    color: float,
) -> None:
    """Blend streaks over the image, in place.

    A streak covers points up to half its width from the line between its ends; a pixel with its
    centre within half a pixel of the rim has its covered share.
    """
    channels, height, width = levels.shape
    for streak in range(len(opacities)):
        x0, y0, x1, y1 = ends_px[streak]
        reach = widths_px[streak] / 2 + 0.5
        left = max(int(np.ceil(min(x0, x1) - reach)), 0)
        right = min(int(np.floor(max(x0, x1) + reach)), width - 1)
        top = max(int(np.ceil(min(y0, y1) - reach)), 0)
        bottom = min(int(np.floor(max(y0, y1) + reach)), height - 1)
        dx, dy = x1 - x0, y1 - y0
        square = dx * dx + dy * dy
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                along = 0.0
                if square > 0:
                    along = ((column - x0) * dx + (row - y0) * dy) / square
                    along = min(max(along, 0.0), 1.0)
                off_x, off_y = column - x0 - along * dx, row - y0 - along * dy
                covered = min(reach - np.sqrt(off_x * off_x + off_y * off_y), 1.0)
                if covered > 0:
                    weight = opacities[streak] * covered
                    for channel in range(channels):
                        level = levels[channel, row, column]
                        levels[channel, row, column] = level + weight * (color - level)
