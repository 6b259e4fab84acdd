"""KITTI's two passes of matching detections with truths, compiled.

Pass 1 finds the scores of matched truths, which give the thresholds; pass 2 counts at each
threshold. Both are greedy: in file order, each truth takes one detection that no previous truth has
taken. A detection too small for the difficulty may be taken by a truth of any class, but is neither
a true nor a false positive.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int32, Int64

from sightline.evaluation.kitti_object_pairs import MatchingData
from sightline.ops.compiled import compiled
from sightline.structures.score_curves import NUM_SLOTS

_LOWEST_SCORE = -1e7
"""Score for "nothing found" in the official program: pass 1 never takes a lower score."""

_RIGHT_ANGLE = 0.5 - 1e-9
"""Similarity of headings at 90 degrees, minus the rounding error."""


class MatchingTask(NamedTuple):
    """Matching input of all frames for one class, metric and difficulty.

    Truths without any pair are only counted.
    """

    truth_valid: Bool[np.ndarray, " num_truths"]
    """Whether the truth counts; otherwise it may be found, but is never missed."""
    truth_frame: Int64[np.ndarray, " num_truths"]
    pair_offsets: Int64[np.ndarray, " num_offsets"]
    """Start of the pairs of each truth, and the end of the last one's."""
    pair_detection: Int64[np.ndarray, " num_pairs"]
    pair_overlap: Float64[np.ndarray, " num_pairs"]
    pair_similarity: Float64[np.ndarray, " num_pairs"]
    detection_normal: Bool[np.ndarray, " num_detections"]
    """Whether the detection is of the class, and not small."""
    detection_false: Bool[np.ndarray, " num_detections"]
    """Whether it is a false positive if no truth takes it: normal, and in no DontCare region."""
    detection_score: Float64[np.ndarray, " num_detections"]
    detection_frame: Int64[np.ndarray, " num_detections"]
    valid_per_frame: Int64[np.ndarray, " num_frames"]
    """Number of truths that count, including those without pairs."""

    @property
    def n_gt(self) -> int:
        """Number of truths that count, over all frames."""
        return int(self.valid_per_frame.sum())


class Counts(NamedTuple):
    """Counts of pass 2 at each threshold."""

    tp: Int64[np.ndarray, " num_thresholds"]
    fp: Int64[np.ndarray, " num_thresholds"]
    fn: Int64[np.ndarray, " num_thresholds"]
    similarity: Float64[np.ndarray, " num_thresholds"]
    """Similarity of the headings, summed over the true positives."""
    flipped: Int64[np.ndarray, " num_thresholds"]
    """True positives with a heading error above 90 degrees."""


class FrameSteps(NamedTuple):
    """Changes of single frames' counts as the threshold decreases, highest score first."""

    score: Float64[np.ndarray, " num_steps"]
    frame: Int64[np.ndarray, " num_steps"]
    tp: Int64[np.ndarray, " num_steps"]
    """Change of the frame's true positives when the threshold decreases to the score."""
    fp: Int64[np.ndarray, " num_steps"]
    overlap: Float64[np.ndarray, " num_steps"]
    """Change of the summed overlaps of the frame's true positives."""


class PairIndex(NamedTuple):
    """Indices common to all classes, metrics and difficulties."""

    truth_frame: Int64[np.ndarray, " num_truths"]
    detection_frame: Int64[np.ndarray, " num_detections"]
    pair_truth: Int64[np.ndarray, " num_pairs"]
    pair_detection: Int64[np.ndarray, " num_pairs"]


def index_pairs(data: MatchingData) -> PairIndex:
    """Convert indices within a frame to indices over all frames."""
    frames = np.arange(data.num_frames)
    truth_frame = np.repeat(frames, data.truths_per_frame)
    detection_offsets = np.cumsum(data.detections_per_frame, dtype=np.int64)
    detection_offsets -= data.detections_per_frame
    pair_truth = np.repeat(np.arange(len(truth_frame)), data.pairs_per_truth)
    return PairIndex(
        truth_frame=truth_frame,
        detection_frame=np.repeat(frames, data.detections_per_frame),
        pair_truth=pair_truth,
        pair_detection=data.pair_detection + detection_offsets[truth_frame[pair_truth]],
    )


