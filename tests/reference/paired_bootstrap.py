"""Differences of two submissions with intervals, by scoring every resample from its files anew."""

import numpy as np

from tests.reference import kitti_object


def average_precisions(frames, name, metric, level):
    """R40 and AP over all points of frames, which may stand there several times."""
    evaluation = kitti_object.Evaluation(frames)
    r40 = evaluation.score(name, metric, level, False).ap_r40
    each = [
        kitti_object.Frame(evaluation, *pair, name, metric, level) for pair in evaluation.frames
    ]
    scores = {found.score for frame in each for found in frame.detections}
    passes = [[frame.pass_2(score) for frame in each] for score in scores]
    counts = [(sum(p[0] for p in row), sum(p[1] for p in row)) for row in passes]
    n_gt = sum(frame.truth_kinds.count("valid") for frame in each)
    return np.array([r40, kitti_object.all_points(counts, n_gt)])


def paired_interval(labels, first, second, name, metric, level, *, num_resamples, seed):
    """Difference, and the 2.5 and 97.5 % quantiles of resampled ones: of R40 and of all points.

    Draws follow the order that is documented: whole numbers below the number of frames from numpy's
    default generator; a draw without an object that counts is passed over.
    """
    generator = np.random.default_rng(seed)

    def difference(numbers):
        return average_precisions(
            [(labels[n], first[n]) for n in numbers], name, metric, level
        ) - average_precisions([(labels[n], second[n]) for n in numbers], name, metric, level)

    def has_objects(number):
        evaluation = kitti_object.Evaluation([(labels[number], "")])
        frame = kitti_object.Frame(evaluation, *evaluation.frames[0], name, metric, level)
        return "valid" in frame.truth_kinds

    resampled = []
    for _ in range(num_resamples):
        drawn = generator.integers(len(labels), size=len(labels)).tolist()
        if any(has_objects(number) for number in drawn):
            resampled.append(difference(drawn))
    low, high = np.quantile(np.array(resampled), (0.025, 0.975), axis=0)
    return difference(range(len(labels))), low, high
