"""State of the LiDAR in a recording, by edges and, where these tell nothing, by detections."""

from collections.abc import Callable, Sequence

from sightline.data.sample_dataset import SampleDataset
from sightline.joining.alignment import (
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


def measure_recording(
    samples: Sequence[CameraLidarSample] | SampleDataset, detect: Detect, config: AlignmentConfig
) -> Alignment:
    """Measure rotation and delay of the LiDAR over up to 15 frames, evenly spread.

    Where edges of image and sweep agree, the sweeps are in time, and no detector runs. Where they
    are turned, the boxes of both detectors must confirm it.

    Args:
        samples: Frames of one recording; unreadable ones are left out.
        detect: Detectors for the delay, and to confirm a rotation.
        config: Biases and limits of the rotation.
    """
    chosen = list(spread_samples(samples))
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
