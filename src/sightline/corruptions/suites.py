"""Named suites: the cases for testing a detector, and optionally for training it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Final

from sightline.augmentation.faults import fault_rng
from sightline.corruptions.blank import CameraBlank, LidarBlank
from sightline.corruptions.combined import JOINED, find_corruption
from sightline.corruptions.corruption import Corrupted, Corruption, NoCorruption
from sightline.corruptions.exposure import CameraIllumination
from sightline.corruptions.kinds import KINDS, SEVERITIES, Kind, find_kind, unknown
from sightline.corruptions.noise import CameraDeadPixels, CameraGaussianNoise
from sightline.corruptions.occlusion import CameraOcclusion, LidarOcclusion
from sightline.corruptions.sensor import HDL_64E, SpinningLidar
from sightline.files.safe_names import checked_name
from sightline.geometry.arguments import plain_tuple, wrong_type
from sightline.geometry.wrong_types import named_arguments, named_fields
from sightline.structures.sample import CameraLidarSample

CLEAN: Final = "clean"
"""Case of sound sensors, in every suite."""

_SHORT = 12  # maximum number of names in an error message


@dataclass(frozen=True, kw_only=True, slots=True)
class Case:
    """Row of a suite's table."""

    name: str
    """Name of the case's folder, and in reports."""
    title: str
    """Name in the suite's source."""
    corruption: Corruption
    probability: float = 0.0
    """Probability of a draw for training, as in the source."""
    severity: int | None = None
    """Severity from 1 to 5; None if a suite has no levels."""

    def __post_init__(self) -> None:
        """Check that the name can be that of a folder, and the corruption's type.

        Raises:
            TypeError: The corruption is none.
            ValueError: The name is no plain file name.
        """
        checked_name(self.name, "suite", "the name of case", remedy="name the case otherwise")
        corruption: object = self.corruption
        if not isinstance(corruption, Corruption):
            expected = "a Corruption; take find_kind(NAME).at(SEVERITY)"
            raise wrong_type("corruption", corruption, expected)

    @property
    def kind(self) -> str:
        """Kind of its corruption."""
        return self.corruption.kind

    @named_arguments
    def corrupt(self, sample: CameraLidarSample, seed: int = 0) -> Corrupted:
        """Corrupt a test sample; draws depend only on the seed, the sample's name and the kind."""
        return self.corruption.corrupt(sample, fault_rng(sample, seed, self.corruption.kind))


