"""Average precision of frames drawn with replacement, for bootstrap intervals.

A frame's matches do not depend on other frames, so they are found once; a resample only weights
each frame by its number of draws.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from sightline.evaluation.kitti_object_matching import (
    FrameSteps,
    Matches,
    MatchingTask,
    count_by_frame,
    match_by_score,
)
from sightline.ops.compiled import compiled
from sightline.structures.score_curves import NUM_SLOTS


class ResampledCurve(NamedTuple):
    """Matches of all frames, which give the precision of any resample."""

    steps: FrameSteps
    ends: Bool[np.ndarray, " num_steps"]
    """Whether a step is the last of its score."""
    matches: Matches
    """Matches, highest score first."""
    valid_per_frame: Int64[np.ndarray, " num_frames"]

    @classmethod
    def of(cls, task: MatchingTask) -> "ResampledCurve":
        """Find the matches of a class, metric and difficulty."""
        steps, (scores, frames) = count_by_frame(task), match_by_score(task)
        falling = np.argsort(-scores, kind="stable")
        return cls(
            steps=steps,
            ends=np.diff(steps.score, append=-np.inf) != 0,
            matches=Matches(scores[falling], frames[falling]),
            valid_per_frame=task.valid_per_frame,
        )

    @property
    def num_frames(self) -> int:
        """Number of frames for resampling."""
        return len(self.valid_per_frame)

    def ap_all_points(self, weights: Int64[np.ndarray, " num_frames"]) -> float:
        """Compute the area in percent under the monotone curve of frames with these weights."""
        steps, n_gt = self.steps, int(weights @ self.valid_per_frame)
        return 100 * _area(weights[steps.frame], steps.tp, steps.fp, self.ends, n_gt)

    def ap_r40(self, weights: Int64[np.ndarray, " num_frames"]) -> float:
        """Compute KITTI's AP at 40 recall positions, percent, of frames with these weights."""
        steps, matches, n_gt = self.steps, self.matches, int(weights @ self.valid_per_frame)
        repeats = weights[matches.frames]
        slots = _fill_slots(weights[steps.frame], steps, matches.scores, repeats, n_gt)
        return 100 * float(np.maximum.accumulate(slots[::-1])[::-1][1:].mean())


@compiled
def _area(
    weights: Int64[np.ndarray, " num_steps"],
    tp_changes: Int64[np.ndarray, " num_steps"],
    fp_changes: Int64[np.ndarray, " num_steps"],
    ends: Bool[np.ndarray, " num_steps"],
    n_gt: int,
) -> float:
    """Compute the mean over k = 1..n_gt of the best precision with at least k objects found."""
    best = np.zeros(n_gt + 1)
    tp, fp = 0, 0
    for step in range(len(weights)):
        tp += weights[step] * tp_changes[step]
        fp += weights[step] * fp_changes[step]
        if ends[step] and tp > 0:
            best[tp] = max(best[tp], tp / (tp + fp))
    area, highest = 0.0, 0.0
    for k in range(n_gt, 0, -1):
        highest = max(highest, best[k])
        area += highest
    return area / n_gt


@compiled
def _fill_slots(
    weights: Int64[np.ndarray, " num_steps"],
    steps: FrameSteps,
    match_scores: Float64[np.ndarray, " num_matches"],
    repeats: Int64[np.ndarray, " num_matches"],
    n_gt: int,
) -> Float64[np.ndarray, "41"]:
    """Compute the precision at each recall position: `find_thresholds` and pass 2 in one step."""
    slots = np.zeros(NUM_SLOTS)
    last = repeats.sum() - 1
    found, slot, step, tp, fp = 0, 0, 0, 0, 0
    recall = 0.0
    for match in range(len(match_scores)):
        for _ in range(repeats[match]):
            left = (found + 1) / n_gt
            right = (found + 2) / n_gt if found < last else left
            is_passed = found < last and right - recall < recall - left
            found += 1
            if is_passed:
                continue
            while step < len(weights) and steps.score[step] >= match_scores[match]:
                tp += weights[step] * steps.tp[step]
                fp += weights[step] * steps.fp[step]
                step += 1
            if tp + fp > 0:
                slots[slot] = tp / (tp + fp)
            slot += 1
            recall += 1 / (NUM_SLOTS - 1)  # summed, as in `find_thresholds`
    return slots