def select(
    data: MatchingData,
    index: PairIndex,
    *,
    code: int,
    metric: int,
    difficulty: int,
    min_overlap: float,
) -> MatchingTask:
    """Select the matching input of a class, metric and difficulty (their indices)."""
    normal = (data.detection_class == code) & (data.detection_level <= difficulty)
    may_match = normal | (data.detection_level > difficulty)
    is_class = data.truth_class == code
    overlap = data.pair_overlap[:, metric]
    pairs = np.flatnonzero(
        (overlap > min_overlap) & is_class[index.pair_truth] & may_match[index.pair_detection]
    )
    truths, pairs_per_truth = np.unique(index.pair_truth[pairs], return_counts=True)
    valid = is_class & (data.truth_level <= difficulty)
    return MatchingTask(
        truth_valid=valid[truths],
        truth_frame=index.truth_frame[truths],
        pair_offsets=np.concatenate(([0], np.cumsum(pairs_per_truth))),
        pair_detection=index.pair_detection[pairs],
        pair_overlap=overlap[pairs],
        pair_similarity=data.pair_similarity[pairs],
        detection_normal=normal,
        detection_false=normal & ~data.detection_forgiven[:, metric],
        detection_score=data.detection_score,
        detection_frame=index.detection_frame,
        valid_per_frame=np.bincount(index.truth_frame[valid], minlength=data.num_frames),
    )


class Matches(NamedTuple):
    """Valid matches of pass 1, truths in file order, each with the highest score."""

    scores: Float64[np.ndarray, " num_matches"]
    frames: Int64[np.ndarray, " num_matches"]


def match_by_score(task: MatchingTask) -> Matches:
    """Run pass 1 of the official program."""
    scores, truths = _match_by_score(task)
    return Matches(scores, task.truth_frame[truths])


def find_thresholds(
    scores: Float64[np.ndarray, " num_matches"], n_gt: int
) -> Float64[np.ndarray, " num_thresholds"]:
    """Select the matched scores nearest to the recalls 0, 1/40, ...; at most 41, descending."""
    descending = np.sort(scores)[::-1]
    kept = []
    recall = 0.0
    last = len(descending) - 1
    for i in range(len(descending)):
        left = (i + 1) / n_gt
        right = (i + 2) / n_gt if i < last else left
        if i < last and right - recall < recall - left:
            continue
        kept.append(descending[i])
        recall += 1 / (NUM_SLOTS - 1)  # summed, not multiplied: its rounding decides ties
    return np.array(kept, dtype=np.float64)


def count_at(task: MatchingTask, thresholds: Float64[np.ndarray, " num_thresholds"]) -> Counts:
    """Run pass 2: the counts at each threshold."""
    tp, taken, missed, similarity, flipped = _match_by_overlap(task, thresholds)
    ascending = np.sort(task.detection_score[task.detection_false])
    above = len(ascending) - np.searchsorted(ascending, thresholds, side="left")
    without_pairs = task.n_gt - int(task.truth_valid.sum())
    return Counts(
        tp=tp,
        fp=above - taken,
        fn=missed + without_pairs,
        similarity=similarity,
        flipped=flipped,
    )


def count_by_frame(task: MatchingTask) -> FrameSteps:
    """Run pass 2 at every score, frame by frame; only changes are returned."""
    relevant = task.detection_normal.copy()
    relevant[task.pair_detection] = True
    detections = np.flatnonzero(relevant)
    # by frame, the highest score first
    order = np.lexsort((-task.detection_score[detections], task.detection_frame[detections]))
    frames = np.arange(len(task.valid_per_frame) + 1)
    steps = _step_frames(
        task,
        np.searchsorted(task.truth_frame, frames),
        detections[order],
        np.searchsorted(task.detection_frame[detections], frames),
    )
    falling = np.argsort(-steps[0], kind="stable")
    score, frame, tp, fp, overlap = (column[falling] for column in steps)
    return FrameSteps(score=score, frame=frame, tp=tp, fp=fp, overlap=overlap)


@compiled
def _match_by_score(
    task: MatchingTask,
) -> tuple[Float64[np.ndarray, " num_matches"], Int64[np.ndarray, " num_matches"]]:
    """Find the scores of the valid matches, and their truths."""
    taken = np.zeros(len(task.detection_score), dtype=np.bool_)
    scores = np.empty(len(task.truth_valid))
    truths = np.empty(len(task.truth_valid), dtype=np.int64)
    num_scores = 0
    for i in range(len(task.truth_valid)):
        best, best_score = -1, _LOWEST_SCORE
        for pair in range(task.pair_offsets[i], task.pair_offsets[i + 1]):
            j = task.pair_detection[pair]
            if not taken[j] and task.detection_score[j] > best_score:
                best, best_score = j, task.detection_score[j]
        if best >= 0:
            taken[best] = True
            if task.truth_valid[i] and task.detection_normal[best]:
                scores[num_scores], truths[num_scores] = best_score, i
                num_scores += 1
    return scores[:num_scores], truths[:num_scores]


