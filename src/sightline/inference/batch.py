"""Jobs over whole data sets: one file out for each sample, resumable and in parallel."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from sightline.data.atomic import atomic_write_text
from sightline.data.depth_png import MAX_DEPTH_M, write_depth_png
from sightline.data.object_tree import Velodyne
from sightline.data.open import SampleDataset, open_dataset
from sightline.data.parallel import run_pieces
from sightline.data.progress import track
from sightline.depth_completion.methods import Method
from sightline.export.engines import EngineName
from sightline.inference.depth import Completer, DepthPredictor, choose_completer
from sightline.structures.predictions import DepthMap
from sightline.structures.sample import CameraLidarSample

MANIFEST_NAME = "sightline.json"
"""File in an output folder that says what made the others."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Manifest:
    """What made the files of an output folder; files of two makers never share one."""

    task: str
    method: str
    """Name of the method or of the weights."""
    sightline: str
    """Version of the package."""
    weights_sha256: str | None = None
    """Of the weights' file; None for a method without weights."""
    engine: str | None = None
    """What ran the network; None for a method without weights."""

    def claim(self, folder: Path) -> None:
        """Writes the manifest to an output folder, or sees that it stands there already.

        Raises:
            ValueError: The folder holds PNGs that something else has made, or that nobody knows
                the maker of, or it cannot be written to.
        """
        path = folder / MANIFEST_NAME
        known = {name: value for name, value in asdict(self).items() if value is not None}
        text = json.dumps(known, indent=2) + "\n"
        there = path.read_text(errors="replace") if path.is_file() else None
        if there == text:
            return
        if any(folder.glob("*.png")):
            maker = "something else" if there is None else " ".join(there.split())
            raise ValueError(
                f"{folder} holds PNGs made by {maker}, which would mix with those of {self.method} "
                f"(sightline {self.sightline}); name another output folder or empty this one"
            )
        atomic_write_text(path, text)


@dataclass(frozen=True, kw_only=True, slots=True)
class BatchResult:
    """What a job did."""

    written: int
    skipped: int
    """Samples whose file was there already."""


def predict_depth_completion(
    data: Path,
    out: Path,
    *,
    method: Method | None = None,
    weights: str | Path | None = None,
    engine: EngineName = "torch",
    device: str = "cpu",
    uncertainty: Path | None = None,
    sample_list: str | Path | Sequence[str] | None = None,
    velodyne: Velodyne = "velodyne",
    workers: int = 2,
    overwrite: bool = False,
    shard_index: int = 0,
    num_shards: int = 1,
) -> BatchResult:
    """Completes the depth of every sample of a KITTI object tree, depth tree or raw drive.

    Writes `out`/SAMPLE.png, 16-bit depth PNGs of the image's full size, and `out`/sightline.json,
    which says what made them. A file appears whole or not at all, and those that are there are
    skipped, so a job that was stopped goes on where it was: run it again. A depth beyond the 256 m
    that KITTI's format holds becomes 0, no value.

    Args:
        data: Folder of the data set; see `open_dataset`.
        out: Output folder; made where it is missing.
        method: How depth is completed without a network; see `choose_completer`.
        weights: The network; see `load_network`.
        engine: What runs the network.
        device: Where the network runs.
        uncertainty: Another folder, for the expected absolute errors in the same format and under
            the same names.
        sample_list: Which samples; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder in an object tree.
        workers: Processes that work; 1 is this process alone. Several run a network on one thread
            each.
        overwrite: Whether to make files anew that are there already.
        shard_index: Which part of the samples to do, from 0.
        num_shards: Number of parts; each part can be done on another machine, at the same time.

    Raises:
        ValueError: The data cannot be read, `out` holds another method's results or cannot be
            written to, the method has no estimate of its error, or the numbers of workers and
            shards make no sense. Errors about a sample name it; samples done before stay done.
    """
    if not 0 <= shard_index < num_shards:
        raise ValueError(
            f"shard_index must be between 0 and num_shards - 1, got {shard_index} of {num_shards}"
        )
    completer = choose_completer(
        method=method,
        weights=weights,
        engine=engine,
        device=device,
        threads=None if workers == 1 else 1,
    )
    if uncertainty is not None and not completer.estimates_uncertainty:
        raise ValueError(
            f"{completer.name} has no estimate of its error to write to {uncertainty}; name "
            "weights of a network that has one, or leave the uncertainty out"
        )
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne, parts=completer.parts)
    return write_depth_maps(
        dataset,
        out,
        completer,
        uncertainty=uncertainty,
        manifest=_manifest(completer),
        indices=range(shard_index, len(dataset), num_shards),
        workers=workers,
        overwrite=overwrite,
    )


