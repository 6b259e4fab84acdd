"""Several samples as the networks take them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from beartype import beartype
from jaxtyping import Float32, jaxtyped
from torch import Tensor


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class CameraLidarBatch:
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

    def __post_init__(self) -> None:
        """Checks that every sample has a name."""
        if len(self.sample_ids) != len(self.image):
            raise ValueError(
                f"a batch needs one name a sample, got {len(self.sample_ids)} names for "
                f"{len(self.image)} images"
            )

    @staticmethod
    def concatenate(batches: Sequence["CameraLidarBatch"]) -> "CameraLidarBatch":
        """One batch of several, in order.

        Raises:
            ValueError: There are none, they differ in size, or only some have a map.
        """
        if not batches:
            raise ValueError("there is no batch to concatenate; give at least one")
        values: dict[str, Any] = {"sample_ids": sum((batch.sample_ids for batch in batches), ())}
        for name in _TENSORS:
            given = [getattr(batch, name) for batch in batches]
            if all(value is None for value in given):
                continue
            sizes = {None if value is None else tuple(value.shape[1:]) for value in given}
            if len(sizes) > 1:
                raise ValueError(
                    f"{name} differs between the samples of a batch, got sizes "
                    f"{sorted(map(str, sizes))}; crop all to one, or take batches of one sample"
                )
            values[name] = torch.cat(given)
        return CameraLidarBatch(**values)

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.sample_ids)

    def to(self, device: torch.device | str, *, non_blocking: bool = False) -> "CameraLidarBatch":
        """The same batch on another device."""
        return self._map(lambda tensor: tensor.to(device, non_blocking=non_blocking))

    def pin_memory(self) -> "CameraLidarBatch":
        """The same batch in memory that a GPU can fetch by itself."""
        return self._map(Tensor.pin_memory)

    def _map(self, change: Callable[[Tensor], Tensor]) -> "CameraLidarBatch":
        values = {name: getattr(self, name) for name in _TENSORS}
        changed: dict[str, Any] = {
            name: change(value) for name, value in values.items() if value is not None
        }
        return replace(self, **changed)


_TENSORS = tuple(field.name for field in fields(CameraLidarBatch) if field.name != "sample_ids")
