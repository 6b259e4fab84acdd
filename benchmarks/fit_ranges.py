"""Fit of the distances of lifted image boxes: `python -m benchmarks.fit_ranges OUT DATA LISTS`.

Takes the labels of simulated frames, their boxes moved as a detector's are; no detector runs.
Included are those of src/sightline/weights/lifted_ranges.json.
"""

import json
from importlib.metadata import version
from pathlib import Path

import jsonargparse

from sightline.data.open import open_dataset
from sightline.files.atomic import atomic_write_text
from sightline.joining.range_fitting import fit_ranges
from sightline.joining.ranges import RANGE_COLUMNS


def main(out: Path, data: tuple[Path, ...], lists: tuple[str, ...]) -> None:
    """Fit and write the weights.

    Args:
        out: File of the weights (.json).
        data: KITTI object trees with labels.
        lists: For each, a list of frames in ImageSets, or a text file with one name a line.
    """
    datasets = [
        open_dataset(tree, sample_list=each, parts=("image", "objects"), needs=())
        for tree, each in zip(data, lists, strict=True)
    ]
    ranges = fit_ranges(samples[index] for samples in datasets for index in range(len(samples)))
    content = {
        "frames": {
            tree.name: ",".join(samples.sample_ids)
            for tree, samples in zip(data, datasets, strict=True)
        },
        "sightline": version("sightline"),
        "columns": RANGE_COLUMNS,
        "ranges": ranges,
    }
    atomic_write_text(out, json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