@named_fields
@dataclass(frozen=True, kw_only=True, slots=True)
class Suite:
    """Cases in the order of their table, sound sensors first.

    Raises:
        ValueError: The first case is not `CLEAN`, two cases have one name, or the probabilities do
            not sum to 1 (a suite for testing only may have all 0).
    """

    name: str
    cases: tuple[Case, ...]

    def __post_init__(self) -> None:
        """Check names and probabilities."""
        object.__setattr__(self, "cases", tuple(self.cases))  # of a generator or list
        names = self.case_names
        if names[:1] != (CLEAN,):
            raise ValueError(
                f"suite {self.name} needs the reference of sound sensors as its first case; "
                f"name it '{CLEAN}'"
            )
        if len(set(names)) < len(names):
            raise ValueError(f"suite {self.name} needs a name for each case, got {names}")
        total = sum(case.probability for case in self.cases)
        if any(case.probability for case in self.cases) and abs(total - 1) > 1e-9:
            raise ValueError(
                f"suite {self.name} needs probabilities that sum to 1, got {total:g}; "
                "omit all of them for a suite without training"
            )

    @property
    def case_names(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(case.name for case in self.cases)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of the cases with severities, in order, without duplicates."""
        return tuple(dict.fromkeys(case.kind for case in self.cases if case.severity is not None))

    def select(self, names: Iterable[str]) -> tuple[Case, ...]:
        """Select cases by name, in the suite's order, without duplicates.

        A kind's name stands for all its severities.

        Raises:
            ValueError: There is no such case, or the names are a single text.
        """
        chosen = set(plain_tuple("names", names))
        for name in sorted(chosen - set(self.case_names) - set(self.kinds)):
            raise ValueError(self._unknown(f"suite {self.name} has no case", name))
        return tuple(
            case
            for case in self.cases
            if case.name in chosen or (case.severity is not None and case.kind in chosen)
        )

    def without(self, kinds: Iterable[str]) -> tuple[Case, ...]:
        """Select all cases except these kinds, which are then unseen in training.

        Raises:
            ValueError: The suite has no such kind, or they are a single text.
        """
        left_out = set(plain_tuple("kinds", kinds))
        there = tuple(dict.fromkeys(case.kind for case in self.cases if case.name != CLEAN))
        for name in sorted(left_out - set(there)):
            raise ValueError(unknown(f"suite {self.name} has no kind", name, there))
        return tuple(case for case in self.cases if case.kind not in left_out)

    def _unknown(self, problem: str, name: str) -> str:
        names = self.case_names
        holding = (each for each in SUITES.values() if name in (*each.case_names, *each.kinds))
        elsewhere = "".join(f"; suite {each.name} has it" for each in islice(holding, 1))
        if len(names) <= _SHORT:
            return unknown(problem, name, names) + elsewhere
        rest = [case.name for case in self.cases if case.severity is None]
        listed = (*rest, *self.kinds)
        message = unknown(problem, name, (*names, *self.kinds), listed) + ", or KIND-1 to KIND-5"
        return message + elsewhere


def _dgfn7(name: str, noise: Corruption) -> Suite:
    """Suite of Kim et al. 2018, Table I; its row "Full" is the mean of the seven.

    The paper draws one of five operations, including none, and for blank and occlusion the sensor,
    all with equal probability.
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


@named_arguments
def severity_suite(name: str, kinds: Iterable[Kind], lidar: SpinningLidar = HDL_64E) -> Suite:
    """Make a suite of sound sensors and each kind at five severities, as cases KIND-SEVERITY.

    No frequencies have been published: all cases have equal probability.

    Args:
        name: Name of the suite.
        kinds: Kinds in order.
        lidar: The affected LiDAR, if its properties matter.
    """
    faulty = [(kind, severity) for kind in kinds for severity in SEVERITIES]
    probability = 1 / (1 + len(faulty))
    sound = Case(
        name=CLEAN, title="sound sensors", corruption=NoCorruption(), probability=probability
    )
    cases = [
        Case(
            name=f"{kind.name}-{severity}",
            title=f"{kind.name.replace('_', ' ')}: {kind.describe(severity)}",
            corruption=kind.at(severity, lidar),
            probability=probability,
            severity=severity,
        )
        for kind, severity in faulty
    ]
    return Suite(name=name, cases=(sound, *cases))


SUITES: Final[dict[str, Suite]] = {
    suite.name: suite
    for suite in (
        _dgfn7("dgfn7", CameraGaussianNoise()),  # as in the text
        _dgfn7("dgfn7-figure", CameraDeadPixels(share=(0.63, 0.63))),  # as in Fig. 3c
        severity_suite("core", (kind for kind in KINDS.values() if kind.is_core)),
        severity_suite("all", KINDS.values()),
    )
}


@named_arguments
def find_suite(name: str) -> Suite:
    """Find a suite by name: one of `SUITES`, a kind, or several kinds at once as KIND+KIND.

    Raises:
        ValueError: There is no such suite.
    """
    if name in SUITES:
        return SUITES[name]
    names = tuple(name.split(JOINED))
    if len(names) == 1 and name not in KINDS:
        message = unknown("there is no suite", name, (*SUITES, *KINDS), tuple(SUITES))
        raise ValueError(f"{message}, a kind, or kinds as camera_fog+lidar_fog")
    kinds = [find_kind(each) for each in names]
    return severity_suite(name, kinds) if len(kinds) == 1 else _joint_suite(name, kinds)


def _joint_suite(name: str, kinds: Sequence[Kind]) -> Suite:
    """Make a suite of sound sensors and all kinds at once at equal severity, for testing only."""
    cases = [
        Case(
            name=f"{name}-{severity}",
            title="; ".join(
                f"{kind.name.replace('_', ' ')}: {kind.describe(severity)}" for kind in kinds
            ),
            corruption=find_corruption(name, severity),
            severity=severity,
        )
        for severity in SEVERITIES
    ]
    sound = Case(name=CLEAN, title="sound sensors", corruption=NoCorruption())
    return Suite(name=name, cases=(sound, *cases))
