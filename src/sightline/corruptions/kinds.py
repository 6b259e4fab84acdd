"""All kinds of corruption at five severities: levels are data, in the sensors' own units."""

import difflib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from sightline.corruptions.corruption import Corruption
from sightline.corruptions.illumination import CameraIllumination
from sightline.corruptions.noise import CameraDeadPixels, CameraGaussianNoise
from sightline.corruptions.sensor import HDL_64E, SpinningLidar
from sightline.data.plain_text import shortened

SEVERITIES: Final = (1, 2, 3, 4, 5)

_LIKENESS = 0.7  # of a misspelt name with the one that is meant; with less, sensors are mixed up

Level = tuple[float, ...]
"""What a severity sets, one number for each quantity of its kind."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Kind:
    """A kind of corruption and what its five severities mean."""

    name: str
    quantities: tuple[str, ...]
    """What a level's numbers are, with units."""
    levels: tuple[Level, Level, Level, Level, Level]
    """From severity 1 to 5."""
    make: Callable[[Level, SpinningLidar], Corruption]
    is_core: bool = False
    """Whether suite `core` has it."""

    def at(self, severity: int, lidar: SpinningLidar = HDL_64E) -> Corruption:
        """The corruption of a severity.

        Args:
            severity: From 1, slight, to 5.
            lidar: The LiDAR that it is a fault of, as far as it matters.

        Raises:
            ValueError: There is no such severity.
        """
        if severity not in SEVERITIES:
            raise ValueError(f"{self.name} has the severities 1 to 5, got {severity}")
        return self.make(self.levels[severity - 1], lidar)

    def said(self, severity: int) -> str:
        """The level of a severity in words."""
        numbers = self.levels[severity - 1]
        return ", ".join(
            f"{quantity.split(' [')[0]} {number:g}{_unit(quantity)}"
            for quantity, number in zip(self.quantities, numbers, strict=True)
        )


def find_kind(name: str) -> Kind:
    """The kind of a name.

    Raises:
        ValueError: There is none.
    """
    if name not in KINDS:
        raise ValueError(unknown("there is no kind of corruption", name, tuple(KINDS)))
    return KINDS[name]


def unknown(
    problem: str, name: str, known: Sequence[str], listed: Iterable[str] | None = None
) -> str:
    """The problem with a name, the nearest ones that there are, and all of them.

    Args:
        problem: Its beginning.
        name: The name.
        known: All names that there are.
        listed: What is said of them all. None: they themselves.
    """
    close = difflib.get_close_matches(name, known, n=2, cutoff=_LIKENESS)
    meant = f"perhaps {' or '.join(close)} is meant; " if close else ""
    return f"{problem} '{shortened(name)}'; {meant}name one of {', '.join(listed or known)}"


def _unit(quantity: str) -> str:
    _, bracket, unit = quantity.partition(" [")
    return f" {unit[:-1]}" if bracket else ""


def _same(number: float) -> tuple[float, float]:
    """A range to draw from that holds but this number."""
    return (number, number)


_ALL_KINDS = (
    Kind(
        name="camera_gaussian_noise",
        quantities=("standard deviation [of full scale]",),
        levels=((0.08,), (0.12,), (0.18,), (0.26,), (0.38,)),
        make=lambda level, _: CameraGaussianNoise(sigma_levels=_same(255 * level[0])),
        is_core=True,
    ),
    Kind(
        name="camera_dead_pixels",
        quantities=("share of the pixels",),
        levels=((0.1,), (0.25,), (0.4,), (0.55,), (0.7,)),
        make=lambda level, _: CameraDeadPixels(share=_same(level[0])),
        is_core=True,
    ),
    Kind(
        name="camera_illumination",
        quantities=("radius [px]", "added levels"),
        levels=((60, 100), (120, 130), (180, 160), (270, 190), (360, 220)),
        make=lambda level, _: CameraIllumination(
            radius_px=_same(level[0]), added_levels=(int(level[1]), int(level[1]))
        ),
        is_core=True,
    ),
)
KINDS: Final[dict[str, Kind]] = {kind.name: kind for kind in _ALL_KINDS}
"""By name, camera first."""
