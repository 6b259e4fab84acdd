"""Several samples as the depth completion networks take them."""

from dataclasses import dataclass

from beartype import beartype
from jaxtyping import Float32, jaxtyped
from torch import Tensor

from sightline.structures.batch import FieldwiseBatch


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class DepthBatch(FieldwiseBatch):
    """Samples of one image size, as tensors. Depth maps: metres along the optical axis, 0 = none.

    A camera that delivered nothing is a black image, which is also what a dead camera delivers.
    """

    sample_ids: tuple[str, ...]
    image: Float32[Tensor, "batch 3 height width"]
    """RGB in [0, 1]."""
    sparse_depth_m: Float32[Tensor, "batch 1 height width"]
    """What the sweep gives the image."""
    filled_depth_m: Float32[Tensor, "batch 1 height width"] | None = None
    """The sparse map completed by a classical method, for networks that start from one."""
    depth_m: Float32[Tensor, "batch 1 height width"] | None = None
    """Truth to train on or to score against."""
    dense_depth_m: Float32[Tensor, "batch 1 height width"] | None = None
    """Dense truth to train on besides, where `depth_m` holds but a few rings."""
    weight: Float32[Tensor, "batch 1 height width"] | None = None
    """How much each pixel of `depth_m` counts in the loss; None: all alike."""
