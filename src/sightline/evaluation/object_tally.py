"""Counts of unscored results and labels of an object evaluation, for its remarks."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from sightline.data.kitti_labels import NO_LOCATION, KittiObjects
from sightline.data.label_checks import in_degrees
from sightline.evaluation.kitti_object_rules import CLASSES, class_code
from sightline.evaluation.result_conventions import ResultConventions
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
_MAX_NAMES = 5  # maximum number of names in a sentence


@dataclass(slots=True)
class ObjectTally:
    """Counts of results and labels over all frames, by class as written."""

    results: Counter[str] = field(default_factory=Counter)
    labels: Counter[str] = field(default_factory=Counter)
    without_box3d: int = 0
    """Number of results of scored classes without a 3D part."""
    results_in_degrees: int = 0
    """Number of results with an angle beyond two pi."""
    labels_in_degrees: int = 0
    """Number of labels with such an angle."""
    conventions: ResultConventions = field(default_factory=ResultConventions)
    convention_remarks: tuple[str, ...] = field(default=(), init=False)
    """Remarks on boxes and scores in other conventions, from `remarks`."""

    def add(self, results: KittiObjects, labels: KittiObjects) -> None:
        """Count a frame."""
        self.results.update(results.class_names)
        self.labels.update(labels.class_names)
        self.conventions.add(results, labels)
        self.results_in_degrees += int(in_degrees(results).sum())
        self.labels_in_degrees += int(in_degrees(labels).sum())
        lacks_3d = (results.dimensions_hwl <= 0).any(axis=1)
        lacks_3d |= (results.locations == NO_LOCATION).any(axis=1)
        scored = (class_code(name) >= 0 for name in results.class_names)
        self.without_box3d += sum(
            is_scored and bool(lacks) for is_scored, lacks in zip(scored, lacks_3d, strict=True)
        )

    def remarks(self) -> tuple[str, ...]:
        """List remarks on unscored results and labels; empty if there are none."""
        found, labelled = by_code(self.results), by_code(self.labels)
        remarks = []
        total = self.results.total()
        if total == 0:
            remarks.append("WARNING: the result files hold no object at all.")
        if not labelled:
            remarks.append(NOTHING_LABELLED)
        unscored = {name: n for name, n in self.results.items() if class_code(name) < 0}
        if unscored:
            remarks.append(
                f"{sum(unscored.values()):,} of {total:,} results were left out: their classes are "
                f"not scored ({listed(unscored)}; {', '.join(CLASSES)} are)."
            )
        remarks += self.remarks_on_labels()
        for code, name in enumerate(CLASSES):
            if code in labelled and code not in found:
                missed = f"{labelled[code]:,} labelled objects are all missed"
                missed = "one labelled object is missed" if labelled[code] == 1 else missed
                remarks.append(
                    f"No result is of {name}: its {missed}. A table without any "
                    "result of a class leaves it out, as KITTI's does."
                )
            elif code in found and code not in labelled and labelled:
                remarks.append(
                    f"No label is of {name}: its {found[code]:,} results cannot score above 0."
                )
        if self.without_box3d:
            remarks.append(
                f"{self.without_box3d:,} of {sum(found.values()):,} results of scored classes have "
                "no 3D part: they match nothing in bird's eye and 3D."
            )
        self.conventions.in_degrees = self.results_in_degrees > 0
        self.convention_remarks = tuple(self.conventions.remarks())
        return (*remarks, *self.remarks_on_angles(), *self.convention_remarks)

    def remarks_on_labels(self) -> tuple[str, ...]:
        """List a remark on labels of unknown classes; empty if there are none."""
        unknown = {name: n for name, n in self.labels.items() if name.lower() not in KITTI_CLASSES}
        if not unknown:
            return ()
        return (
            f"{sum(unknown.values()):,} of {self.labels.total():,} labels were left out: "
            f"their classes are none of KITTI's ({listed(unknown)}).",
        )

    def remarks_on_angles(self) -> tuple[str, ...]:
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


def unread_results(results_dir: Path, names: Sequence[str]) -> tuple[str, ...]:
    """List a remark on result files of no scored frame; empty if there are none."""
    expected = {f"{name}.txt" for name in names}
    extra = sorted(
        path.name
        for path in results_dir.iterdir()
        if path.suffix.lower() == ".txt" and path.name not in expected
    )
    if not extra:
        return ()
    return (
        f"{len(extra):,} result files were left out: no label file has their name (the first is "
        f"{shortened(extra[0])}).",
    )


def unread_labels(labels_dir: Path) -> tuple[str, ...]:
    """List a remark on label files with another suffix than `.txt`; empty if there are none."""
    extra = sorted(
        path.name
        for path in labels_dir.iterdir()
        if path.suffix.lower() == ".txt" and path.suffix != ".txt"
    )
    if not extra:
        return ()
    return (
        f"{len(extra):,} label files were left out: they end in {Path(extra[0]).suffix}, not .txt "
        f"(the first is {shortened(extra[0])}).",
    )


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
