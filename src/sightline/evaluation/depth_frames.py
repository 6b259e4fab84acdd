"""Doubts about depth maps of other frames: one map under several names, maps of a neighbour."""

import hashlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float32

from sightline.data.formats.map_png import read_depth_png
from sightline.data.layouts.kitti_trees import describe_absent
from sightline.evaluation.depth_conventions import log_error
from sightline.evaluation.depth_files import DepthFiles

_LEAST_ERROR: Final = 0.04
"""Mean absolute difference of the logarithms of sound maps; networks and filters have 0.03."""
_MAX_COMPARED: Final = 20
"""Largest number of frames that are compared with their neighbours, spread evenly."""
_MIN_COMPARED: Final = 3
_BETTER: Final = 0.5
"""Largest error against the neighbour's truth, as a share of that against the frame's own."""
_MIN_SHARE: Final = 0.75
"""Smallest share of the compared frames that fit their neighbour so much better."""


class Contents(NamedTuple):
    """Digests of a frame's maps, by which equal ones are found."""

    prediction: bytes
    """Empty for a map of one value, as of a method that guesses none."""
    truth: bytes


def digest_contents(
    prediction_m: Float32[np.ndarray, "height width"], truth_m: Float32[np.ndarray, "height width"]
) -> Contents:
    """Compute the digests of a frame's maps."""
    has_values = bool(np.ptp(prediction_m))
    return Contents(_digest(prediction_m) if has_values else b"", _digest(truth_m))


def _digest(depth_m: Float32[np.ndarray, "height width"]) -> bytes:
    return hashlib.blake2b(depth_m.tobytes(), digest_size=16).digest()


def doubts_about_repeats(frames: dict[str, Contents], predictions: Path) -> Iterator[str]:
    """Doubt predictions that are equal in several frames, where the ground truth is not.

    Args:
        frames: Digests by the frame's name.
        predictions: Prediction file or folder, for the message.
    """
    truths: dict[bytes, set[bytes]] = defaultdict(set)
    for each in frames.values():
        truths[each.prediction].add(each.truth)
    repeated = [
        name
        for name, each in frames.items()
        if each.prediction and len(truths[each.prediction]) > 1
    ]
    if repeated:
        yield (
            f"{predictions}: {len(repeated):,} of {len(frames):,} maps are the same as another "
            f"frame's, though their ground truth differs ({describe_absent(repeated)}): one map "
            "was probably written for several frames; write each frame's own"
        )


def doubts_about_neighbours(
    frames: Sequence[DepthFiles], mean_error: float, predictions: Path, truth: Path
) -> Iterator[str]:
    """Doubt predictions that fit the ground truth of the next frame, or of the one before.

    Reads some frames again, unless the predictions fit their own ground truth well.

    Args:
        frames: Files of all frames, in their order.
        mean_error: Mean absolute difference of the logarithms of predicted and true depth.
        predictions: Prediction file or folder, for the message.
        truth: Ground-truth file or folder.
    """
    if mean_error < _LEAST_ERROR or len(frames) < _MIN_COMPARED:
        return
    step = -(-len(frames) // _MAX_COMPARED)
    for name, offset in (("next frame", 1), ("frame before", -1)):
        places = [at for at in range(0, len(frames), step) if 0 <= at + offset < len(frames)]
        fits = [_fits_better(frames[at], frames[at + offset].truth) for at in places]
        judged = [each for each in fits if each is not None]
        if len(judged) >= _MIN_COMPARED and sum(judged) >= _MIN_SHARE * len(judged):
            yield (
                f"{predictions}: in {sum(judged):,} of {len(judged):,} compared frames the map "
                f"fits the ground truth of the {name} in {truth} much better than its own: maps "
                "were probably written under the names of other frames"
            )
            return


def _fits_better(frame: DepthFiles, other_truth: Path) -> bool | None:
    """Check if a prediction fits another frame's truth; None: not comparable."""
    prediction_m = read_depth_png(frame.prediction)
    errors = []
    for path in (frame.truth, other_truth):
        truth_m = read_depth_png(path)
        if truth_m.shape != prediction_m.shape:
            return None
        is_true = truth_m > 0
        count, error = log_error(prediction_m[is_true], np.log(truth_m[is_true]))
        errors.append(error / count if count else np.inf)
    own, other = errors
    return None if np.isinf(errors).any() else bool(other < _BETTER * own)
