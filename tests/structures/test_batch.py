from dataclasses import dataclass

import pytest
import torch
from beartype import beartype
from jaxtyping import Float, Float32, jaxtyped
from torch import Tensor

from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.batch import Batch, FieldwiseBatch, concatenate


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class FramesBatch(FieldwiseBatch):
    """Batch like a detector's: images of one size, boxes that differ in number."""

    sample_ids: tuple[str, ...]
    image: Float32[Tensor, "batch 3 height width"]
    depth_m: Float32[Tensor, "batch 1 height width"] | None = None
    boxes: tuple[Boxes3D, ...] | None = None
    areas: tuple[Float[Tensor, " _"], ...] | None = None


def boxes(count):
    return Boxes3D(torch.rand(count, 7))


def batch(names=("000001", "000002"), **changes):
    values = {
        "image": torch.rand(len(names), 3, 4, 6),
        "depth_m": torch.rand(len(names), 1, 4, 6),
        "boxes": tuple(boxes(count) for count in range(len(names))),
    }
    return FramesBatch(sample_ids=names, **(values | changes))


def test_it_is_a_batch():
    assert isinstance(batch(), Batch)
    assert len(batch()) == 2


def test_to_moves_every_tensor_however_deep_and_keeps_names_and_gaps():
    moved = batch(depth_m=None).to("meta")
    assert moved.sample_ids == ("000001", "000002")
    assert moved.depth_m is None
    assert moved.image.device.type == "meta"
    assert [entry.tensor.device.type for entry in moved.boxes] == ["meta", "meta"]


def test_a_field_of_another_number_of_samples_than_names_is_refused():
    with pytest.raises(ValueError, match="got 1 names for 2 in image"):
        batch(("000001",), image=torch.rand(2, 3, 4, 6), depth_m=None)
    with pytest.raises(ValueError, match="got 2 names for 1 in boxes"):
        batch(boxes=(boxes(1),))


def test_tensors_are_stacked_in_order_and_ragged_truth_has_an_entry_a_frame():
    first, second = batch(("a", "b")), batch(("c", "d", "e"))
    joined = concatenate((first, second))
    assert joined.sample_ids == ("a", "b", "c", "d", "e")
    assert torch.equal(joined.image, torch.cat((first.image, second.image)))
    assert [len(entry) for entry in joined.boxes] == [0, 1, 0, 1, 2]
    assert joined.boxes[4] is second.boxes[2]
    assert joined.areas is None


def test_parts_of_a_batch_joined_are_the_batch():
    parts = [batch((name,), areas=(torch.rand(len(name)),)) for name in ("a", "bb", "c")]
    whole = concatenate(parts)
    regrouped = concatenate((concatenate(parts[:2]), parts[2]))
    assert torch.equal(whole.image, regrouped.image)
    assert all(one is other for one, other in zip(whole.areas, regrouped.areas, strict=True))


def test_batches_of_which_some_lack_a_field_are_not_joined():
    with pytest.raises(ValueError, match="only some samples of a batch have depth_m"):
        concatenate((batch(), batch(depth_m=None)))
    with pytest.raises(ValueError, match="only some samples of a batch have boxes"):
        concatenate((batch(), batch(boxes=None)))


def test_images_of_two_sizes_are_not_joined():
    small = batch(image=torch.rand(2, 3, 2, 6), depth_m=torch.rand(2, 1, 2, 6))
    with pytest.raises(ValueError, match=r"image differs .* sizes .*3, 2, 6.*crop all to one"):
        concatenate((batch(), small))


def test_samples_that_are_not_finite_are_listed_by_field_except_where_nan_is_unknown():
    class Unknown(FramesBatch):
        nan_fields = ("depth_m",)

    assert batch().non_finite_samples() == {}
    values = {"image": torch.rand(2, 3, 4, 6), "depth_m": torch.full((2, 1, 4, 6), torch.nan)}
    values["image"][1, 0, 2, 3] = torch.inf
    found = (boxes(1), Boxes3D(torch.full((1, 7), torch.nan)))
    assert batch(**values).non_finite_samples() == {
        "image": ("000002",),
        "depth_m": ("000001", "000002"),
    }
    assert batch(boxes=found).non_finite_samples() == {"boxes": ("000002",)}
    unknown = Unknown(sample_ids=("a", "b"), **values)
    assert unknown.non_finite_samples() == {"image": ("b",)}


def test_no_batches_make_no_batch():
    with pytest.raises(ValueError, match="at least one"):
        concatenate(())