def _manifest(completer: Completer) -> Manifest:
    manifest = Manifest(
        task="depth-completion", method=completer.name, sightline=version("sightline")
    )
    if isinstance(completer, DepthPredictor):
        return replace(manifest, weights_sha256=completer.sha256, engine=completer.engine)
    return manifest


def write_depth_maps(
    dataset: SampleDataset,
    out: Path,
    complete: Callable[[CameraLidarSample], DepthMap],
    *,
    manifest: Manifest,
    indices: Sequence[int],
    workers: int,
    overwrite: bool,
    uncertainty: Path | None = None,
) -> BatchResult:
    """Writes the depth map of each of the samples at `indices` to `out`/SAMPLE.png.

    `predict_depth_completion` says how; `complete` must be picklable where workers are started
    afresh (macOS, Windows), and give an uncertainty where there is a folder for it.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    tasks = {out: manifest.task}
    if uncertainty is not None:
        tasks[uncertainty] = "depth-uncertainty"
        if out.resolve() == uncertainty.resolve():
            raise ValueError(
                f"{out} cannot hold both depth and uncertainty, whose files have the same names; "
                "name another folder for one of them"
            )
    for folder in tasks:
        if folder.exists() and not folder.is_dir():
            raise ValueError(f"{folder} is no folder; name another output folder")
    names = dataset.sample_ids
    present = set.intersection(*({path.stem for path in folder.glob("*.png")} for folder in tasks))
    pending = [index for index in indices if overwrite or names[index] not in present]
    for folder, task in tasks.items():
        replace(manifest, task=task).claim(folder)
    samples = [(index, names[index]) for index in pending]
    piece = _DepthMapPiece(dataset, out, uncertainty, complete, samples)
    errors = run_pieces(piece, len(pending), workers)
    for error in track(errors, description="completing depth", total=len(pending)):
        if error:
            raise ValueError(error)
    return BatchResult(written=len(pending), skipped=len(indices) - len(pending))


@dataclass(frozen=True, slots=True)
class _DepthMapPiece:
    """Completes one of the samples and writes its files; returns the error, empty if none."""

    dataset: SampleDataset
    out: Path
    uncertainty: Path | None
    complete: Callable[[CameraLidarSample], DepthMap]
    samples: Sequence[tuple[int, str]]
    """Index and name of each."""

    def __call__(self, position: int) -> str:
        index, name = self.samples[position]
        try:
            depth = self.complete(self.dataset[index])
            if self.uncertainty is not None:
                assert depth.uncertainty_m is not None, "the caller has asked for it"
                known_m = torch.where(depth.uncertainty_m.isinf(), 0.0, depth.uncertainty_m)
                _write_png(self.uncertainty / f"{name}.png", known_m)
            _write_png(self.out / f"{name}.png", depth.depth_m)
        except (ValueError, OSError) as error:
            return f"sample {name}: {error}"
        return ""


def _write_png(path: Path, values_m: Float32[Tensor, "height width"]) -> None:
    values = values_m.cpu().numpy()
    # One stray return beyond the format's reach must not end the job of a whole data set.
    too_far = np.isfinite(values) & (values > MAX_DEPTH_M)
    write_depth_png(path, np.where(too_far, np.float32(0), values))
