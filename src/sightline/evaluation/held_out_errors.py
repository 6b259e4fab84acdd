"""Errors of one depth map by the held-out-rings protocol."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from sightline.evaluation.held_out_frame import HeldOutFrame
from sightline.structures.predictions import DepthMap


@dataclass(frozen=True, kw_only=True, slots=True)
class HeldOutErrors:
    """Errors over the pixels with truth of one frame."""

    rmse_mm: float
    mae_mm: float
    median_mm: float
    """Median of the absolute errors."""
    coverage: float
    """Share of the truth's pixels with a depth from the method; the others were filled."""


def held_out_errors(
    frame: HeldOutFrame, prediction: DepthMap, place: str, *, zero_where_nothing: bool = False
) -> HeldOutErrors:
    """Score a method's depth map on a frame's truth.

    Pixels without a prediction take the nearest one (Euclidean, in the image).

    Args:
        frame: Frame with the truth.
        prediction: Depth map of the frame's image size.
        place: Name of the frame in error messages, e.g. "sample 000001 with 64 beams".
        zero_where_nothing: Whether a map without any depth counts as 0 m everywhere, so that its
            error is the truth itself; otherwise it is refused.

    Raises:
        ValueError: The map is of another size, or has a depth that is not finite, or none at all.
    """
    depth_m = prediction.depth_m.cpu().numpy().astype(np.float64)
    size = frame.sample.image_size
    if depth_m.shape != size:
        raise ValueError(
            f"the method gave a depth map of {depth_m.shape[0]}x{depth_m.shape[1]} for {place}, "
            f"expected {size[0]}x{size[1]} (height x width)"
        )
    if not np.isfinite(depth_m).all():
        raise ValueError(f"the method gave depths that are not finite for {place}; use 0 for none")
    is_predicted = depth_m > 0
    truth_m = frame.truth_m.numpy().astype(np.float64)
    scored = truth_m > 0
    if is_predicted.any():
        if not is_predicted[scored].all():
            depth_m = _fill_by_nearest(depth_m)
    elif not zero_where_nothing:
        raise ValueError(f"the method gave no depth at all for {place}; leave the sample out")
    error_mm = 1e3 * (depth_m - truth_m)[scored]
    return HeldOutErrors(
        rmse_mm=float(np.sqrt(np.mean(error_mm**2))),
        mae_mm=float(np.mean(np.abs(error_mm))),
        median_mm=float(np.median(np.abs(error_mm))),
        coverage=float(is_predicted[scored].mean()),
    )


def _fill_by_nearest(depth_m: Float[np.ndarray, "height width"]) -> np.ndarray:
    rows, columns = ndimage.distance_transform_edt(
        depth_m <= 0, return_distances=False, return_indices=True
    )
    filled: np.ndarray = depth_m[rows, columns]
    return filled
