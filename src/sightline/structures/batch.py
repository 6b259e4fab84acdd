"""Interfaces between tasks and training: batches of samples and losses."""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import Field, fields, is_dataclass, replace
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import torch
from torch import Tensor

BatchT = TypeVar("BatchT", bound="FieldwiseBatch")


@runtime_checkable  # for beartype, which checks arguments under pytest
class Batch(Protocol):
    """Batch of samples for a network. Each task has its own type."""

    @property
    def sample_ids(self) -> tuple[str, ...]:
        """Names of the samples, in order."""

    def __len__(self) -> int:
        """Number of samples."""

    def to(self, device: torch.device | str, *, non_blocking: bool = False) -> "Batch":
        """Copy the batch to another device."""

    def pin_memory(self) -> "Batch":
        """Copy the batch to pinned memory, which a GPU can read directly."""


@runtime_checkable  # for beartype, which checks arguments under pytest
class Losses(Protocol):
    """A NamedTuple of scalars: the training loss and its terms."""

    @property
    def total(self) -> Tensor:
        """The training loss."""

    def _asdict(self) -> dict[str, Any]: ...


class FieldwiseBatch:
    """Base class that makes a frozen dataclass with fields per sample a `Batch`.

    A field is a tensor whose first axis is the samples; or a tuple with one entry per sample, if
    samples differ in size (boxes, points); or None, if no sample has it. Entries may be tensors
    (with anonymous axes, `" _"`, as they differ), dataclasses with tensors, or any other values,
    which stay unchanged.

    Raises:
        ValueError: The number of samples in a field differs from the number of names.
    """

    __slots__ = ()
    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]
    nan_fields: ClassVar[Collection[str]] = ()
    """Names of the fields in which NaN stands for an unknown value."""
    sample_ids: tuple[str, ...]

    def __post_init__(self) -> None:
        """Check that every field has as many samples as there are names."""
        for field in fields(self):
            value: Tensor | tuple[object, ...] | None = getattr(self, field.name)
            if value is not None and len(value) != len(self.sample_ids):
                raise ValueError(
                    f"a batch needs one name per sample, got {len(self.sample_ids)} names for "
                    f"{len(value)} in {field.name}"
                )

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.sample_ids)

    # Not `Self`, which beartype accepts in decorated classes only.
    def to(  # noqa: PYI019 - see above
        self: BatchT, device: torch.device | str, *, non_blocking: bool = False
    ) -> BatchT:
        """Copy the batch to another device."""
        return _with_tensors(self, lambda tensor: tensor.to(device, non_blocking=non_blocking))

    def pin_memory(self: BatchT) -> BatchT:  # noqa: PYI019 - see above
        """Copy the batch to pinned memory, which a GPU can read directly."""
        return _with_tensors(self, Tensor.pin_memory)

    def non_finite_samples(self) -> dict[str, tuple[str, ...]]:
        """List samples with an infinity or NaN by the name of the field, except `nan_fields`."""
        found = {}
        for field in fields(self):
            entries = None if field.name in self.nan_fields else getattr(self, field.name)
            pairs = zip(self.sample_ids, () if entries is None else entries, strict=False)
            if names := tuple(name for name, entry in pairs if not _is_finite(entry)):
                found[field.name] = names
        return found


Value = TypeVar("Value")


def _is_finite(value: object) -> bool:
    """Check the numbers in a value, at any depth of tuples and dataclasses."""
    if isinstance(value, Tensor):
        return bool(value.isfinite().all())
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, tuple | list):
        return all(map(_is_finite, value))
    if is_dataclass(value):
        return all(_is_finite(getattr(value, field.name)) for field in fields(value))
    return True


def concatenate(batches: Sequence[BatchT]) -> BatchT:
    """Concatenate batches in order.

    Raises:
        ValueError: There are no batches, their tensors differ in size, or only some have a field.
    """
    if not batches:
        raise ValueError("there is no batch to concatenate; give at least one")
    columns = {
        field.name: [getattr(batch, field.name) for batch in batches]
        for field in fields(batches[0])
    }
    return type(batches[0])(**{name: _joined(name, given) for name, given in columns.items()})


def _joined(name: str, given: Sequence[Any]) -> Any:  # noqa: ANN401 - a field of any batch
    if all(value is None for value in given):
        return None
    if any(value is None for value in given):
        raise ValueError(f"only some samples of a batch have {name}; give data where all have it")
    if isinstance(given[0], tuple):
        return sum(given, ())
    sizes = {tuple(value.shape[1:]) for value in given}
    if len(sizes) > 1:
        raise ValueError(
            f"{name} differs between the samples of a batch, got sizes {sorted(sizes)}; "
            "crop all to one, or take batches of one sample"
        )
    return torch.cat(tuple(given))


def _with_tensors(value: Value, change: Callable[[Tensor], Tensor]) -> Value:
    """Apply a change to every tensor in a value, at any depth of tuples and dataclasses."""
    changed: Any = value
    if isinstance(value, Tensor):
        changed = change(value)
    elif isinstance(value, tuple):
        changed = tuple(_with_tensors(entry, change) for entry in value)
    elif is_dataclass(value) and not isinstance(value, type):
        parts = {
            field.name: _with_tensors(getattr(value, field.name), change) for field in fields(value)
        }
        changed = replace(value, **parts)
    return changed  # type: ignore[no-any-return]
