"""Counts of unscored results and labels of an object evaluation, for its remarks."""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

import numpy as np
from jaxtyping import Int8

from sightline.data.checks.label_checks import impossible_values, in_degrees
from sightline.data.checks.truncations import TRUNCATION_REMEDY, TruncationTally
from sightline.data.formats.kitti_labels import (
    MAX_OCCLUSION,
    MAX_TRUNCATION,
    NO_LOCATION,
    UNKNOWN,
    KittiObjects,
)
from sightline.data.layouts.frame_lists import is_note
from sightline.evaluation.kitti_object_rules import (
    CLASSES,
    MIN_HEIGHT_PX,
    NEVER,
    class_code,
    truth_levels,
)
from sightline.evaluation.result_conventions import Remark, ResultConventions
from sightline.files.plain_text import shortened

KITTI_CLASSES: Final = frozenset(
    {"van", "truck", "person_sitting", "tram", "misc", "dontcare", *map(str.lower, CLASSES)}
)
"""KITTI's own classes: their labels are no sign of a mistake."""
NOTHING_LABELLED: Final = (
    f"WARNING: no label is of a scored class ({', '.join(CLASSES)}): nothing can be found, and "
    "every result is a false one."
)
"""Remark on labels without an object to find."""
OTHER_CLASSES: Final = "KITTI's other classes"
"""Kind of the doubt about some results of KITTI's unscored classes, as Van: no mistake."""
_MIN_EMPTY: Final = 2
_MIN_LOST_SHARE: Final = 0.05
"""Minimum number of empty files, and of the objects or frames that they concern, for a remark."""
_OTHER: Final = "other"  # kind of doubts that are not told apart
_MAX_NAMES = 5  # maximum number of names in a sentence


@dataclass(frozen=True, kw_only=True, slots=True)
class ResultDoubt:
    """Doubt about result files, with its kind."""

    kind: str
    """Cause without counts: equal for the same cause in other evaluations."""
    text: str
    """Sentence with counts."""
    is_convention: bool = False
    """True if the writer of the files is at fault, and no faulty sensor can be."""
    is_total: bool = False
    """True if none of the results can match a label, so that every score of the method is 0."""


