"""Digest of a sample's content, by which kept results are matched to their data."""

import hashlib
from dataclasses import fields, is_dataclass

from torch import Tensor

from sightline.geometry.wrong_types import named_arguments
from sightline.structures.sample import CameraLidarSample

_NUM_DIGITS = 20


@named_arguments
def digest_sample(sample: CameraLidarSample) -> str:
    """Compute a digest of all that a sample holds, also from files that frames share."""
    digest = hashlib.sha256()
    _add(digest, sample)
    return digest.hexdigest()[:_NUM_DIGITS]


def _add(digest: "hashlib._Hash", value: object) -> None:
    if is_dataclass(value):
        for each in fields(value):
            digest.update(each.name.encode())
            _add(digest, getattr(value, each.name))
    elif isinstance(value, Tensor):
        digest.update(f"{value.dtype} {tuple(value.shape)}".encode())
        digest.update(value.contiguous().numpy().tobytes())
    else:
        digest.update(repr(value).encode())
