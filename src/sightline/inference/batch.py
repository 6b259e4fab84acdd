"""Jobs over whole data sets: one file out for each sample, resumable and in parallel."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from sightline.data.atomic import atomic_write_text
from sightline.data.depth_png import MAX_DEPTH_M, write_depth_png
from sightline.data.object_tree import Velodyne
from sightline.data.open import SampleDataset, open_dataset
from sightline.data.parallel import run_pieces
from sightline.data.progress import track
from sightline.depth_completion.methods import Method
from sightline.inference.depth import DepthCompleter
from sightline.structures.predictions import DepthMap
from sightline.structures.sample import CameraLidarSample

MANIFEST_NAME = "sightline.json"
"""File in an output folder that says what made the others."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Manifest:
    """What made the files of an output folder; files of two makers never share one."""

    task: str
    method: str
    sightline: str
    """Version of the package."""

    def claim(self, folder: Path) -> None:
        """Writes the manifest to an output folder, or sees that it stands there already.

        Raises:
            ValueError: The folder holds PNGs that something else has made, or that nobody knows
                the maker of, or it cannot be written to.
        """
        path = folder / MANIFEST_NAME
        text = json.dumps(asdict(self), indent=2) + "\n"
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
    method: Method,
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
        method: How depth is completed.
        sample_list: Which samples; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder in an object tree.
        workers: Processes that work; 1 is this process alone.
        overwrite: Whether to make files anew that are there already.
        shard_index: Which part of the samples to do, from 0.
        num_shards: Number of parts; each part can be done on another machine, at the same time.

    Raises:
        ValueError: The data cannot be read, `out` holds another method's results or cannot be
            written to, or the numbers of workers and shards make no sense. Errors about a sample
            name it; samples done before stay done.
    """
    if not 0 <= shard_index < num_shards:
        raise ValueError(
            f"shard_index must be between 0 and num_shards - 1, got {shard_index} of {num_shards}"
        )
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne, parts={"points"})
    manifest = Manifest(task="depth-completion", method=method, sightline=version("sightline"))
    return write_depth_maps(
        dataset,
        out,
        DepthCompleter(method),
        manifest=manifest,
        indices=range(shard_index, len(dataset), num_shards),
        workers=workers,
        overwrite=overwrite,
    )


def write_depth_maps(
    dataset: SampleDataset,
    out: Path,
    complete: Callable[[CameraLidarSample], DepthMap],
    *,
    manifest: Manifest,
    indices: Sequence[int],
    workers: int,
    overwrite: bool,
) -> BatchResult:
    """Writes the depth map of each of the samples at `indices` to `out`/SAMPLE.png.

    `predict_depth_completion` says how; `complete` must be picklable where workers are started
    afresh (macOS, Windows).
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out} is no folder; name another output folder")
    names = dataset.sample_ids
    present = set() if overwrite else {path.stem for path in out.glob("*.png")}
    pending = [index for index in indices if names[index] not in present]
    manifest.claim(out)
    piece = _DepthMapPiece(dataset, out, complete, [(index, names[index]) for index in pending])
    errors = run_pieces(piece, len(pending), workers)
    for error in track(errors, description="completing depth", total=len(pending)):
        if error:
            raise ValueError(error)
    return BatchResult(written=len(pending), skipped=len(indices) - len(pending))


@dataclass(frozen=True, slots=True)
class _DepthMapPiece:
    """Completes one of the samples and writes its file; returns the error, empty if none."""

    dataset: SampleDataset
    out: Path
    complete: Callable[[CameraLidarSample], DepthMap]
    samples: Sequence[tuple[int, str]]
    """Index and name of each."""

    def __call__(self, position: int) -> str:
        index, name = self.samples[position]
        try:
            depth_m = self.complete(self.dataset[index]).depth_m.cpu().numpy()
            # One stray return beyond the format's reach must not end the job of a whole data set.
            too_far = np.isfinite(depth_m) & (depth_m > MAX_DEPTH_M)
            write_depth_png(self.out / f"{name}.png", np.where(too_far, np.float32(0), depth_m))
        except (ValueError, OSError) as error:
            return f"sample {name}: {error}"
        return ""
