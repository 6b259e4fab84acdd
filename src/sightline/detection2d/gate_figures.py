"""Figures of gates for every case of a suite: Fig. 4 and 5 of Kim et al. 2018."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import UInt8

from sightline.corruptions.suites import Case, Suite
from sightline.data.image_file import write_rgb
from sightline.detection2d.answer_picture import CAMERA_COLOR, LIDAR_COLOR, answer_row
from sightline.detection2d.gate_statistics import CaseGates
from sightline.detection2d.predictor import DetectionPredictor
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.cells import PAGE
from sightline.visualization.shares import ShareSeries, draw_histogram

GATE_MEANS: Final = "gate_means.png"
"""File name of the picture of `write_gate_means`."""
GATE_MAPS: Final = "gate_maps.png"
"""File name of the picture of `write_gate_maps`."""

_CHART_SIZE = (190, 470)  # height, width [px]
_COLUMNS = 2
_GAP_PX = 10


def write_gate_means(path: Path, gates: Sequence[CaseGates], suite: Suite) -> None:
    """Draw a histogram of the frames' mean gates for each case: Fig. 4."""
    titles = {case.name: case.title for case in suite.cases}
    charts = [
        draw_histogram(
            titles[case.case],
            (
                ShareSeries(name="camera gate", values=case.camera_means, color=CAMERA_COLOR),
                ShareSeries(name="LiDAR gate", values=case.lidar_means, color=LIDAR_COLOR),
            ),
            size=_CHART_SIZE,
        )
        for case in gates
    ]
    blanks = [np.full((*_CHART_SIZE, 3), PAGE, np.uint8)] * (-len(charts) % _COLUMNS)
    cells = [_framed(chart) for chart in charts + blanks]
    rows = [
        np.concatenate(cells[start : start + _COLUMNS], axis=1)
        for start in range(0, len(cells), _COLUMNS)
    ]
    write_rgb(path, np.concatenate(rows))


def write_gate_maps(
    path: Path,
    sample: CameraLidarSample,
    predictor: DetectionPredictor,
    suite: Suite,
    seed: int = 0,
) -> None:
    """Draw a frame's detections and gates in each case, one below the other: Fig. 5."""
    write_rgb(path, np.concatenate([_row(case, sample, predictor, seed) for case in suite.cases]))


def _row(
    case: Case, sample: CameraLidarSample, predictor: DetectionPredictor, seed: int
) -> UInt8[np.ndarray, "height width 3"]:
    corrupted = case.corrupt(sample, seed)
    answer = predictor(corrupted.sample)
    masks = (corrupted.camera_mask, corrupted.lidar_mask)
    return answer_row(case.title, corrupted.sample, answer, masks=masks)


def _framed(
    picture: UInt8[np.ndarray, "height width 3"],
) -> UInt8[np.ndarray, "new_height new_width 3"]:
    """Add the page's margin."""
    height, width = picture.shape[:2]
    page = np.full((height + _GAP_PX, width + _GAP_PX, 3), PAGE, np.uint8)
    page[_GAP_PX // 2 :, _GAP_PX // 2 :][:height, :width] = picture
    return page
