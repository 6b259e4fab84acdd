"""Data sources of a training."""

import math
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import accumulate, compress
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool

from sightline.data.checks.truncations import TRUNCATION_REMEDY, TruncationTally
from sightline.data.datasets.sample_dataset import NamedSubset, SampleDataset
from sightline.data.datasets.sample_files import label_file
from sightline.data.formats.kitti_labels import CLASS_NAMES, KittiObjects, read_labels
from sightline.data.layouts.frame_lists import read_sample_list
from sightline.data.layouts.kitti_trees import Part, Velodyne
from sightline.data.open import open_dataset, resolve_split
from sightline.evaluation.object_tally import listed
from sightline.files.plain_text import shortened
from sightline.files.shard_path import data_path, stored_file
from sightline.geometry.arguments import plain_tuple
from sightline.geometry.choices import check_choices
from sightline.geometry.wrong_types import named_arguments
from sightline.jobs.output_dirs import is_split

LearnedBox = Literal["2D", "3D"]
"""Kind of the labelled boxes that a network learns."""

_MIN_HIDDEN = 3  # number of objects that are not all hidden by chance
_VALIDATION_SHARE = 10  # one frame in ten is for validation if there is no list


@dataclass(frozen=True, kw_only=True)
class SourceConfig:
    """Settings of samples from one folder."""

    path: Path
    """Folder of a recording, or KITTI's object tree, depth completion tree or raw drive, including
    simulated ones."""
    sample_list: str | None = None
    """List of frames: a list in ImageSets, kitti-object-train, kitti-object-val or a text file with
    one name per line. None: all. If there is no list train or val, the first tenth of the frames is
    val and the others are train."""
    velodyne: Velodyne | None = None
    """Folder of the sweeps in an object tree. None: velodyne, or else velodyne_reduced."""
    repeat: int = 1
    """Number of times each frame is used per epoch: the weight of this source."""
    with_classes: tuple[str, ...] = ()
    """Filter: only frames with a labelled object of one of these classes, by KITTI's names. A
    separate, repeated source shows rare classes more often. (): all."""

    def __post_init__(self) -> None:
        """Check the choices, the range and the names."""
        check_choices(self)
        object.__setattr__(self, "with_classes", plain_tuple("with_classes", self.with_classes))
        if self.repeat < 1:
            raise ValueError(f"repeat must be at least 1, got {self.repeat}; leave the source out")


@named_arguments
def data_tree(source: SourceConfig, root: Path) -> Path:
    """Canonical folder of a source; that of the whole object tree for its split `training`."""
    path = (root / source.path).resolve()
    is_packed = not path.is_dir()  # a place in shards
    return path.parent if path.name == "training" and (is_packed or is_split(path)) else path


@named_arguments
def open_source(
    source: SourceConfig,
    root: Path,
    parts: Collection[Part],
    *,
    held_out_for: Sequence[str],
    notify: Callable[[str], None],
) -> SampleDataset:
    """Open the samples of a source.

    Args:
        source: Source to open.
        root: Base folder of a relative path.
        parts: Parts of the samples to load.
        held_out_for: Uses of the folder's list `val`: validation, test; empty: none.
        notify: Receives a line on the frames held out from training, if any.

    Raises:
        ValueError: There is no such data, it lacks files, or no frame shows one of `with_classes`.
    """
    path = resolve_split(data_path(root / source.path))
    lists = path.parent if is_split(path) else path
    has_train, has_val = (_has_list(lists, name) for name in ("train", "val"))
    has_lists = (has_val and has_train) or (has_train and not held_out_for)
    frames: str | tuple[str, ...] | None = source.sample_list
    if frames in ("train", "val") and not has_lists and not (has_val and frames == "val"):
        all_frames = (
            read_sample_list("train", lists)
            if has_train
            else open_dataset(path, velodyne=source.velodyne, parts=parts).sample_ids
        )
        num_validated = math.ceil(len(all_frames) / _VALIDATION_SHARE) if held_out_for else 0
        validation = read_sample_list("val", lists) if has_val else all_frames[:num_validated]
        held_out = set(validation)
        training = tuple(frame for frame in all_frames if frame not in held_out)
        if frames == "train" and len(training) < len(all_frames):
            num_held_out = len(all_frames) - len(training)
            notify(
                _held_out_note(path, num_held_out, len(all_frames), held_out_for, has_val=has_val)
            )
        frames = validation if frames == "val" else training
        if not frames:
            raise ValueError(
                f"{path} holds {len(all_frames)} frames, too few for training and validation; use "
                "more, or set the sample_list of the sources to null"
            )
    if source.with_classes and "objects" not in parts:
        raise ValueError(
            f"with_classes {', '.join(source.with_classes)} needs labels, which this task does not "
            "read; leave with_classes out"
        )
    dataset = open_dataset(path, sample_list=frames, velodyne=source.velodyne, parts=parts)
    return _select_frames(dataset, source.with_classes, path) if source.with_classes else dataset


