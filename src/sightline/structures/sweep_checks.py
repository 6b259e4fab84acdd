"""Check of a task's input sweeps."""

from sightline.structures.sample import CameraLidarSample


def check_finite_points(sample: CameraLidarSample) -> None:
    """Refuse a sweep with non-finite points: one NaN would spread through a network.

    Raises:
        ValueError: A coordinate or a reflectance is NaN or infinite.
    """
    if sample.points is None:
        return
    is_finite = sample.points.isfinite().all(dim=1)
    if not is_finite.all():
        raise ValueError(
            f"the sweep of sample {sample.sample_id} holds {int((~is_finite).sum())} points with "
            f"NaN or infinite values, the first is point {int(is_finite.int().argmin())} of "
            f"{len(sample.points)} (from 0); leave them out"
        )
