"""Limits of health for JPEG and few beams: `python -m benchmarks.health_limits DATA OUT`.

Limits for PNG pictures and 64 beams (`limits.json`) are made by `sightline health-limits`. The
frames here are sound simulated ones, too: re-encoded as JPEG, or thinned to every second or fourth
ring, together with frames of an HDL-32E or a VLP-16, whose rings look higher up.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path

import cv2
import jsonargparse
import numpy as np
import torch

from sightline.corruptions.optics import CameraJpeg
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.datasets.sample_files import sweeps_folder
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.health import camera_checks, lidar_checks
from sightline.health.fitting import fit_on_samples
from sightline.health.limits import write_limits
from sightline.health.ring_order import number_rings
from sightline.health.sphere import to_sphere
from sightline.jobs.progress import track
from sightline.structures.sample import CameraLidarSample

_QUALITIES = (75, 95)  # lowest and highest, drawn evenly
_EVERY_RING = {"limits_jpeg": 1, "limits_32": 2, "limits_16": 4}


def main(
    data: Path,
    out: Path,
    hdl_32e: Path,
    vlp_16: Path,
    sample_list: str | None = None,
    velodyne: Velodyne = "velodyne_reduced",
    frames: int = 400,
    seed: int = 0,
) -> None:
    """Write limits_jpeg.json, limits_32.json and limits_16.json.

    Args:
        data: KITTI object tree of simulated frames, 64 beams.
        out: Output folder.
        hdl_32e: The same of an HDL-32E.
        vlp_16: The same of a VLP-16.
        sample_list: List of frames.
        velodyne: Folder of the sweeps, cut to the camera's view.
        frames: Number of frames of each tree, from the first.
        seed: Seed of the qualities and of the first ring kept.
    """
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    trees = {"limits_jpeg": None, "limits_32": hdl_32e, "limits_16": vlp_16}
    for name, own in trees.items():
        is_jpeg, every_ring = own is None, _EVERY_RING[name]
        opened = [
            open_dataset(
                tree, sample_list=sample_list, velodyne=velodyne, parts={"image", "points"}
            )
            for tree in (data, *([own] if own is not None else []))
        ]
        counts = [min(frames, len(dataset)) for dataset in opened]
        provenance: dict[str, str | int] = {
            "data": " and ".join(tree.resolve().name for tree in (data, own) if tree is not None),
            "sample_list": sample_list or f"the first {' and '.join(map(str, counts))}",
            "sweeps": sweeps_folder(opened[0]),
            "frames": sum(counts),
            "seed": seed,
            "transfer": 1,
            "images": f"JPEG {_QUALITIES[0]} to {_QUALITIES[1]}" if is_jpeg else "PNG",
            "every_ring": every_ring,
        }
        rng = np.random.default_rng(seed)
        thinned = _changed(opened[0], counts[0], rng, every_ring, is_jpeg=is_jpeg)
        sound = (dataset[index] for dataset in opened[1:] for index in range(counts[1]))
        limits = fit_on_samples(
            track(chain(thinned, sound), description=name, total=sum(counts)),
            provenance,
            transfer=True,
            camera_spreads=(
                camera_checks.JPEG_MIN_SPREADS if is_jpeg else camera_checks.MIN_SPREADS
            ),
            lidar_spreads=(
                lidar_checks.MIN_SPREADS if every_ring == 1 else lidar_checks.FEW_RINGS_MIN_SPREADS
            ),
        )
        write_limits(out / f"{name}.json", limits)


def _changed(
    dataset: SampleDataset,
    count: int,
    rng: np.random.Generator,
    every_ring: int,
    *,
    is_jpeg: bool,
) -> Iterator[CameraLidarSample]:
    for index in range(count):
        sample = dataset[index]
        quality = int(rng.integers(_QUALITIES[0], _QUALITIES[1] + 1))
        first = int(rng.integers(every_ring))
        if is_jpeg:
            sample = CameraJpeg(quality=quality)(sample, rng)
        if sample.points is not None:
            _, azimuth_deg, _ = to_sphere(sample.points.numpy())
            kept = torch.from_numpy(number_rings(azimuth_deg) % every_ring == first)
            sample = replace(sample, points=sample.points[kept])
        yield sample


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
