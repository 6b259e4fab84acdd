"""Cache of a first stage's output for a data set, on disk, for training the second stage.

The cache is a folder with the manifest `sightline.json` and a file for each frame,
FRAME.safetensors. A file contains

* points: float32, num_points x 4, the first stage's input sweep,
* features: float16, num_points x channels, the features of each point,
* boxes, classes, scores: float32 num x 7, int64, float32, the proposals for scoring in training,
* training_boxes, training_classes, training_scores: the same for training the second stage,

and in its metadata, as JSON under "sightline", the version of this format, the identity of the
first stage with its settings, the digest of the frame's sweep with its calibration, and the mount
of the LiDAR, in whose level frame over the road points and boxes are.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
import safetensors
import torch
from beartype import beartype
from jaxtyping import Float, Float32, Int64, jaxtyped
from safetensors.torch import save
from scipy.spatial.transform import Rotation
from torch import Tensor

from sightline.data.datasets.newer_frames import warn_of_newer_frames
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.layouts.kitti_trees import Part, Velodyne
from sightline.data.open import open_dataset
from sightline.detection3d.detector import Detector3D
from sightline.detection3d.network_task import NETWORK_TASK
from sightline.detection3d.predictor import StageRunners
from sightline.detection3d.stages import Proposed
from sightline.detection3d.sweeps import Sweep, network_sweep, to_kitti_frame
from sightline.files.atomic import atomic_write_bytes
from sightline.files.plain_text import shortened
from sightline.files.problem import FileError
from sightline.files.settings import config_to_dict
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.inference.network import load_network
from sightline.jobs.output_dirs import acquire_output_dir, check_outside_dataset, finished_names
from sightline.jobs.run import LEAVE_OUT, JobResult, check_workers, run_job, shard
from sightline.structures.sample import CameraLidarSample

SUFFIX: Final = ".safetensors"
FORMAT: Final = 3
_METADATA_KEY = "sightline"
REMEDY: Final = "make the cache again by `sightline proposals`"
_COLUMNS = ("boxes", "classes", "scores")
_DECIMALS = 6  # of matrices that are compared: processors round differently
_HEIGHTS_AGREE_M = 0.2
"""Largest difference of a mount's height: estimates by the first 3, 6, .. and 90 of 90 frames of
KITTI differ by up to 0.16 m."""
_TILTS_AGREE_DEG = 1.5
"""The same of its tilt; a choice, half of the tilt from which estimates count."""
_SETTINGS = ("input", "proposals", "training_proposals", "centers")


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class FirstStageRecord:
    """Saved first-stage output for a sweep; see `proposal_cache`."""

    made_by: str
    """Identity of the stage and its settings."""
    features: Float[Tensor, "num_points channels"]
    """Features of the points."""
    boxes: Float32[Tensor, "num_proposals 7"]
    classes: Int64[Tensor, " num_proposals"]
    """Indices into the detector's classes."""
    scores: Float32[Tensor, " num_proposals"]

    @property
    def proposed(self) -> Proposed:
        """The first stage's output."""
        features = self.features.float() if self.features.shape[1] else None
        return Proposed(self.boxes, self.classes, self.scores, features)


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
    """Compute a digest of a sample's sweep and calibration, the first stage's input but the mount.

    Raises:
        ValueError: The sample has no sweep.
    """
    if sample.points is None:
        raise ValueError(f"sample {sample.sample_id} has no sweep; give data with point clouds")
    digest = hashlib.sha256(sample.points.contiguous().numpy().tobytes())
    digest.update(f"{sample.image_size} {sample.all_around}".encode())
    calibration = sample.calibration
    for matrix in (calibration.image_from_camera, calibration.camera_from_lidar):
        digest.update((matrix.numpy().round(_DECIMALS) + 0.0).tobytes())  # no negative zeros
    return digest.hexdigest()


def read_record(
    folder: Path, sample: CameraLidarSample, *, training: bool
) -> tuple[Sweep, FirstStageRecord, CameraLidarSample]:
    """Read an original frame's points and its first-stage output, for training or for scoring.

    Returns:
        The points, the output, and the sample with the mount that both were computed with.

    Raises:
        ValueError: The file is missing, damaged, in another version's format, or of another sweep,
            calibration or mount.
    """
    path = folder / f"{sample.sample_id}{SUFFIX}"
    if not path.is_file():
        raise FileError(path, "does not exist, so the cache lacks this frame", REMEDY)
    start = "training_" if training else ""
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            described = json.loads((file.metadata() or {})[_METADATA_KEY])
            points, features = (file.get_tensor(name) for name in ("points", "features"))
            columns = {name: file.get_tensor(start + name) for name in _COLUMNS}
            found, made_by, sweep = (described[key] for key in ("format", "made_by", "sweep"))
            mounted = _with_mount(sample, described["mount"]) if found == FORMAT else sample
        record = FirstStageRecord(made_by=made_by, features=features, **columns)
    except Exception as error:
        # Damaged bytes, and tensors of another format, raise nearly any exception.
        reason = shortened(" ".join(str(error).split()), 160)
        raise FileError(path, f"is no frame of a proposal cache ({reason})", REMEDY) from error
    if found != FORMAT:
        raise FileError(path, f"is of format {found}, expected {FORMAT}", REMEDY)
    if sweep != sweep_digest(sample):
        raise FileError(
            path,
            "was made of another sweep or calibration than the data's frame of this name",
            REMEDY,
        )
    difference = _describe_difference(mounted, sample)
    if difference is not None:
        raise FileError(path, f"was made of {difference}", REMEDY)
    return points, record, mounted


