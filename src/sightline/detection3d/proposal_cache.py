"""Cache of a first stage's output for a data set, on disk, for training the second stage.

The cache is a folder with the manifest `sightline.json` and a file for each frame,
FRAME.safetensors. A file contains

* points: float32, num_points x 4, the first stage's input sweep,
* features: float16, num_points x channels, the features of each point,
* boxes, classes, scores: float32 num x 7, int64, float32, the proposals for scoring in training,
* training_boxes, training_classes, training_scores: the same for training the second stage,

and in its metadata, as JSON under "sightline", the version of this format, the identity of the
first stage with its settings, and the digest of the frame's original sweep.
"""

import hashlib
import json
from pathlib import Path
from typing import Final

import safetensors
from jaxtyping import Float, Float32
from safetensors.torch import save
from torch import Tensor

from sightline.detection3d.batch import FirstStageRecord
from sightline.detection3d.model import Detector3D
from sightline.detection3d.stages import Proposed, Sweep
from sightline.files.atomic import atomic_write_bytes
from sightline.files.plain_text import shortened
from sightline.files.problem import FileError
from sightline.files.settings import config_to_dict
from sightline.structures.sample import CameraLidarSample

SUFFIX: Final = ".safetensors"
FORMAT: Final = 1

_METADATA_KEY = "sightline"
_REMEDY = "make the cache again by `sightline proposals`"
_COLUMNS = ("boxes", "classes", "scores")
_SETTINGS = ("input", "proposals", "training_proposals", "centers")


def first_stage_identity(detector: Detector3D) -> str:
    """Compute a digest of the first stage's weights and of all settings that affect proposals."""
    plain = config_to_dict(detector.config)
    settings = {name: plain[name] for name in (*_SETTINGS, detector.first_name)}
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    stage = detector.get_submodule(detector.first_name)
    for name, tensor in sorted(stage.state_dict().items()):
        digest.update(name.encode())
        digest.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


def sweep_digest(sample: CameraLidarSample) -> str:
    """Compute a digest of a sample's sweep, which separates data sets with the same frame names.

    Raises:
        ValueError: The sample has no sweep.
    """
    if sample.points is None:
        raise ValueError(f"sample {sample.sample_id} has no sweep; give data with velodyne files")
    content = sample.points.contiguous().numpy().tobytes()
    return hashlib.blake2b(content, digest_size=16).hexdigest()


def write_record(
    folder: Path,
    sample: CameraLidarSample,
    *,
    made_by: str,
    points: Float32[Tensor, "num_points 4"],
    features: Float[Tensor, "num_points channels"],
    proposed: Proposed,
    training_proposed: Proposed,
) -> None:
    """Write a frame's file atomically.

    Args:
        folder: Folder of the cache.
        sample: The original frame.
        made_by: See `first_stage_identity`.
        points: Input of the first stage.
        features: Features of these points.
        proposed: Proposals for scoring.
        training_proposed: Proposals for training.
    """
    columns = {"points": points, "features": features.half()}
    for start, given in (("", proposed), ("training_", training_proposed)):
        columns |= {start + name: getattr(given, name) for name in _COLUMNS}
    described = {"format": FORMAT, "made_by": made_by, "sweep": sweep_digest(sample)}
    tensors = {
        name: column.detach().to("cpu", copy=True).contiguous() for name, column in columns.items()
    }
    content = save(tensors, {_METADATA_KEY: json.dumps(described, sort_keys=True)})
    atomic_write_bytes(folder / f"{sample.sample_id}{SUFFIX}", content)


def read_record(
    folder: Path, sample: CameraLidarSample, *, training: bool
) -> tuple[Sweep, FirstStageRecord]:
    """Read a frame's points and its first-stage output.

    Args:
        folder: Folder of the cache.
        sample: The original frame.
        training: Whether to take the proposals for training.

    Raises:
        ValueError: The file is missing, damaged, in another version's format or of another sweep.
    """
    path = folder / f"{sample.sample_id}{SUFFIX}"
    if not path.is_file():
        raise FileError(path, "does not exist, so the cache lacks this frame", _REMEDY)
    start = "training_" if training else ""
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            described = json.loads((file.metadata() or {})[_METADATA_KEY])
            points, features = (file.get_tensor(name) for name in ("points", "features"))
            columns = {name: file.get_tensor(start + name) for name in _COLUMNS}
            found, made_by, sweep = (described[key] for key in ("format", "made_by", "sweep"))
        record = FirstStageRecord(made_by=made_by, features=features, **columns)
    except Exception as error:
        # Damaged bytes, and tensors of another format, raise nearly any exception.
        reason = shortened(" ".join(str(error).split()), 160)
        raise FileError(path, f"is no frame of a proposal cache ({reason})", _REMEDY) from error
    if found != FORMAT:
        raise FileError(path, f"is of format {found}, expected {FORMAT}", _REMEDY)
    if sweep != sweep_digest(sample):
        raise FileError(
            path, "was made of another sweep than the data's frame of this name", _REMEDY
        )
    return points, record


def check_made_by(record: FirstStageRecord, identity: str) -> None:
    """Check that a record comes from the given first stage.

    Raises:
        ValueError: Another first stage made it.
    """
    if record.made_by != identity:
        raise ValueError(
            "the cache was made by a first stage of other weights or settings than the training's; "
            f"train with those that made it (initial_weights, network), or {_REMEDY}"
        )
