"""nuScenes' scores of 3D detections: AP by the distance of centres, and errors of found objects.

Caesar et al. 2020, section 4.1 ("nuScenes: A Multimodal Dataset for Autonomous Driving"), as in the
official program: nuscenes-devkit, `eval/detection/algo.py`. All detections of a class are taken in
the order of their scores. Each takes the nearest truth of its frame that is not taken yet, if the
centres are closer on the ground (KITTI's x and z) than 0.5, 1, 2 or 4 m. Of equal scores the later
one, by frame and line, comes first.

KITTI's rules say who counts, as in its 3D scores:

* A truth beyond the difficulty, or of a neighbouring class (Van, Person_sitting), may be found and
  is never missed. A detection that takes one is left out: neither true nor false.
* A detection that is too small in the image for the difficulty takes no part.
* A detection without a match is left out if a DontCare region covers its 3D box. KITTI's own
  regions have no 3D box, so there it is false.
* An object without a 3D part is missed, or false.
"""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from sightline.evaluation.bootstrap import PERCENTILES, draw_frames
from sightline.evaluation.centre_pairs import CENTRE_DISTANCES_M
from sightline.evaluation.centre_scores import ERROR_DISTANCE_M, CentreScores
from sightline.evaluation.kitti_object_matching import PairIndex
from sightline.evaluation.kitti_object_pairs import MatchingData
from sightline.evaluation.kitti_object_rules import METRICS
from sightline.ops.compiled import compiled

_ERROR_INDEX: Final = CENTRE_DISTANCES_M.index(ERROR_DISTANCE_M)
_SPACE: Final = METRICS.index("3d")
_RECALLS: Final = np.linspace(0, 1, 101)  # of nuScenes; their rounding decides what is reached
_FIRST: Final = 11  # first recall position above the minimum recall of 0.1
_MIN_PRECISION: Final = 0.1


class CentreTask(NamedTuple):
    """Matching input of all frames for one class and difficulty, highest score first."""

    score: Float64[np.ndarray, " num_detections"]
    frame: Int64[np.ndarray, " num_detections"]
    forgiven: Bool[np.ndarray, " num_detections"]
    """Whether the detection is left out if it takes no truth."""
    pair_offsets: Int64[np.ndarray, "num_detections 2"]
    """Start and end of the pairs of each detection."""
    pair_truth: Int64[np.ndarray, " num_pairs"]
    pair_errors: Float64[np.ndarray, "num_pairs 3"]
    truth_valid: Bool[np.ndarray, " num_truths"]
    """Whether the truth counts; otherwise it may be found, but is never missed."""
    valid_per_frame: Int64[np.ndarray, " num_frames"]


class CentreCurve(NamedTuple):
    """Detections that count for one distance, highest score first."""

    score: Float64[np.ndarray, " num_detections"]
    frame: Int64[np.ndarray, " num_detections"]
    is_true: Bool[np.ndarray, " num_detections"]
    errors: Float64[np.ndarray, "num_found 3"]
    """Errors of the true ones: translation [m], scale, orientation [rad]."""
    valid_per_frame: Int64[np.ndarray, " num_frames"]

    def ap(self, weights: Int64[np.ndarray, " num_frames"] | None = None) -> float:
        """Compute AP in percent, of frames that count as often as their weight says.

        Args:
            weights: Number of times that each frame counts; None: once.
        """
        is_true, n_gt = self.is_true, self.valid_per_frame.sum()
        if weights is not None:
            is_true = np.repeat(is_true, weights[self.frame])
            n_gt = weights @ self.valid_per_frame
        if not is_true.any():
            return 0.0
        tp = np.cumsum(is_true)
        precision = np.interp(_RECALLS, tp / n_gt, tp / np.arange(1, len(tp) + 1), right=0)
        above = np.maximum(precision[_FIRST:] - _MIN_PRECISION, 0)
        return 100 * float(above.mean()) / (1 - _MIN_PRECISION)

    def mean_errors(self) -> list[float] | None:
        """Compute the mean errors of `CentreScores`; None if no recall above 0.1 is reached."""
        if not len(self.errors):
            return None
        recall = np.cumsum(self.is_true) / self.valid_per_frame.sum()
        reached = _RECALLS[_FIRST:][_RECALLS[_FIRST:] <= recall[-1]]
        if not len(reached):
            return None
        scores = np.interp(reached, recall, self.score)
        counts = np.arange(1, len(self.errors) + 1)[:, None]
        so_far = (np.cumsum(self.errors, axis=0) / counts)[::-1]
        found_at = self.score[self.is_true][::-1]
        return [float(np.interp(scores, found_at, column).mean()) for column in so_far.T]


