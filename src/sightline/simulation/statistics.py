"""How simulated frames measure up to real ones, number by number.

Needs no PyTorch. Both sides are read from KITTI's object tree by the same code.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
from jaxtyping import Float64, Shaped

from sightline.data.kitti_labels import NO_LOCATION
from sightline.simulation.measures import GRADIENTS, Measures, measure_tree

TOLERANCE: Final = 0.25
"""Relative difference above which a row is marked."""

_CLASSES: Final = ("Car", "Van", "Truck", "Pedestrian", "Person_sitting", "Cyclist", "Tram", "Misc")
_DISTANCES_M: Final = (5, 10, 15, 20, 30, 40, 60)
"""Between these, cars are compared by their number of points."""
_MIN_OBJECTS: Final = 5
"""A statistic of fewer objects is none."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Statistic:
    """One number of both sides; None where a side has too little to tell."""

    name: str
    simulated: float | None
    real: float | None

    @property
    def ratio(self) -> float | None:
        """Simulated over real."""
        if self.simulated is None or not self.real:
            return None
        return self.simulated / self.real

    @property
    def differs(self) -> bool:
        """Whether the sides differ by more than `TOLERANCE`."""
        return self.ratio is not None and abs(self.ratio - 1) > TOLERANCE


@dataclass(frozen=True, kw_only=True, slots=True)
class StatisticsReport:
    """All statistics of two data sets."""

    num_simulated: int
    num_real: int
    """Frames looked at."""
    statistics: tuple[Statistic, ...]

    def table(self) -> str:
        """For a person: a row for each statistic, marked where the sides differ."""
        header = f"simulated ({self.num_simulated})", f"real ({self.num_real})", "ratio"
        lines = [f"{'':<44}" + "".join(f"{title:>18}" for title in header)]
        for row in self.statistics:
            values = (_shown(row.simulated), _shown(row.real), _shown(row.ratio))
            mark = "  *" if row.differs else ""
            lines.append(f"{row.name:<44}" + "".join(f"{value:>18}" for value in values) + mark)
        count = sum(row.differs for row in self.statistics)
        compared = sum(row.ratio is not None for row in self.statistics)
        lines.append(f"* {count} of {compared} differ by more than {TOLERANCE:.0%}")
        return "\n".join(lines)

    def to_json(self) -> Mapping[str, object]:
        """For a script."""
        return {
            "num_simulated": self.num_simulated,
            "num_real": self.num_real,
            "statistics": [
                {"name": row.name, "simulated": row.simulated, "real": row.real, "ratio": row.ratio}
                for row in self.statistics
            ],
        }


def compare(
    simulated: Path,
    real: Path | None,
    *,
    real_labels: Path | None = None,
    max_frames: int | None = None,
) -> StatisticsReport:
    """Measures simulated and real frames alike and puts the numbers side by side.

    Args:
        simulated: An object tree that `generate.simulate` wrote.
        real: KITTI's object tree; a folder `full_sweeps` in it, beside `training`, is where
            whole sweeps are where `velodyne` holds those cut to the image. None: nothing real.
        real_labels: A folder of label files for the statistics of objects, where there are more
            than those of `real`.
        max_frames: Looks at so many frames of each, evenly taken; None: all.

    Raises:
        ValueError: A tree holds no labelled frames, or a file of it cannot be understood.
    """
    ours = measure_tree(simulated, None, max_frames)
    theirs = Measures() if real is None else measure_tree(real, real_labels, max_frames)
    rows = []
    for name, tell in _STATISTICS.items():
        rows.append(Statistic(name=name, simulated=tell(ours), real=tell(theirs)))
    return StatisticsReport(
        num_simulated=len(ours.points_in_image),
        num_real=len(theirs.points_in_image),
        statistics=tuple(rows),
    )