def _held_out_note(
    path: Path, num_held_out: int, num_frames: int, held_out_for: Sequence[str], *, has_val: bool
) -> str:
    """Describe the number of frames held out from training, the reason and the remedy."""
    reason = (
        "its list val has them" if has_val else "it has no list val, so its first tenth is used"
    )
    without = " and ".join(f"--data.init_args.{use} '[]'" for use in held_out_for)
    remedy = "set the training source's sample_list to null" if has_val else f"set {without}"
    use = " and ".join(held_out_for) or "validation"
    return (
        f"{num_held_out} of {num_frames} training frames of {path} are held out for {use}: "
        f"{reason}; to train on them too, {remedy}"
    )


def _select_frames(
    dataset: SampleDataset, class_names: Collection[str], path: Path
) -> SampleDataset:
    """Select the frames that have an object of the classes."""
    files = [label_file(dataset, index) for index in range(len(dataset))]
    if not any(files):
        raise ValueError(
            f"{path} has no labels, needed for with_classes {', '.join(class_names)}; leave it out"
        )
    found: set[str] = set()
    kept = []
    for sample_id, labels in zip(dataset.sample_ids, files, strict=True):
        names = set() if labels is None else set(read_labels(labels).class_names)
        found |= names
        if not names.isdisjoint(class_names):
            kept.append(sample_id)
    absent = sorted(set(class_names) - found)
    if absent:
        raise ValueError(
            f"no frame of {path} has an object of with_classes {', '.join(absent)}; its "
            f"labels have {shortened(', '.join(sorted(found))) or 'none'}; leave this entry out, "
            "such as that of a recipe"
        )
    return NamedSubset(dataset, kept)


@dataclass(frozen=True, kw_only=True, slots=True)
class LabelledClasses:
    """Classes of the objects in the label files of some data sets."""

    absent: tuple[str, ...]
    """Learned classes of which there is no object, in order; none if a data set has no labels."""
    without_box: dict[str, int]
    """Numbers of the objects of learned classes that lack the learned box, by class."""
    hidden: dict[str, int]
    """Numbers of the objects of learned classes, by class, of which a data set has some and all
    have an occlusion above `max_occlusion`."""
    max_occlusion: int | None
    """Largest occlusion of the objects that are learned; None: any."""
    truncations: TruncationTally
    """Counts of the truncations in the files that were read."""
    unknown: dict[str, int]
    """Numbers of the objects by names that are no classes of KITTI, and are not learned."""
    num_objects: int
    """Number of objects, and regions DontCare, in the files that were read."""

    def training_warnings(self, learned: Sequence[str], box: LearnedBox | None) -> list[str]:
        """Describe what training learns as background, or cannot learn.

        Args:
            learned: Learned classes.
            box: Kind of box that is learned.
        """
        found = []
        if self.unknown:  # scores ignore case
            found.append(
                f"warning: in the labels of the training frames {sum(self.unknown.values()):,} of "
                f"the {self.num_objects:,} objects that were read have names that are no classes "
                f"of KITTI ({listed(self.unknown)}; capitals count): they are learned as "
                "background; correct the names (sightline check)"
            )
        partly = {name: n for name, n in self.without_box.items() if name not in self.absent}
        if partly:
            found.append(
                f"warning: the labels of the training frames have no {box} box for "
                f"{sum(partly.values()):,} of the {self.num_objects:,} objects that were read "
                f"({listed(partly)}): they are learned as background; add their boxes, or leave "
                "out their frames by the sample_list of their source"
            )
        doubt = self.truncations.doubt()
        if doubt is not None and box == "2D":
            found.append(
                f"warning: the labels of the training frames {doubt}; the image detector does not "
                f"learn such objects; {TRUNCATION_REMEDY}"
            )
        if self.hidden:
            found.append(
                "warning: in the labels of the training frames all objects of a class and data set "
                f"have an occlusion above {self.max_occlusion} ({listed(self.hidden)}; 3 is "
                "unknown): they are not learned; write 0 where it is not known, or raise the "
                "preparation's targets.max_occlusion"
            )
        effect = "these classes are learned as background"
        if len(self.absent) == len(learned):
            effect = "there is nothing to learn"
        return found + self._absence_warnings("training", box, effect, self.absent)

    def scoring_warnings(
        self, name: str, learned: Sequence[str], box: LearnedBox | None
    ) -> list[str]:
        """Describe which scores of `name` (validation, test) say nothing; they ignore case."""
        lower = {each.lower() for each in self.absent}
        spelled = {each: n for each, n in self.unknown.items() if each.lower() in lower}
        scored = {each.lower() for each in spelled}
        absent = [each for each in self.absent if each.lower() not in scored]
        of_these = "" if len(absent) == len(learned) else " of these classes"
        found = self._absence_warnings(name, box, f"the scores{of_these} say nothing", absent)
        if spelled:
            found.append(
                f"warning: the labels of the {name} frames have other capitals than the learned "
                f"classes ({listed(spelled)}): scores count these objects, training learns them as "
                "background; correct the names (sightline check)"
            )
        return found

    def _absence_warnings(
        self, name: str, box: LearnedBox | None, effect: str, absent: Sequence[str]
    ) -> list[str]:
        if not absent:
            return []
        with_box = "" if box is None else f" with a {box} box"
        return [
            f"warning: the labels of the {name} frames have no object of "
            f"{', '.join(absent)}{with_box}: {effect}; check the labels and the names of "
            "their classes (sightline check)"
        ]


