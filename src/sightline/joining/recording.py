"""State of the LiDAR in a recording, by edges and, where these tell nothing, by detections."""

from collections.abc import Callable, Iterable, Sequence
from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.joining.alignment import (
    MIN_FRAMES,
    Alignment,
    AlignmentConfig,
    measure_alignment,
    spread_samples,
)
from sightline.joining.alignment_by_boxes import DetectedFrame, confirm_turn
from sightline.joining.lateness import measure_advance
from sightline.joining.scene import make_scene
from sightline.structures.predictions import Detections2D, Detections3D
from sightline.structures.sample import CameraLidarSample

Detect = Callable[[CameraLidarSample], tuple[Detections2D | None, Detections3D | None]]
"""Both detectors; None: one cannot run."""

_CELLS: Final = (32, 96)
"""Rows and columns of the mean levels by which images are compared."""
_SAME_LEVELS: Final = 3.0
_MAX_SAME_SHARE: Final = 0.3
"""Largest share of equal cells in images of two scenes: below 0.1 among KITTI's frames of different
places, 0.3 at half a second's distance in a moving drive, 1 where the vehicle stands."""


def measure_recording(
    samples: Sequence[CameraLidarSample] | SampleDataset, detect: Detect, config: AlignmentConfig
) -> Alignment:
    """Measure rotation and delay of the LiDAR over up to 15 frames, evenly spread.

    Where edges of image and sweep agree, the sweeps are in time, and no detector runs. Where they
    are turned, the boxes of both detectors must confirm it. Frames that show the same scene share
    its errors and count once; of too few scenes nothing is known, and nothing is undone.

    Args:
        samples: Frames of one recording; unreadable ones are left out.
        detect: Detectors for the delay, and to confirm a rotation.
        config: Biases and limits of the rotation.
    """
    chosen = distinct_scenes(spread_samples(samples))
    if len(chosen) < MIN_FRAMES:
        return Alignment()
    alignment = measure_alignment(chosen, config)
    if alignment == Alignment():
        return alignment
    frames = [DetectedFrame(sample, *detect(sample)) for sample in chosen]
    if alignment is not None and alignment.turn:
        confirmed = Alignment(turn=confirm_turn(alignment.turn, frames))
        if confirmed:
            return confirmed
        alignment = None
    advance = measure_advance(make_scene(*frame) for frame in frames)
    if advance is not None and advance.is_late:
        return Alignment(late=True)
    return alignment or Alignment()


def distinct_scenes(samples: Iterable[CameraLidarSample]) -> list[CameraLidarSample]:
    """Keep the samples whose images differ from those kept before; also those without an image."""
    kept: list[CameraLidarSample] = []
    levels: list[Float[Tensor, "rows columns"]] = []
    for sample in samples:
        if sample.image is not None:
            grey = sample.image.float().mean(dim=0, keepdim=True)
            cells = torch.nn.functional.adaptive_avg_pool2d(grey, _CELLS)[0]
            shares = (((cells - other).abs() < _SAME_LEVELS).float().mean() for other in levels)
            if any(share > _MAX_SAME_SHARE for share in shares):
                continue
            levels.append(cells)
        kept.append(sample)
    return kept
