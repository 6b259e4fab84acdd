"""Named suites: the cases that a detector is tested on, and may be trained on."""

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from sightline.corruptions.blank import CameraBlank, LidarBlank
from sightline.corruptions.corruption import Corrupted, Corruption, NoCorruption
from sightline.corruptions.illumination import CameraIllumination
from sightline.corruptions.noise import CameraDeadPixels, CameraGaussianNoise
from sightline.corruptions.occlusion import CameraOcclusion, LidarOcclusion
from sightline.data.faults import fault_rng
from sightline.data.plain_text import shortened
from sightline.structures.sample import CameraLidarSample

CLEAN: Final = "clean"
"""The case of sound sensors, in every suite."""

_LIKENESS = 0.7  # of a misspelt name with the one that is meant; with less, sensors are mixed up


@dataclass(frozen=True, kw_only=True, slots=True)
class Case:
    """One row of a suite's table."""

    name: str
    """Of its folder and in reports."""
    title: str
    """What the suite's source calls it."""
    corruption: Corruption
    probability: float
    """Of being drawn for training, as the source draws."""
    severity: int | None = None
    """From 1 to 5; None where a suite has no levels."""

    def corrupt(self, sample: CameraLidarSample, seed: int = 0) -> Corrupted:
        """The sample of a test: seed, sample's name and kind decide what is drawn, nothing else."""
        return self.corruption.corrupt(sample, fault_rng(sample, seed, self.corruption.kind))


@dataclass(frozen=True, kw_only=True, slots=True)
class Suite:
    """Cases in the order of their table, sound sensors first.

    Raises:
        ValueError: Two cases have one name, or the probabilities do not add up to 1.
    """

    name: str
    cases: tuple[Case, ...]

    def __post_init__(self) -> None:
        """Checks names and probabilities."""
        names = self.case_names
        if len(set(names)) < len(names):
            raise ValueError(f"suite {self.name} needs a name for each case, got {names}")
        total = sum(case.probability for case in self.cases)
        if abs(total - 1) > 1e-9:
            raise ValueError(f"suite {self.name} needs probabilities that sum to 1, got {total:g}")

    @property
    def case_names(self) -> tuple[str, ...]:
        """In order."""
        return tuple(case.name for case in self.cases)

    def select(self, names: Iterable[str]) -> tuple[Case, ...]:
        """The cases of these names, in the suite's order, each once.

        Raises:
            ValueError: There is no such case.
        """
        chosen = set(names)
        for name in sorted(chosen - set(self.case_names)):
            raise ValueError(_unknown(f"suite {self.name} has no case", name, self.case_names))
        return tuple(case for case in self.cases if case.name in chosen)


def _dgfn7(name: str, noise: Corruption) -> Suite:
    """Kim et al. 2018, Table I; its row "Full" is the mean of the seven.

    They draw one of five operations, none among them, and for blank and occlusion the sensor, all
    with equal probability.
    """
    rows: tuple[tuple[str, str, Corruption, float], ...] = (
        (CLEAN, "Lidar + RGB (normal)", NoCorruption(), 0.2),
        ("camera_blank", "Lidar + RGB (blank)", CameraBlank(), 0.1),
        ("lidar_blank", "Lidar (blank) + RGB", LidarBlank(), 0.1),
        ("camera_occlusion", "Lidar + RGB (occlusion)", CameraOcclusion(), 0.1),
        ("lidar_occlusion", "Lidar (occlusion) + RGB", LidarOcclusion(), 0.1),
        ("camera_noise", "Lidar + RGB (noise)", noise, 0.2),
        ("camera_illumination", "Lidar + RGB (illumination)", CameraIllumination(), 0.2),
    )
    cases = tuple(
        Case(name=case, title=title, corruption=corruption, probability=probability)
        for case, title, corruption, probability in rows
    )
    return Suite(name=name, cases=cases)


SUITES: Final[dict[str, Suite]] = {
    suite.name: suite
    for suite in (
        _dgfn7("dgfn7", CameraGaussianNoise()),  # as the text has it
        _dgfn7("dgfn7-figure", CameraDeadPixels(share=(0.63, 0.63))),  # as Fig. 3c shows it
    )
}


def find_suite(name: str) -> Suite:
    """The suite of a name.

    Raises:
        ValueError: There is none.
    """
    if name not in SUITES:
        raise ValueError(_unknown("there is no suite", name, tuple(SUITES)))
    return SUITES[name]


def _unknown(problem: str, name: str, known: Sequence[str]) -> str:
    """The problem with a name, the nearest ones that there are, and all of them."""
    close = difflib.get_close_matches(name, known, n=2, cutoff=_LIKENESS)
    meant = f"perhaps {' or '.join(close)} is meant; " if close else ""
    return f"{problem} '{shortened(name)}'; {meant}name one of {', '.join(known)}"
