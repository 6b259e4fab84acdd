"""Batches of the depth completion networks."""

from dataclasses import dataclass

from beartype import beartype
from jaxtyping import Float32, jaxtyped
from torch import Tensor

from sightline.structures.batch import FieldwiseBatch


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class DepthBatch(FieldwiseBatch):
    """Batch of samples of one image size. Depth maps: metres along the optical axis, 0 = none.

    A missing camera image is black, like the image of a dead camera.
    """

    sample_ids: tuple[str, ...]
    image: Float32[Tensor, "batch 3 height width"]
    """RGB in [0, 1]."""
    sparse_depth_m: Float32[Tensor, "batch 1 height width"]
    """The sweep projected into the image."""
    filled_depth_m: Float32[Tensor, "batch 1 height width"] | None = None
    """The sparse map completed by a classical method, for networks that start from one."""
    depth_m: Float32[Tensor, "batch 1 height width"] | None = None
    """Ground truth for training or scoring."""
    dense_depth_m: Float32[Tensor, "batch 1 height width"] | None = None
    """Additional dense ground truth for training, where `depth_m` contains only a few rings."""
    weight: Float32[Tensor, "batch 1 height width"] | None = None
    """Weight of each pixel of `depth_m` in the loss; None: all equal."""
