"""Doubt about labels whose sizes are in feet or decimetres, over all files of a data set."""

from collections import defaultdict
from collections.abc import Iterable
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.data.checks.label_checks import TYPICAL_HWL_M, gives_box3d
from sightline.data.formats.kitti_labels import KittiObjects

UNITS_REMEDY: Final = (
    "write sizes, and x, y, z, in metres (a foot is 0.3048 m); points and the calibration, too, if "
    "they are in this unit"
)
_UNITS: Final = {
    1 / 0.3048: "they are probably in feet",
    10.0: "they are probably in decimetres",
    0.3048: "they were probably converted from feet, but are in metres",
}
"""Descriptions by the ratio of the sizes to KITTI's."""
_CLASSES: Final = ("Car", "Pedestrian", "Cyclist")
_MIN_OBJECTS: Final = 3
_MAX_OFF: Final = 0.3
"""Largest difference of the binary logarithms of the mean ratio and a unit's; the mean of a single
object of KITTI's is off by up to 0.9, the feet are 1.7 away."""
_MAX_OFF_IN_ONE: Final = 0.8
"""The same of height, width or length alone, which all have the factor of a unit."""


def doubt_about_units(labels: Iterable[KittiObjects]) -> str | None:
    """Describe sizes in another unit than metres, after "holds"; None: there is no doubt.

    The medians of KITTI's scored classes are compared with its own: height, width and length must
    all be off by the factor of a unit.
    """
    sizes: dict[str, list[Float64[np.ndarray, "3"]]] = defaultdict(list)
    for objects in labels:
        for index in np.flatnonzero(gives_box3d(objects)).tolist():
            name = objects.class_names[index].capitalize()
            if name in _CLASSES:
                sizes[name].append(objects.dimensions_hwl[index])
    if sum(map(len, sizes.values())) < _MIN_OBJECTS:
        return None
    ratios = [np.maximum(each, 1e-6) / TYPICAL_HWL_M[name] for name, each in sizes.items()]
    logs = np.log2(np.median(np.concatenate(ratios), axis=0))
    for ratio, unit in _UNITS.items():
        off = logs - np.log2(ratio)
        if abs(off.mean()) < _MAX_OFF and (np.abs(off) < _MAX_OFF_IN_ONE).all():
            name = max(sizes, key=lambda each: len(sizes[each]))
            given = ", ".join(f"{value:.4g}" for value in np.median(sizes[name], axis=0))
            usual = ", ".join(f"{value:g}" for value in TYPICAL_HWL_M[name])
            return (
                f"labels with sizes {2 ** logs.mean():.2g} times the usual ones: {name} "
                f"({len(sizes[name]):,}) has a median height, width, length of {given}, expected "
                f"about {usual} m; {unit}"
            )
    return None