@named_arguments
def labelled_classes(
    datasets: Sequence[SampleDataset],
    class_names: Sequence[str],
    box: LearnedBox | None = None,
    *,
    max_occlusion: int | None = None,
    count_all: bool = False,
) -> LabelledClasses:
    """Find which classes the label files of some data sets have, and which they lack.

    Files are read until each learned class has been found; with `count_all` the others are read,
    too, except for those on a server.

    Args:
        datasets: Data sets; a file that several have counts once.
        class_names: Learned classes.
        box: Kind of box without which an object does not count for a learned class. None: none.
        max_occlusion: Largest occlusion of the objects that are learned. None: any.
        count_all: Whether to read all files.

    Raises:
        FileError: A label file is damaged.
    """
    listed_files = [[label_file(each, index) for index in range(len(each))] for each in datasets]
    absent, counts, without_box = set(class_names), Counter[str](), Counter[str]()
    in_set, hidden_in_set = Counter[tuple[int, str]](), Counter[tuple[int, str]]()
    truncations = TruncationTally()
    for file, place in _first_places(listed_files).items():
        if not absent and (not count_all or stored_file(file) is None):
            continue
        objects = read_labels(file)
        names = objects.class_names
        counts.update(names)
        truncations.add(objects)
        has_box = _has_box(objects, box)
        absent -= set(compress(names, has_box.tolist()))
        without_box.update(compress(names, (~has_box).tolist()))
        in_set.update((place, name) for name in names)
        is_hidden = objects.occlusion > (math.inf if max_occlusion is None else max_occlusion)
        hidden_in_set.update((place, name) for name in compress(names, is_hidden.tolist()))
    hidden = Counter[str]()
    for (place, name), count in hidden_in_set.items():
        if name in class_names and count == in_set[place, name] and count >= _MIN_HIDDEN:
            hidden[name] += count
    known = {*CLASS_NAMES, "DontCare", *class_names}
    return LabelledClasses(
        absent=tuple(name for name in class_names if name in absent)
        if all(map(any, listed_files))
        else (),
        without_box={name: count for name, count in without_box.items() if name in class_names},
        hidden=dict(hidden),
        max_occlusion=max_occlusion,
        truncations=truncations,
        unknown={name: count for name, count in counts.items() if name not in known},
        num_objects=counts.total(),
    )


def _first_places(listed_files: Sequence[Sequence[Path | None]]) -> dict[Path, int]:
    """Map each label file to the first data set that has it."""
    places: dict[Path, int] = {}
    for place, files in enumerate(listed_files):
        for file in files:
            if file is not None:
                places.setdefault(file, place)
    return places


def _has_box(objects: KittiObjects, box: LearnedBox | None) -> Bool[np.ndarray, " num_objects"]:
    if box is None:
        return np.ones(len(objects.class_names), dtype=bool)
    extents = objects.boxes2d[:, 2:] - objects.boxes2d[:, :2]
    sizes = extents if box == "2D" else objects.dimensions_hwl
    return np.asarray((sizes > 0).all(axis=1))


@named_arguments
def unscored_note(
    name: str, sources: Sequence[SourceConfig], num_frames: Sequence[int], num_scored: int
) -> str | None:
    """Describe the frames of validation or test that the Trainer's limit leaves out; None: none.

    Args:
        name: Use of the frames: validation, test.
        sources: Sources in the order of scoring.
        num_frames: Number of frames of each.
        num_scored: Number of scored frames, the first ones.
    """
    total = sum(num_frames)
    if num_scored >= total:
        return None
    starts = accumulate(num_frames, initial=0)
    unscored = [
        str(each.path) for each, start in zip(sources, starts, strict=False) if start >= num_scored
    ]
    none_of = f", none of {', '.join(unscored)}" if unscored else ""
    flag = f"--trainer.limit_{'val' if name == 'validation' else name}_batches"
    return (
        f"{num_scored:,} of the {total:,} {name} frames are scored, the first ones{none_of} "
        f"({flag}, which a recipe may set; {flag} 1.0 scores all)"
    )


def _has_list(folder: Path, name: str) -> bool:
    return (folder / "ImageSets" / f"{name}.txt").is_file()
