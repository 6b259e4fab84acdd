"""Cells of a dark page: pictures with titles."""

from typing import Final

import numpy as np
from jaxtyping import UInt8

from sightline.visualization.colors import RGB
from sightline.visualization.lettering import put_text, text_width

PAGE: Final[RGB] = (36, 39, 46)
TITLE: Final[RGB] = (236, 238, 242)
MUTED: Final[RGB] = (150, 156, 166)
TITLE_PX: Final = 24
"""Height of a title's line."""
GAP_PX: Final = 6
"""Gap between cells."""

_TEXT_PX = 10


def titled_cell(
    title: str, muted: str, picture: UInt8[np.ndarray, "height width 3"]
) -> UInt8[np.ndarray, "new_height new_width 3"]:
    """Draw a picture below its title, with the page's gap at its right and bottom.

    Args:
        title: Title, in bright letters.
        muted: Text after the title, in grey letters.
        picture: The picture; not changed.
    """
    height, width = picture.shape[:2]
    page = np.full((TITLE_PX + height + GAP_PX, width + GAP_PX, 3), PAGE, np.uint8)
    page[TITLE_PX : TITLE_PX + height, :width] = picture
    put_text(page, title, 2, TITLE_PX - 7, height_px=_TEXT_PX, color=TITLE)
    left = 2 + text_width(title, _TEXT_PX) + 12
    put_text(page, muted, left, TITLE_PX - 7, height_px=_TEXT_PX, color=MUTED)
    return page