@compiled
def pick_by_overlap(
    task: MatchingTask,
    truth: int,
    threshold: float,
    taken: Int32[np.ndarray, " num_detections"],
    turn: int,
) -> int:
    """Find the pair that a truth takes, or -1: the largest overlap, small detections last.

    A detection with the number of this turn is already taken.
    """
    best, best_overlap, best_normal = -1, 0.0, False
    for pair in range(task.pair_offsets[truth], task.pair_offsets[truth + 1]):
        j = task.pair_detection[pair]
        if taken[j] == turn or task.detection_score[j] < threshold:
            continue
        if task.detection_normal[j]:
            if not best_normal or task.pair_overlap[pair] > best_overlap:
                best, best_overlap, best_normal = pair, task.pair_overlap[pair], True
        elif best < 0:
            best = pair
    return best


@compiled
def _match_by_overlap(
    task: MatchingTask, thresholds: Float64[np.ndarray, " num_thresholds"]
) -> tuple[
    Int64[np.ndarray, " num_thresholds"],
    Int64[np.ndarray, " num_thresholds"],
    Int64[np.ndarray, " num_thresholds"],
    Float64[np.ndarray, " num_thresholds"],
    Int64[np.ndarray, " num_thresholds"],
]:
    """Count at each threshold as in `Counts`, with matches of otherwise false detections."""
    tp = np.zeros(len(thresholds), dtype=np.int64)
    else_false = np.zeros(len(thresholds), dtype=np.int64)
    missed = np.zeros(len(thresholds), dtype=np.int64)
    similarity = np.zeros(len(thresholds))
    flipped = np.zeros(len(thresholds), dtype=np.int64)
    taken = np.full(len(task.detection_score), -1, dtype=np.int32)
    for turn in range(len(thresholds)):
        for i in range(len(task.truth_valid)):
            pair = pick_by_overlap(task, i, thresholds[turn], taken, turn)
            if pair < 0:
                missed[turn] += task.truth_valid[i]
                continue
            j = task.pair_detection[pair]
            taken[j] = turn
            else_false[turn] += task.detection_false[j]
            if task.truth_valid[i] and task.detection_normal[j]:
                tp[turn] += 1
                similarity[turn] += task.pair_similarity[pair]
                flipped[turn] += task.pair_similarity[pair] < _RIGHT_ANGLE
    return tp, else_false, missed, similarity, flipped


@compiled
def _step_frames(
    task: MatchingTask,
    truth_offsets: Int64[np.ndarray, " num_frame_offsets"],
    ranked: Int64[np.ndarray, " num_ranked"],
    ranked_offsets: Int64[np.ndarray, " num_frame_offsets"],
) -> tuple[
    Float64[np.ndarray, " num_steps"],
    Int64[np.ndarray, " num_steps"],
    Int64[np.ndarray, " num_steps"],
    Int64[np.ndarray, " num_steps"],
    Float64[np.ndarray, " num_steps"],
]:
    """Find scores, frames, changes of true and false positives and of overlaps, by frame."""
    scores = np.empty(len(ranked))
    frames = np.empty(len(ranked), dtype=np.int64)
    changes = np.empty((2, len(ranked)), dtype=np.int64)
    overlap_changes = np.empty(len(ranked))
    taken = np.full(len(task.detection_score), -1, dtype=np.int32)
    num_steps = 0
    for frame in range(len(ranked_offsets) - 1):
        tp_before, fp_before, unforgiven = 0, 0, 0
        overlap_before = 0.0
        last = ranked_offsets[frame + 1]
        for rank in range(ranked_offsets[frame], last):
            unforgiven += task.detection_false[ranked[rank]]
            threshold = task.detection_score[ranked[rank]]
            if rank + 1 < last and task.detection_score[ranked[rank + 1]] == threshold:
                continue
            tp, fp, overlap = 0, unforgiven, 0.0
            for i in range(truth_offsets[frame], truth_offsets[frame + 1]):
                pair = pick_by_overlap(task, i, threshold, taken, rank)
                if pair >= 0:
                    j = task.pair_detection[pair]
                    taken[j] = rank
                    fp -= task.detection_false[j]
                    if task.truth_valid[i] and task.detection_normal[j]:
                        tp += 1
                        overlap += task.pair_overlap[pair]
            if tp != tp_before or fp != fp_before or overlap != overlap_before:
                scores[num_steps], frames[num_steps] = threshold, frame
                changes[0, num_steps], changes[1, num_steps] = tp - tp_before, fp - fp_before
                overlap_changes[num_steps] = overlap - overlap_before
                tp_before, fp_before, overlap_before = tp, fp, overlap
                num_steps += 1
    tp_changes, fp_changes = changes[0, :num_steps], changes[1, :num_steps]
    return (
        scores[:num_steps],
        frames[:num_steps],
        tp_changes,
        fp_changes,
        overlap_changes[:num_steps],
    )