@dataclass(slots=True)
class ObjectTally:
    """Counts of results and labels over all frames, by class as written."""

    results: Counter[str] = field(default_factory=Counter)
    labels: Counter[str] = field(default_factory=Counter)
    without_box3d: int = 0
    """Number of results of scored classes without a 3D part."""
    results_in_degrees: int = 0
    """Number of results with an angle beyond two pi."""
    uncounted_labels: Counter[int] = field(default_factory=Counter)
    """Number of labels of each scored class (code) that count at no difficulty."""
    hidden_labels: int = 0
    """Number of those by their occlusion or truncation; the others are too low in the image."""
    labels_of_unknown_visibility: int = 0
    """Number of labels of scored classes with neither truncation nor occlusion."""
    labels_without_box3d: int = 0
    """Number of labels of scored classes without a 3D part."""
    labels_in_degrees: int = 0
    """Number of labels with such an angle."""
    impossible_labels: Counter[str] = field(default_factory=Counter)
    """Number of labels with values that no label has, by the fault."""
    repeated_labels: int = 0
    """Number of labels of scored classes that are equal to an earlier one of their frame."""
    counts_empty: bool = True
    """True if each frame without a result has an empty result file, false if some have no file."""
    without_results: list[Counter[int]] = field(default_factory=list)
    """Number of labels of each class (code) to be found in each frame without a result."""
    best_scores: list[float] = field(default_factory=list)
    """Best score of each frame with labels and results."""
    unlabelled_scores: list[float] = field(default_factory=list)
    """Best score of each frame with results whose label file is empty."""
    truncations: TruncationTally = field(default_factory=TruncationTally)
    """Counts of the labels' truncations."""
    conventions: ResultConventions = field(default_factory=ResultConventions)

    def add(self, results: KittiObjects, labels: KittiObjects) -> None:
        """Count a frame."""
        self.results.update(results.class_names)
        self.labels.update(labels.class_names)
        self.conventions.add(results, labels)
        self.truncations.add(labels)
        self.results_in_degrees += int(in_degrees(results).sum())
        self.labels_in_degrees += int(in_degrees(labels).sum())
        self.without_box3d += _count_without_box3d(results)
        self.labels_without_box3d += _count_without_box3d(labels)
        faults = impossible_values(labels).items()
        self.impossible_labels.update({fault: int(faulty.sum()) for fault, faulty in faults})
        self.repeated_labels += self.conventions.labels[-1].num_repeated()
        levels = truth_levels(labels.truncation, labels.occlusion, labels.boxes2d)
        is_hidden = (labels.occlusion > MAX_OCCLUSION) | (labels.truncation > MAX_TRUNCATION)
        is_unknown = (labels.occlusion == UNKNOWN) & (labels.truncation == UNKNOWN)
        self._add_empty(results, labels, levels)
        flags = zip(labels.class_names, levels, is_hidden, is_unknown, strict=True)
        for name, level, hidden, unknown in flags:
            if class_code(name) < 0:
                continue
            self.labels_of_unknown_visibility += int(unknown)
            if level == NEVER:
                self.uncounted_labels[class_code(name)] += 1
                self.hidden_labels += int(hidden)

    def _add_empty(
        self, results: KittiObjects, labels: KittiObjects, levels: Int8[np.ndarray, " num_labels"]
    ) -> None:
        """Count a frame whose file of results or of labels is empty, or neither."""
        if len(results):
            assert results.scores is not None, "results have scores"
            scores = self.best_scores if len(labels) else self.unlabelled_scores
            scores.append(float(results.scores.max()))
        else:
            codes = map(class_code, labels.class_names)
            pairs = zip(codes, levels, strict=True)
            self.without_results.append(
                Counter(code for code, level in pairs if code >= 0 and level != NEVER)
            )

    def remarks(self, *, in_space: bool = True) -> tuple[str, ...]:
        """List remarks on unscored results and labels; empty if there are none.

        Args:
            in_space: Whether 3D boxes are scored.
        """
        found, labelled = by_code(self.results), by_code(self.labels)
        remarks = []
        if not self.results.total():
            remarks.append("WARNING: the result files hold no object at all.")
        if not labelled:
            remarks.append(NOTHING_LABELLED)
        for code in sorted(labelled.keys() - found.keys()):
            missed = f"{labelled[code]:,} labelled objects are all missed"
            missed = "one labelled object is missed" if labelled[code] == 1 else missed
            remarks.append(
                f"No result is of {CLASSES[code]}: its {missed}. A table without any result of a "
                "class leaves it out, as KITTI's does."
            )
        lost = self.lost_results(in_space=in_space)
        return (*remarks, *(each.text for each in (*lost, *self.other_doubts())))

    def lost_results(
        self, classes: Collection[str] = CLASSES, *, in_space: bool = True
    ) -> tuple[ResultDoubt, ...]:
        """List results that cannot match a label; empty if there are none.

        Args:
            classes: Classes that are scored.
            in_space: Whether 3D boxes are scored.
        """
        found, labelled = by_code(self.results), by_code(self.labels)
        total = self.results.total()
        lost = []
        unscored = {name: n for name, n in self.results.items() if class_code(name) < 0}
        if unscored:
            count = sum(unscored.values())
            text = (
                f"{count:,} of {total:,} results were left out: their classes are not scored "
                f"({listed(unscored)}; {', '.join(CLASSES)} are)."
            )
            is_usual = count < total and all(name.lower() in KITTI_CLASSES for name in unscored)
            kind = OTHER_CLASSES if is_usual else "class"
            lost.append(ResultDoubt(kind=kind, text=text, is_total=count == total))
        for code in sorted(found.keys() - labelled.keys() if labelled else ()):
            if CLASSES[code] in classes:
                text = f"No label is of {CLASSES[code]}: its {found[code]:,} results cannot match."
                is_total = found[code] == total
                lost.append(ResultDoubt(kind=CLASSES[code], text=text, is_total=is_total))
        if in_space and self.without_box3d:
            text = (
                f"{self.without_box3d:,} of {found.total():,} results of scored classes have "
                "no 3D part: they match nothing in bird's eye and 3D."
            )
            is_total = self.without_box3d == found.total()
            lost.append(ResultDoubt(kind="no 3D part", text=text, is_total=is_total))
        return tuple(lost)

    def other_doubts(self) -> tuple[ResultDoubt, ...]:
        """List doubts about labels and about conventions; empty: none."""
        of_labels = (
            *self._remarks_on_labels(),
            *self._remarks_on_impossible_labels(),
            *self._remarks_on_uncounted_labels(),
            *self._remarks_on_visibility(),
            *self._remarks_on_empty_files(),
        )
        doubts = (ResultDoubt(kind=_OTHER, text=text) for text in of_labels)
        return (*doubts, *self.doubts_about_conventions())

    def doubts_about_conventions(self) -> tuple[ResultDoubt, ...]:
        """List doubts about angles, boxes and scores in another convention; empty: none."""
        self.conventions.in_degrees = self.results_in_degrees > 0
        is_most = self.results_in_degrees > self.results.total() / 2
        angles = (Remark(each, "degrees" * is_most) for each in self._remarks_on_angles())
        return tuple(
            ResultDoubt(kind=convention or _OTHER, text=text, is_convention=bool(convention))
            for text, convention in (*angles, *self.conventions.remarks())
        )

    def _remarks_on_labels(self) -> tuple[str, ...]:
        """List a remark on labels of unknown classes; empty if there are none."""
        unknown = {name: n for name, n in self.labels.items() if name.lower() not in KITTI_CLASSES}
        if not unknown:
            return ()
        return (
            f"{sum(unknown.values()):,} of {self.labels.total():,} labels were left out: "
            f"their classes are none of KITTI's ({listed(unknown)}).",
        )

    def _remarks_on_impossible_labels(self) -> tuple[str, ...]:
        """List a remark on labels with values that no label has; empty if there are none."""
        faults = [f"{n:,} have {fault}" for fault, n in self.impossible_labels.items() if n]
        if self.repeated_labels:
            faults.append(f"{self.repeated_labels:,} repeat an earlier one of their frame")
        if not faults:
            return ()
        return (
            f"WARNING: of {self.labels.total():,} labels {', '.join(faults)}: they count as "
            "missed, twice or not at all; run `sightline check` on their data set.",
        )

    def _remarks_on_uncounted_labels(self) -> Iterator[str]:
        """Yield remarks on labels of scored classes that count nowhere, or not in 3D."""
        labelled = by_code(self.labels)
        total, uncounted = labelled.total(), self.uncounted_labels.total()
        if total and uncounted == total:
            yield (
                f"WARNING: none of the {total:,} labels of scored classes counts at any "
                f"difficulty: {self.hidden_labels:,} have an occlusion above {MAX_OCCLUSION} "
                f"(3 is unknown) or a truncation above {MAX_TRUNCATION}, the others are at most "
                f"{MIN_HEIGHT_PX[-1]} px high. Correct the labels: there is no score without one."
            )
        else:
            lost = [code for code, n in labelled.items() if n == self.uncounted_labels[code]]
            for code in sorted(lost):
                yield (
                    f"No label of {CLASSES[code]} ({labelled[code]:,}) counts at any difficulty, "
                    "by occlusion, truncation or height in the image."
                )
        doubt = self.truncations.doubt()
        if doubt is not None:
            yield (
                f"WARNING: the labels {doubt}; objects above {MAX_TRUNCATION} are ignored. In the "
                f"labels, {TRUNCATION_REMEDY}."
            )
        if self.labels_without_box3d:
            yield (
                f"{self.labels_without_box3d:,} of {total:,} labels of scored classes have no 3D "
                "part: nothing matches them in bird's eye and 3D, where they count as missed."
            )

    def _remarks_on_visibility(self) -> tuple[str, ...]:
        """List a remark on labels without truncation and occlusion; empty if there are none."""
        if not self.labels_of_unknown_visibility:
            return ()
        return (
            f"{self.labels_of_unknown_visibility:,} of {by_code(self.labels).total():,} labels of "
            "scored classes have no truncation and no occlusion (-1 -1): they count as fully "
            "visible, so for them easy, moderate and hard differ by height in the image alone.",
        )

    def _remarks_on_empty_files(self) -> Iterator[str]:
        """Yield remarks on empty files that many labels, or sure results, contradict."""
        classes = by_code(self.results)
        lost = [sum(frame[code] for code in classes) for frame in self.without_results]
        num_files, num_lost = sum(map(bool, lost)), sum(lost)
        labelled = by_code(self.labels)
        total = sum(labelled[code] - self.uncounted_labels[code] for code in classes)
        num_frames = len(self.conventions.results)
        if self.counts_empty and num_files >= _MIN_EMPTY and num_lost >= _MIN_LOST_SHARE * total:
            yield (
                f"{num_files:,} of {num_frames:,} result files hold no object, though the labels "
                f"of their frames hold {num_lost:,} of the {total:,} objects to be found: look "
                "whether they were written to the end."
            )
        num_files = len(self.unlabelled_scores)
        if num_files < max(_MIN_EMPTY, _MIN_LOST_SHARE * num_frames) or not self.best_scores:
            return
        usual = np.quantile(self.best_scores, 0.25)
        num_sure = sum(score >= usual for score in self.unlabelled_scores)
        if num_sure > num_files / 2:
            yield (
                f"{num_files:,} of {num_frames:,} label files hold no object, though in "
                f"{num_sure:,} of their frames the best result is as sure as in others: every "
                "result there is a false one; look whether they were written to the end."
            )

    def _remarks_on_angles(self) -> tuple[str, ...]:
        """List a remark on angles in degrees; empty if there are none."""
        if not (self.results_in_degrees or self.labels_in_degrees):
            return ()
        return (
            f"WARNING: {self.labels_in_degrees:,} of {self.labels.total():,} labels and "
            f"{self.results_in_degrees:,} of {self.results.total():,} results have angles beyond "
            "two pi, probably degrees: they were taken for radians, as KITTI's files have them.",
        )


