"""Remarks on drawn result files: counts of drawn objects, and doubts about their convention."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import torch
from torch import Tensor

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.datasets.sample_files import label_file
from sightline.data.formats.kitti_labels import parse_objects, read_labels, read_results
from sightline.evaluation.object_tally import ObjectTally
from sightline.perception.results import ResultFolder
from sightline.structures.predictions import Perception

_KINDS = {"objects": "joined objects", "detections2d": "2D boxes", "detections3d": "3D boxes"}
_OBJECT_SUFFIX = ".txt"


def count_drawn(perceptions: Sequence[Perception], min_score: float) -> Iterator[str]:
    """Yield the number of drawn objects of each kind that results hold, where some are left out.

    Args:
        perceptions: All results of the drawn frames.
        min_score: Score threshold of drawn objects.
    """
    for kind, name in _KINDS.items():
        found = [getattr(each, kind) for each in perceptions]
        scores = torch.cat([torch.empty(0), *(each.scores for each in found if each is not None)])
        drawn = int((scores >= min_score).sum())
        if drawn < len(scores):
            yield f"{drawn:,} of {len(scores):,} {name} drawn{_reason(scores, drawn, min_score)}"


def _reason(scores: Tensor, drawn: int, min_score: float) -> str:
    if drawn:
        return f", those with a score of {min_score:g} or more (--min-score)"
    return f": the highest score is {float(scores.max()):.3g}, give --min-score below {min_score:g}"


def doubts_about_shown(
    results: Sequence[ResultFolder], dataset: SampleDataset
) -> Iterator[tuple[Path, str]]:
    """Yield doubts about KITTI's result files of all frames, as the object evaluation has them.

    Compared with the labels of the frames that have some.

    Args:
        results: Folders of result files.
        dataset: The drawn frames.
    """
    of_objects = {each.folder: each for each in results if each.suffix == _OBJECT_SUFFIX}
    for folder, each in of_objects.items():
        tally = ObjectTally()
        for index, name in enumerate(dataset.sample_ids):
            if (path := each.path(name)).is_file():
                labels = label_file(dataset, index)
                none = parse_objects(b"", path, with_scores=False)
                tally.add(read_results(path), none if labels is None else read_labels(labels))
        for doubt in tally.doubts_about_conventions():
            if doubt.text.startswith("WARNING: "):  # others are of scores
                yield folder, doubt.text.removeprefix("WARNING: ")
