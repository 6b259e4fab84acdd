"""Distance of image boxes without returns: a regression on their size and place in the image.

Its columns are the distances by height and by the road, the shape of the box, the borders that cut
it, and their products. `lifting` takes the geometric mean with the distance by geometry.
"""

import json
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.files.plain_file import read_bytes
from sightline.files.problem import FileError
from sightline.files.weights_header import WEIGHTS_FOLDER

RANGES: Final = WEIGHTS_FOLDER / "lifted_ranges.json"
"""Weights of each class, fitted on simulated labels, which the file describes."""
RANGE_COLUMNS: Final = (
    "1", "r", "z", "a", "side", "bottom", "top", "r r", "r z", "r a", "z z", "z a", "a a",
    "bottom r", "side a", "side r", "aside", "r r r",
)  # fmt: skip
"""z: log of the distance [m] of a box of 1 m by its height; r: log of the road's distance over 1.6
times that, within 1.5; a: log of width over height; side, bottom, top: cut by that border; aside:
distance from the image's middle over the focal length."""

BORDER_PX: Final = 1.5
"""Distance from the border within which it cuts a box."""
_USUAL_M: Final = 1.6  # height of an object
_LARGEST: Final = 1.5  # of r
_LEAST_PX: Final = 2.0
_MAX_BYTES: Final = 2**16


def range_columns(
    boxes: Float64[np.ndarray, "num_boxes 4"],
    image_size: tuple[int, int],
    image_from_camera: Float64[np.ndarray, "3 4"],
    road_m: Float64[np.ndarray, " num_boxes"],
) -> Float64[np.ndarray, "num_boxes 18"]:
    """Compute `RANGE_COLUMNS`.

    Args:
        boxes: x_min, y_min, x_max, y_max [px].
        image_size: Height, width [px].
        image_from_camera: Projection of the camera.
        road_m: Depth at which the lower edge stands on the road; NaN: nowhere.
    """
    width, height = np.maximum(boxes[:, 2:] - boxes[:, :2], _LEAST_PX).T
    z = np.log(image_from_camera[0, 0] / height)
    r = np.nan_to_num(np.log(road_m / _USUAL_M) - z, nan=_LARGEST)
    r, a = np.clip(r, -_LARGEST, _LARGEST), np.log(width / height)
    last_row, last_column = image_size[0] - 1 - BORDER_PX, image_size[1] - 1 - BORDER_PX
    side = ((boxes[:, 0] <= BORDER_PX) | (boxes[:, 2] >= last_column)) * 1.0
    bottom, top = (boxes[:, 3] >= last_row) * 1.0, (boxes[:, 1] <= BORDER_PX) * 1.0
    middle = (boxes[:, 0] + boxes[:, 2]) / 2 - image_from_camera[0, 2]
    aside = np.abs(middle) / image_from_camera[0, 0]
    columns = (
        np.ones(len(boxes)), r, z, a, side, bottom, top, r * r, r * z, r * a, z * z, z * a, a * a,
        bottom * r, side * a, side * r, aside, r**3,
    )  # fmt: skip
    return np.stack(columns, axis=1)


def predict_ranges(
    columns: Float64[np.ndarray, "num_boxes 18"], weights: tuple[float, ...]
) -> Float64[np.ndarray, " num_boxes"]:
    """Compute depths of the bottoms' centres [m] from the columns of one class."""
    return np.asarray(np.exp(columns[:, RANGE_COLUMNS.index("z")] + columns @ np.array(weights)))


@cache
def read_ranges(path: Path = RANGES) -> Mapping[str, tuple[float, ...]]:
    """Read the weights of each class, by default the included ones.

    Raises:
        FileError: The file cannot be read, or holds other columns.
    """
    remedy = "fit them again by `python -m benchmarks.fit_ranges`"
    data = read_bytes(path, max_bytes=_MAX_BYTES, remedy=remedy)
    try:
        weights = {
            str(name): tuple(map(float, each)) for name, each in json.loads(data)["ranges"].items()
        }
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        weights = {"": ()}
    for each in weights.values():
        if len(each) != len(RANGE_COLUMNS) or not all(map(math.isfinite, each)):
            raise FileError(path, f"holds no {len(RANGE_COLUMNS)} weights of each class", remedy)
    return weights