def select_centres(
    data: MatchingData, index: PairIndex, *, code: int, difficulty: int
) -> CentreTask:
    """Select the matching input of a class and difficulty (their indices)."""
    normal = np.flatnonzero((data.detection_class == code) & (data.detection_level <= difficulty))
    ranked = normal[np.argsort(data.detection_score[normal], kind="stable")[::-1]]
    truth_offsets = np.cumsum(data.truths_per_frame, dtype=np.int64) - data.truths_per_frame
    frame_of_pair = np.repeat(index.detection_frame, data.centres_per_detection)
    ends = np.cumsum(data.centres_per_detection, dtype=np.int64)
    valid = (data.truth_class == code) & (data.truth_level <= difficulty)
    return CentreTask(
        score=data.detection_score[ranked],
        frame=index.detection_frame[ranked],
        forgiven=data.detection_forgiven[ranked, _SPACE],
        pair_offsets=np.stack((ends - data.centres_per_detection, ends), axis=1)[ranked],
        pair_truth=data.centre_truth + truth_offsets[frame_of_pair],
        pair_errors=data.centre_errors,
        truth_valid=valid,
        valid_per_frame=np.bincount(index.truth_frame[valid], minlength=data.num_frames),
    )


def match_centres(task: CentreTask, distance_m: float) -> CentreCurve:
    """Match detections with truths whose centres are closer than a distance."""
    pairs = _match(task, distance_m)
    matched = pairs >= 0
    is_true = np.zeros(len(pairs), dtype=np.bool_)
    is_true[matched] = task.truth_valid[task.pair_truth[pairs[matched]]]
    counts = is_true | ~(matched | task.forgiven)
    return CentreCurve(
        score=task.score[counts],
        frame=task.frame[counts],
        is_true=is_true[counts],
        errors=task.pair_errors[pairs[is_true]],
        valid_per_frame=task.valid_per_frame,
    )


class CentreCurves(NamedTuple):
    """Curves for each of `CENTRE_DISTANCES_M`."""

    curves: tuple[CentreCurve, ...]

    @classmethod
    def of(cls, task: CentreTask) -> "CentreCurves":
        """Match a class and difficulty at all distances."""
        return cls(tuple(match_centres(task, distance) for distance in CENTRE_DISTANCES_M))

    def ap_at(self, weights: Int64[np.ndarray, " num_frames"] | None = None) -> tuple[float, ...]:
        """Compute AP in percent for each distance; weights as for `CentreCurve.ap`."""
        return tuple(curve.ap(weights) for curve in self.curves)

    def ap_and_2m(self, weights: Int64[np.ndarray, " num_frames"]) -> list[float]:
        """Compute the mean AP and the one for 2 m; weights as for `CentreCurve.ap`."""
        ap_at = self.ap_at(weights)
        return [_mean(ap_at), ap_at[_ERROR_INDEX]]


def score_centres(task: CentreTask, *, bootstrap: int = 0, seed: int = 0) -> CentreScores | None:
    """Compute all scores; None if no object counts.

    Args:
        task: All frames of one class and difficulty.
        bootstrap: Resamples of the frames for the interval of the mean AP; 0: without.
        seed: Seed of the resamples.
    """
    if not task.truth_valid.any():
        return None
    matched = CentreCurves.of(task)
    ap_at = matched.ap_at()
    errors = matched.curves[_ERROR_INDEX].mean_errors()
    translation, scale, orientation = errors or (None, None, None)
    drawn = draw_frames(task.valid_per_frame, bootstrap, seed)
    resampled = [_mean(matched.ap_at(weights)) for weights in drawn]
    low, high = np.percentile(resampled, PERCENTILES).tolist() if resampled else (None, None)
    return CentreScores(
        ap=_mean(ap_at),
        ap_at=ap_at,
        low=low,
        high=high,
        translation_error_m=translation,
        scale_error=scale,
        orientation_error_rad=orientation,
    )


def _mean(values: tuple[float, ...]) -> float:
    return sum(values) / len(values)


@compiled
def _match(task: CentreTask, distance_m: float) -> Int64[np.ndarray, " num_detections"]:
    """Find the pair by which each detection takes a truth, or -1."""
    chosen = np.full(len(task.score), -1, dtype=np.int64)
    taken = np.zeros(len(task.truth_valid), dtype=np.bool_)
    for rank in range(len(task.score)):
        nearest = distance_m
        for pair in range(task.pair_offsets[rank, 0], task.pair_offsets[rank, 1]):
            if not taken[task.pair_truth[pair]] and task.pair_errors[pair, 0] < nearest:
                chosen[rank], nearest = pair, task.pair_errors[pair, 0]
        if chosen[rank] >= 0:
            taken[task.pair_truth[chosen[rank]]] = True
    return chosen
