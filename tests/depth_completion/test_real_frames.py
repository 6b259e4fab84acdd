"""Completion methods on real KITTI frames, by the held-out-rings protocol."""

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.depth_completion.adaptive import adaptive_depth
from sightline.depth_completion.classical import ClassicalConfig, classical_depth
from sightline.depth_completion.interpolation import linear_depth, nearest_depth
from sightline.evaluation.held_out import evaluate_held_out
from sightline.geometry.projection import sparse_depth_map

EVERY = 7  # interval in the 29 frames, so that this takes seconds; the benchmark uses all
TOLERANCE = 1.05


def test_adaptive_is_within_a_twentieth_of_the_best_other_method_at_every_density(kitti_root):
    frames = KittiObjectDataset(kitti_root, sample_list="sample_val", parts={"points"})

    def rmse_mm(method):
        def complete(sample):
            sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
            return method(sparse.numpy())

        samples = (frames[index] for index in range(0, len(frames), EVERY))
        return [score.rmse_mm for score in evaluate_held_out(samples, complete).scores]

    bilateral = ClassicalConfig(blur="bilateral", extrapolate=False)
    others = [
        rmse_mm(nearest_depth),
        rmse_mm(linear_depth),
        rmse_mm(classical_depth),
        rmse_mm(lambda sparse: classical_depth(sparse, bilateral)),
    ]
    best = [min(scores) for scores in zip(*others, strict=True)]
    for beams, (score, limit) in enumerate(zip(rmse_mm(adaptive_depth), best, strict=True)):
        assert score <= TOLERANCE * limit, f"density number {beams}"