def _shown(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


_Tell = Callable[[Measures], float | None]


_Values = Sequence[int] | Sequence[float] | Shaped[np.ndarray, " num_values"]


def _mean(values: _Values) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _quantile(values: _Values, share: float) -> float | None:
    return float(np.quantile(values, share)) if len(values) else None


def _reflectance(share: float) -> _Tell:
    def tell(measures: Measures) -> float | None:
        if not measures.reflectances:
            return None
        return _quantile(np.concatenate(measures.reflectances), share)

    return tell


_Column = Literal["dimensions_hwl", "locations", "truncation", "occlusion"]


def _of_class(
    measures: Measures, name: str, column: _Column
) -> Float64[np.ndarray, "num_objects *fields"]:
    """A column of all objects of a class that have a 3D part."""
    rows = [
        getattr(objects, column)[index]
        for objects in measures.objects
        for index, class_name in enumerate(objects.class_names)
        if class_name == name and objects.locations[index, 0] != NO_LOCATION
    ]
    return np.array(rows, dtype=np.float64)


def _size(name: str, axis: int) -> _Tell:
    def tell(measures: Measures) -> float | None:
        sizes = _of_class(measures, name, "dimensions_hwl")
        return float(sizes[:, axis].mean()) if len(sizes) >= _MIN_OBJECTS else None

    return tell


def _distance(name: str, share: float) -> _Tell:
    def tell(measures: Measures) -> float | None:
        places = _of_class(measures, name, "locations")
        if len(places) < _MIN_OBJECTS:
            return None
        return _quantile(np.hypot(places[:, 0], places[:, 2]), share)

    return tell


def _count(name: str) -> _Tell:
    return lambda measures: _mean([objects.class_names.count(name) for objects in measures.objects])


def _truncated(limit: float) -> _Tell:
    return lambda measures: _mean(_of_class(measures, "Car", "truncation") > limit)


def _occluded(name: str, level: int) -> _Tell:
    return lambda measures: _mean(_of_class(measures, name, "occlusion") == level)


def _points_on_cars(nearest_m: int, farthest_m: int) -> _Tell:
    def tell(measures: Measures) -> float | None:
        pairs = zip(measures.car_distances_m, measures.car_points, strict=True)
        counts = [points for distance, points in pairs if nearest_m <= distance < farthest_m]
        return _quantile(counts, 0.5) if len(counts) >= _MIN_OBJECTS else None

    return tell


def _gradient_share(position: int) -> _Tell:
    return lambda measures: _mean([float(shares[position]) for shares in measures.gradients])


_STATISTICS: Final[Mapping[str, _Tell]] = {
    "points in the image": lambda m: _mean(m.points_in_image),
    "points in the image, 5 % quantile": lambda m: _quantile(m.points_in_image, 0.05),
    "points in the image, 95 % quantile": lambda m: _quantile(m.points_in_image, 0.95),
    "share of pixels with a point, 1216x352": lambda m: _mean(m.pixel_shares),
    "first row with a point there": lambda m: _mean(m.first_rows),
    "first row with a point there, least": lambda m: min(m.first_rows, default=None),
    "points in a whole sweep": lambda m: _mean(m.points_in_sweep),
    **{
        f"reflectance, {share:.0%} quantile": _reflectance(share)
        for share in (0.1, 0.25, 0.5, 0.75, 0.9, 0.99)
    },
    "reflectance, share of zeros": lambda m: (
        _mean(np.concatenate(m.reflectances) == 0) if m.reflectances else None
    ),
    **{
        f"{name} {side} [m]": _size(name, axis)
        for name in ("Car", "Van", "Truck", "Pedestrian", "Cyclist")
        for axis, side in enumerate(("height", "width", "length"))
    },
    **{
        f"{name} distance [m], {share:.0%} quantile": _distance(name, share)
        for name in ("Car", "Pedestrian", "Cyclist")
        for share in (0.1, 0.5, 0.9)
    },
    **{f"{name} per frame": _count(name) for name in (*_CLASSES, "DontCare")},
    **{f"Car truncated more than {limit:.0%}": _truncated(limit) for limit in (0.0, 0.15, 0.5)},
    **{
        f"{name} occlusion {level}": _occluded(name, level)
        for name in ("Car", "Pedestrian", "Cyclist")
        for level in (0, 1, 2)
    },
    **{
        f"points on a free car, {start} to {end} m": _points_on_cars(start, end)
        for start, end in itertools.pairwise(_DISTANCES_M)
    },
    "image brightness": lambda m: _mean(m.brightness),
    "image brightness, spread of frames": lambda m: (
        float(np.std(m.brightness)) if m.brightness else None
    ),
    "image contrast": lambda m: _mean(m.contrasts),
    **{
        f"image gradient {start} to {end}": _gradient_share(position)
        for position, (start, end) in enumerate(itertools.pairwise((0, *GRADIENTS, "more")))
    },
}
