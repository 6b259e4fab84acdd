from dataclasses import asdict

import numpy as np
import pytest
import torch

from sightline.evaluation.depth_metric import DepthCompletionScores
from sightline.evaluation.depth_scores import mean_scores, score_depth


def batch(seed, size=3):
    rng = np.random.default_rng(seed)
    maps = rng.uniform(1, 80, (2, size, 6, 8)) * (rng.random((2, size, 6, 8)) < 0.9)
    return torch.from_numpy(maps.astype(np.float32)).unbind()


def test_the_metric_is_the_mean_over_all_images_of_all_batches():
    metric = DepthCompletionScores()
    scores = []
    for prediction, truth in (batch(0), batch(1, size=2)):
        metric.update(prediction, truth)
        pairs = zip(prediction.numpy(), truth.numpy(), strict=True)
        scores += [score_depth(*pair) for pair in pairs]
    got = {name: value.item() for name, value in metric.compute().items()}
    assert got == pytest.approx(asdict(mean_scores(scores)), rel=1e-12)


def test_predictions_of_half_precision_are_scored():
    prediction, truth = batch(0)
    halves, rounded = DepthCompletionScores(), DepthCompletionScores()
    halves.update(prediction.bfloat16(), truth)
    rounded.update(prediction.bfloat16().float(), truth)
    assert halves.compute() == rounded.compute()


def test_a_reset_forgets_what_was_scored():
    metric = DepthCompletionScores()
    metric.update(*batch(0))
    metric.reset()
    metric.update(*batch(1))
    again = DepthCompletionScores()
    again.update(*batch(1))
    assert metric.compute() == again.compute()


def test_sums_of_two_processes_add_up_to_those_of_one():
    one, other, both = (DepthCompletionScores() for _ in range(3))
    one.update(*batch(0))
    other.update(*batch(1, size=2))
    both.update(*batch(0))
    both.update(*batch(1, size=2))
    torch.testing.assert_close(one.sums + other.sums, both.sums)
    assert one.num_images + other.num_images == both.num_images