def _mount_of(sample: CameraLidarSample) -> dict[str, Any]:
    """Entry of the metadata for a sample's mount."""
    level = sample.level_from_lidar
    return {
        "lidar_height_m": sample.lidar_height_m,
        "level_from_lidar": None if level is None else level.tolist(),
    }


def _with_mount(sample: CameraLidarSample, mount: Mapping[str, Any]) -> CameraLidarSample:
    """Give a sample a mount of the metadata; a damaged one raises nearly any exception."""
    level = mount["level_from_lidar"]
    return replace(
        sample,
        lidar_height_m=mount["lidar_height_m"],
        level_from_lidar=None if level is None else torch.tensor(level, dtype=torch.float64),
    )


def _describe_difference(before: CameraLidarSample, now: CameraLidarSample) -> str | None:
    """Describe mounts that differ by more than estimates do as frames are added; None: equal."""
    heights = [KITTI_LIDAR_HEIGHT_M + each.higher_than_kitti_m for each in (before, now)]
    if abs(heights[0] - heights[1]) > _HEIGHTS_AGREE_M:
        was, is_now = heights
        return f"a LiDAR {was:.2f} m above the road, which the data give as {is_now:.2f} m"
    levels = [
        np.eye(3) if each.level_from_lidar is None else each.level_from_lidar[:3, :3].numpy()
        for each in (before, now)
    ]
    angle_deg = np.degrees(Rotation.from_matrix(levels[0].T @ levels[1]).magnitude())
    if angle_deg > _TILTS_AGREE_DEG:
        return f"a LiDAR whose tilt the data give as another one, by {angle_deg:.1f} degrees"
    return None


def cache_proposals(
    data: Path,
    out: Path,
    *,
    weights: str | Path,
    device: str = "cpu",
    sample_list: str | Path | Sequence[str] | None = None,
    velodyne: Velodyne | None = None,
    workers: int = 2,
    overwrite: bool = False,
    shard_index: int = 0,
    num_shards: int = 1,
) -> JobResult:
    """Save a first stage's points, features and proposals; see `proposal_cache`.

    Files are written atomically, and frames with existing files are skipped, so running a stopped
    job again finishes it.

    Args:
        data: Folder of the data set; see `open_dataset`.
        out: Folder of the cache; made where it is missing.
        weights: Name or file of a detector's weights. Its second stage, if any, is not used.
        device: Device for PyTorch.
        sample_list: Which samples; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder in an object tree. None: velodyne, or else velodyne_reduced.
        workers: Number of processes; 1 is this process alone.
        overwrite: Whether to replace existing files.
        shard_index: Which part of the samples to do, from 0.
        num_shards: Number of parts.

    Raises:
        ValueError: The data or the weights cannot be read, or the folder holds the output of
            another first stage, or its first existing file was made from another sweep.
    """
    check_workers(workers)
    shard((), shard_index, num_shards)  # checks the shard before the data is opened
    check_outside_dataset(data, [out])
    loaded = load_network(NETWORK_TASK, weights)
    identity = first_stage_identity(loaded.network)
    parts: tuple[Part, ...] = ("points",)
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne, parts=parts)
    settings = {
        "task": NETWORK_TASK.name,
        "output": "proposal cache",
        "format": FORMAT,
        "first_stage": identity,
        "sightline": version("sightline"),
    }
    acquire_output_dir(out, settings, results=(f"*{SUFFIX}",))
    there = frozenset() if overwrite else finished_names(out, SUFFIX)
    indices = shard(range(len(dataset)), shard_index, num_shards)
    done = [index for index in indices if dataset.sample_ids[index] in there]
    if done:
        read_record(out, dataset[done[0]], training=False)  # raises for a cache of another data set
    kept = ((index, [out / f"{dataset.sample_ids[index]}{SUFFIX}"]) for index in done)
    warn_of_newer_frames(dataset, kept, parts=parts)
    pending = [index for index in indices if dataset.sample_ids[index] not in there]
    stages = StageRunners(loaded, device=device, threads=1)  # threads of each worker
    works = [_ProposalWork(dataset, index, stages, identity, out) for index in pending]
    run_job(works, workers, description=f"proposals by {loaded.name}", leave_out=LEAVE_OUT)
    return JobResult(written=len(pending), skipped=len(done))


@dataclass(frozen=True, slots=True)
class _ProposalWork:
    """Work item: runs the first stage on a frame and writes its file."""

    dataset: SampleDataset
    index: int
    stages: StageRunners
    identity: str
    out: Path

    def __str__(self) -> str:
        return f"sample {self.dataset.sample_ids[self.index]}"

    def run(self) -> None:
        sample = self.dataset[self.index]
        points = network_sweep(to_kitti_frame(sample), self.stages.detector.config.input)
        proposed, training_proposed = self.stages.propose_both(points)
        features = proposed.features
        if features is None:  # a sweep without points, or a stage without features
            features = points.new_zeros(len(points), self.stages.detector.first.feature_channels)
        columns = {"points": points, "features": features.half()}
        for start, given in (("", proposed), ("training_", training_proposed)):
            columns |= {start + name: getattr(given, name) for name in _COLUMNS}
        described = {
            "format": FORMAT,
            "made_by": self.identity,
            "sweep": sweep_digest(sample),
            "mount": _mount_of(sample),
        }
        tensors = {
            name: column.detach().to("cpu", copy=True).contiguous()
            for name, column in columns.items()
        }
        content = save(tensors, {_METADATA_KEY: json.dumps(described, sort_keys=True)})
        atomic_write_bytes(self.out / f"{sample.sample_id}{SUFFIX}", content)
