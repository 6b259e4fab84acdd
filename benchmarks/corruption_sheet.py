"""Draws the cases of suite dgfn7 on an embedded frame: `python -m benchmarks.corruption_sheet`.

Of each case the image, and below it the sweep by range in the image plane, as
docs/pictures/corruptions.jpg; last the other reading of noise. What is partly affected is outlined.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import jsonargparse
import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from sightline.corruptions.corruption import Corrupted, Parameter
from sightline.corruptions.suites import SUITES, Case
from sightline.data.atomic import atomic_write_bytes
from sightline.data.kitti_object import KittiObjectDataset
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.visualization.colors import RGB
from sightline.visualization.image import draw_points
from sightline.visualization.lettering import put_text

_WIDTH_PX = 520
_TITLE_PX = 24
_TEXT_PX = 10
_GAP_PX = 5
_COLUMNS = 2
_POINT_PX = 2.4
_PAGE: RGB = (255, 255, 255)
_TEXT: RGB = (20, 22, 26)
_OUTLINE: RGB = (255, 210, 0)
_JPEG_QUALITY = 68


def main(out: Path = Path("docs/pictures/corruptions.jpg"), frame: int = 0, seed: int = 3) -> None:
    """Corrupts the frame and draws all cases.

    Args:
        out: The picture.
        frame: 0 or 1, of the two that come with the package.
        seed: Of what the cases draw.
    """
    sample = KittiObjectDataset(PACKAGED_FRAMES)[frame]
    (figure_noise,) = SUITES["dgfn7-figure"].select(["camera_noise"])
    other_noise = replace(figure_noise, name="camera_noise of dgfn7-figure")
    cases = (*SUITES["dgfn7"].cases, other_noise)
    cells = [_cell(case, case.corrupt(sample, seed)) for case in cases]
    rows = [
        np.concatenate(cells[start : start + _COLUMNS], axis=1)
        for start in range(0, len(cells), _COLUMNS)
    ]
    sheet = np.concatenate(rows)
    _, encoded = cv2.imencode(".jpg", sheet[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    atomic_write_bytes(out, encoded.tobytes())
    print(out)


def _cell(case: Case, corrupted: Corrupted) -> UInt8[np.ndarray, "height width 3"]:
    sample = corrupted.sample
    assert sample.image is not None, "an embedded frame has an image"
    assert sample.points is not None, "an embedded frame has a sweep"
    image = sample.image.numpy().transpose(1, 2, 0)
    sweep = draw_points(
        np.zeros_like(image), sample.points, sample.calibration, diameter_px=_POINT_PX
    )
    pictures = [
        _scaled(_outlined(picture, mask))
        for picture, mask in ((image, corrupted.camera_mask), (sweep, corrupted.lidar_mask))
    ]
    title = np.full((_TITLE_PX, _WIDTH_PX, 3), _PAGE, dtype=np.uint8)
    said = _title(case, corrupted)
    put_text(title, said, 2, _TITLE_PX - 8, height_px=_TEXT_PX, color=_TEXT)
    gap = np.full((_GAP_PX // 2, _WIDTH_PX, 3), _PAGE, dtype=np.uint8)
    cell = np.concatenate((title, pictures[0], gap, pictures[1]))
    framed = cv2.copyMakeBorder(
        cell, 0, _GAP_PX, _GAP_PX, _GAP_PX, cv2.BORDER_CONSTANT, value=_PAGE
    )
    return framed.astype(np.uint8, copy=False)


def _title(case: Case, corrupted: Corrupted) -> str:
    drawn = ", ".join(
        f"{name} {_rounded(value)}" for name, value in corrupted.record.parameters.items()
    )
    return f"{case.name}    {drawn}"


def _rounded(value: Parameter) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str):
        return " ".join(map(_rounded, value))
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _outlined(
    picture: UInt8[np.ndarray, "height width 3"], mask: Bool[Tensor, "height width"]
) -> UInt8[np.ndarray, "height width 3"]:
    """The picture with the border of what the mask marks, where that is one region of it."""
    regions = cv2.connectedComponents(mask.numpy().astype(np.uint8))[0] - 1
    if regions != 1 or torch.all(mask):
        return picture
    canvas = np.ascontiguousarray(picture.copy())
    contours, _ = cv2.findContours(
        mask.numpy().astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    cv2.drawContours(canvas, contours, -1, _OUTLINE, thickness=3)
    return canvas


def _scaled(
    picture: UInt8[np.ndarray, "height width 3"],
) -> UInt8[np.ndarray, "small_height small_width 3"]:
    height = round(picture.shape[0] * _WIDTH_PX / picture.shape[1])
    small = cv2.resize(picture, (_WIDTH_PX, height), interpolation=cv2.INTER_AREA)
    return small.astype(np.uint8, copy=False)


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
