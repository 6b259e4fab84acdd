"""Surfaces of completed depth, before and after smoothing.

`python -m benchmarks.surface_sheet --weights FILE`: the image of an embedded frame, and below it
the normals of both maps, whose three parts are red, green and blue.
"""

import tempfile
from pathlib import Path

import jsonargparse
import numpy as np
import torch
from jaxtyping import Float, Float32, UInt8

from benchmarks.sheet_file import write_sheet
from sightline.data.open import open_dataset
from sightline.depth_completion.predictor import DepthPredictor
from sightline.files.weights import read_weights, write_weights
from sightline.simulation.packaged import PACKAGED_FRAMES

_MAX_BYTES = 500_000


def main(weights: str, out: Path = Path("docs/pictures/surfaces.jpg"), frame: int = 0) -> None:
    """Write the picture.

    Args:
        weights: Name or file of a depth network that smooths planes; the shipped ones do not.
        out: JPEG file to write.
        frame: Index of the embedded frame.
    """
    torch.set_num_threads(1)
    sample = open_dataset(PACKAGED_FRAMES, parts={"image", "points"})[frame]
    assert sample.image is not None
    camera = sample.calibration.image_from_camera[:, :3].numpy()
    with tempfile.TemporaryDirectory() as folder:
        rough = _without_smoothing(weights, Path(folder))
        maps = [DepthPredictor.load(each)(sample).depth_m.numpy() for each in (rough, weights)]
    panels = [_shaded(depth_m, camera) for depth_m in maps]
    write_sheet(out, np.vstack((sample.image.permute(1, 2, 0).numpy(), *panels)), _MAX_BYTES)


def _without_smoothing(weights: str, folder: Path) -> Path:
    read = read_weights(weights)
    path = folder / "rough.safetensors"
    config = {**read.config, "smoothing": None}
    write_weights(path, read.tensors, task=read.task, config=config, provenance=read.provenance)
    return path


def _shaded(
    depth_m: Float32[np.ndarray, "height width"], camera: Float[np.ndarray, "3 3"]
) -> UInt8[np.ndarray, "height width 3"]:
    """Compute normals from neighbouring pixels, towards the camera: -1 dark, 1 bright."""
    rows, columns = np.mgrid[: depth_m.shape[0], : depth_m.shape[1]]
    rays = np.stack((columns, rows, np.ones_like(rows)), axis=-1) @ np.linalg.inv(camera).T
    points = rays * depth_m[..., None].astype(np.float64)
    normals = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True).clip(min=1e-12)
    return ((1 - normals) * 127).astype(np.uint8)


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)
