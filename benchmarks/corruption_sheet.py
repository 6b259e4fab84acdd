"""Picture of all kinds of corruption: `python -m benchmarks.corruption_sheet`.

A row is a kind on an embedded frame, from severity 1 to 5, with its levels above: the image, or the
sweep by range over the darkened image; both for kinds that affect both sensors. Like
docs/pictures/corruptions.jpg.
"""

from pathlib import Path

import cv2
import jsonargparse
import numpy as np
from jaxtyping import UInt8

from sightline.augmentation.faults import fault_rng
from sightline.corruptions.corruption import Corrupted
from sightline.corruptions.kinds import KINDS, SEVERITIES, Kind
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.files.atomic import atomic_write_bytes
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.sample import CameraLidarSample, Sensor
from sightline.visualization.colors import RGB
from sightline.visualization.image import draw_points
from sightline.visualization.lettering import put_text, text_width

_WIDTH_PX = 270
_TITLE_PX = 17
_TEXT_PX = (7, 6, 5)  # the largest that a title has room for
_GAP_PX = 3
_POINT_PX = 5.0  # before the picture is made small
_DARKENING = 6
_PAGE: RGB = (255, 255, 255)
_TEXT: RGB = (20, 22, 26)
_JPEG_QUALITY = 55

Picture = UInt8[np.ndarray, "height width 3"]


def main(out: Path = Path("docs/pictures/corruptions.jpg"), frame: int = 0, seed: int = 4) -> None:
    """Corrupt the frame by each kind and severity, and draw the results.

    Args:
        out: Picture to write.
        frame: Index of the embedded frame, 0 or 1.
        seed: Seed of the kinds' random draws.
    """
    sample = KittiObjectDataset(PACKAGED_FRAMES)[frame]
    rows = [
        _row(kind, sensor, sample, seed) for kind in KINDS.values() for sensor in kind.at(1).sensors
    ]
    sheet = np.concatenate(rows)
    _, encoded = cv2.imencode(".jpg", sheet[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    atomic_write_bytes(out, encoded.tobytes())
    print(f"{out}: {sheet.shape[1]}x{sheet.shape[0]}, {encoded.size / 1e6:.2f} MB")


def _row(kind: Kind, sensor: Sensor, sample: CameraLidarSample, seed: int) -> Picture:
    cells = []
    for severity in SEVERITIES:
        found = kind.at(severity).corrupt(sample, fault_rng(sample, seed, kind.name))
        title = np.full((_TITLE_PX, _WIDTH_PX, 3), _PAGE, dtype=np.uint8)
        named = f"{kind.name}-1" if severity == 1 else str(severity)
        caption = f"{named}   {kind.describe(severity)}"
        height_px = next(px for px in _TEXT_PX if text_width(caption, px) < _WIDTH_PX)
        put_text(title, caption, 1, _TITLE_PX - 5, height_px=height_px, color=_TEXT)
        cell = np.concatenate((title, _scaled(_picture(found, sensor))))
        cells.append(cv2.copyMakeBorder(cell, 0, 0, _GAP_PX, 0, cv2.BORDER_CONSTANT, value=_PAGE))
    return np.concatenate(cells, axis=1).astype(np.uint8, copy=False)


def _picture(corrupted: Corrupted, sensor: Sensor) -> Picture:
    sample = corrupted.sample
    assert sample.image is not None, "an embedded frame has an image"
    assert sample.points is not None, "an embedded frame has a sweep"
    image = np.ascontiguousarray(sample.image.numpy().transpose(1, 2, 0))
    if sensor == "camera":
        return image
    return draw_points(
        image // _DARKENING, sample.points, sample.calibration, diameter_px=_POINT_PX
    )


def _scaled(picture: Picture) -> Picture:
    height = round(picture.shape[0] * _WIDTH_PX / picture.shape[1])
    small = cv2.resize(picture, (_WIDTH_PX, height), interpolation=cv2.INTER_AREA)
    return small.astype(np.uint8, copy=False)


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
