"""Limits of health for JPEG and few beams: `python -m benchmarks.health_limits DATA OUT`.

Limits for PNG pictures and 64 beams (`limits.json`) are made by `sightline health-limits`. The
frames here are sound simulated ones, too, re-encoded as JPEG or thinned to every second or fourth
ring.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import jsonargparse
import numpy as np
import torch

from sightline.corruptions.optics import CameraJpeg
from sightline.data.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.data.sample_dataset import SampleDataset
from sightline.data.sample_files import sweeps_folder
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
    sample_list: str | None = None,
    velodyne: Velodyne = "velodyne_reduced",
    frames: int = 400,
    seed: int = 0,
) -> None:
    """Write limits_jpeg.json, limits_32.json and limits_16.json.

    Args:
        data: KITTI object tree of simulated frames.
        out: Output folder.
        sample_list: List of frames.
        velodyne: Folder of the sweeps, cut to the camera's view.
        frames: Number of frames, from the first.
        seed: Seed of the qualities and of the first ring kept.
    """
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    dataset = open_dataset(
        data, sample_list=sample_list, velodyne=velodyne, parts={"image", "points"}
    )
    count = min(frames, len(dataset))
    for name, every_ring in _EVERY_RING.items():
        is_jpeg = name == "limits_jpeg"
        provenance: dict[str, str | int] = {
            "data": data.resolve().name,
            "sample_list": sample_list or f"the first {count}",
            "sweeps": sweeps_folder(dataset),
            "frames": count,
            "seed": seed,
            "transfer": 1,
            "images": f"JPEG {_QUALITIES[0]} to {_QUALITIES[1]}" if is_jpeg else "PNG",
            "every_ring": every_ring,
        }
        samples = _changed(dataset, count, np.random.default_rng(seed), every_ring, is_jpeg=is_jpeg)
        limits = fit_on_samples(
            track(samples, description=name, total=count),
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