def tallied(
    frames: Iterable[tuple[KittiObjects, KittiObjects]], tally: ObjectTally
) -> Iterator[tuple[KittiObjects, KittiObjects]]:
    """Yield results and labels of each frame, and count them."""
    for results, labels in frames:
        tally.add(results, labels)
        yield results, labels


def unread_files(results_dir: Path, labels_dir: Path, names: Sequence[str]) -> tuple[str, ...]:
    """List remarks on unread files when all frames with labels are scored."""
    return unread_labels(labels_dir) + unread_results(results_dir, names)


def unread_results(
    results_dir: Path,
    names: Sequence[str],
    suffix: str = ".txt",
    partner: Literal["label file", "frame"] = "label file",
) -> tuple[str, ...]:
    """List a remark on result files of no scored frame; empty if there are none."""
    expected = {f"{name}{suffix}" for name in names}
    extra = sorted(
        path.name
        for path in results_dir.iterdir()
        if path.suffix.lower() == suffix
        and path.name not in expected
        and not path.name.startswith(".")
        and not is_note(path.stem)
    )
    if not extra:
        return ()
    return (
        f"{len(extra):,} result files were left out: no {partner} has their name (the first is "
        f"{shortened(extra[0])}).",
    )


def unread_labels(labels_dir: Path) -> tuple[str, ...]:
    """List a remark on label files with another suffix than `.txt`; empty if there are none."""
    extra = sorted(
        path.name
        for path in labels_dir.iterdir()
        if path.suffix.lower() == ".txt"
        and path.suffix != ".txt"
        and not path.name.startswith(".")
        and not is_note(path.stem)
    )
    if not extra:
        return ()
    return (
        f"{len(extra):,} label files were left out: they end in {Path(extra[0]).suffix}, not .txt "
        f"(the first is {shortened(extra[0])}).",
    )


def _count_without_box3d(objects: KittiObjects) -> int:
    """Count the objects of scored classes without a 3D part."""
    lacks_3d = (objects.dimensions_hwl <= 0).any(axis=1)
    lacks_3d |= (objects.locations == NO_LOCATION).any(axis=1)
    scored = (class_code(name) >= 0 for name in objects.class_names)
    return sum(is_scored and bool(each) for is_scored, each in zip(scored, lacks_3d, strict=True))


def by_code(counts: Counter[str]) -> Counter[int]:
    """Count the objects of the scored classes."""
    coded: Counter[int] = Counter()
    for name, count in counts.items():
        if class_code(name) >= 0:
            coded[class_code(name)] += count
    return coded


def listed(counts: dict[str, int]) -> str:
    """List the most frequent names with their numbers."""
    ranked = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    parts = [f"{shortened(ascii(name)[1:-1], 24)} {count:,}" for name, count in ranked[:_MAX_NAMES]]
    return ", ".join(parts) + (", ..." if len(ranked) > _MAX_NAMES else "")
