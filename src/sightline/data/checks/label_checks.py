"""Plausibility checks of a label file: names, sizes, locations and boxes in the image."""

import difflib
import itertools
from collections import Counter
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Bool, Float64, Shaped

from sightline.data.checks.result_boxes import BOX2D_CONVENTIONS
from sightline.data.formats.kitti_labels import (
    CLASS_NAMES,
    NO_ALPHA,
    NO_LOCATION,
    NO_ROTATION,
    UNKNOWN,
    KittiObjects,
)
from sightline.files.plain_text import shortened
from sightline.files.problem import Problem
from sightline.geometry.mount import MAX_RANGE_M

_MAX_OUTSIDE_SHARE = 0.1  # share of the image's size by which a box may exceed it
_MAX_ANGLE = np.pi + 0.01  # KITTI rounds to two digits
_OCCLUSIONS = (-1, 0, 1, 2, 3)
_MAX_SIZE_M = 60.0  # longer than trams
_LONG_CLASSES = ("Car", "Van", "Truck", "Tram")  # length is their largest size
_TALL_CLASSES = ("Pedestrian",)  # height is their largest size
_MIN_SIZE_RATIO = 1.15  # ratio of clearly different sizes
_SIZE_NAMES: Final = ("height", "width", "length")
TYPICAL_HWL_M: Final = {
    "Car": (1.53, 1.63, 3.88),
    "Van": (2.21, 1.90, 5.08),
    "Truck": (3.25, 2.59, 10.1),
    "Tram": (3.53, 2.54, 16.1),
    "Pedestrian": (1.76, 0.66, 0.84),
    "Cyclist": (1.74, 0.60, 1.76),
}
"""Mean sizes of KITTI's training labels."""
_SIZE_SPREAD: Final = 0.3
"""Difference of the logarithms of three sizes that one object of a class shows by chance."""
_SCALE_MARGIN: Final = 0.4
"""Largest difference of the binary logarithms of a size and half or twice the expected one."""
MIN_LARGEST_M: Final = 0.3
"""Largest size of an object that is smaller than every road user."""
_IN_PIXELS: Final = "write x_min, y_min, x_max, y_max in pixels"
_MIN_MISREAD: Final = 3
_MIN_MISREAD_SHARE: Final = 0.3
"""Minimum number and share of 2D boxes that no image holds, for a doubt about all of them."""
_MIN_MISSPELT: Final = 7  # letters; of shorter names one letter makes another word: cart, track
_MIN_LIKENESS: Final = 0.85
"""Likeness of a misspelt class, by difflib, to KITTI's; cyclsit has 0.86, tricyclist 0.82."""
_REGION = "DontCare"
_MAX_LISTED: Final = 5  # faults of one kind listed one by one per file

_BY_WORD: Final = {each.lower(): each for each in (*CLASS_NAMES, _REGION)}
_SYNONYMS: Final = {
    "auto": "Car",
    "automobile": "Car",
    "suv": "Car",
    "vehicle": "Car",
    "minivan": "Van",
    "lorry": "Truck",
    "bus": "Truck or Misc",
    "person": "Pedestrian",
    "people": "Pedestrian",
    "human": "Pedestrian",
    "walker": "Pedestrian",
    "sitting": "Person_sitting",
    "bicycle": "Cyclist or Misc",
    "bicyclist": "Cyclist",
    "bike": "Cyclist or Misc",
    "rider": "Cyclist",
    "motorcycle": "Cyclist or Misc",
    "motorcyclist": "Cyclist or Misc",
    "train": "Tram",
    "ignore": _REGION,
    "other": "Misc",
}


def check_objects(objects: KittiObjects, size: tuple[int, int] | None, path: Path) -> list[Problem]:
    """Find implausible labels; `size` is the image's height and width, if known."""
    return [
        *_check_names(objects, path),
        *_check_repeated(objects, path),
        *(
            Problem(path=path, problem=problem, remedy=remedy)
            for problem, remedy in (
                *doubts_in_space(objects),
                *_doubts_in_image(objects, size),
                *_doubts_about_values(objects),
            )
        ),
        *_check_each(objects, size, path),
    ]


def _check_names(objects: KittiObjects, path: Path) -> list[Problem]:
    """Find class names that are not KITTI's, which detectors ignore."""
    problems = []
    by_small_letters = {each.lower(): each for each in (*CLASS_NAMES, _REGION)}
    counts = Counter(objects.class_names)
    unknown = [name for name in counts if name not in (*CLASS_NAMES, _REGION)]
    for name in unknown[:_MAX_LISTED]:
        count = counts[name]
        suggestion = _suggested_class(name)
        known = ", ".join((*CLASS_NAMES, _REGION))
        matching_class = by_small_letters.get(name.lower())
        effect = (
            "detectors, training and evaluation ignore them"
            if matching_class is None
            else "detectors and training ignore them, evaluation ignores case and reads them as "
            f"{matching_class}"
        )
        problems.append(
            Problem(
                path=path,
                problem=f"names {count} of {len(objects)} objects '{shortened(name, 24)}', which "
                f"is no class of KITTI: {effect}",
                remedy=f"write {suggestion}" if suggestion else f"write one of {known}",
            )
        )
    if len(unknown) > _MAX_LISTED:
        num_objects = sum(counts[name] for name in unknown[_MAX_LISTED:])
        problem = (
            f"names {num_objects} more of {len(objects)} objects by {len(unknown) - _MAX_LISTED} "
            "more names that are no classes of KITTI"
        )
        remedy = f"write one of {', '.join((*CLASS_NAMES, _REGION))}"
        problems.append(Problem(path=path, problem=problem, remedy=remedy))
    return problems


def _check_repeated(objects: KittiObjects, path: Path) -> list[Problem]:
    """Find objects with the same values in all fields; no file of KITTI's has one."""
    rows = np.column_stack(
        (
            np.unique(np.array(objects.class_names, dtype=str), return_inverse=True)[1],
            *(objects.truncation, objects.occlusion, objects.alpha, objects.boxes2d),
            *(objects.dimensions_hwl, objects.locations, objects.rotation_y),
        )
    )
    first, counts = np.unique(rows, axis=0, return_index=True, return_counts=True)[1:]
    num_repeated = len(objects) - len(first)
    if not num_repeated:
        return []
    index = int(first[counts > 1].min())
    return [
        Problem(
            path=path,
            problem=f"repeats {num_repeated} of {len(objects)} objects with equal values in every "
            f"field, such as object {index + 1} ({shortened(objects.class_names[index], 24)}): "
            "evaluation counts each of them",
            remedy="keep one line per object",
        )
    ]


def _suggested_class(name: str) -> str | None:
    """Class of KITTI's for another data set's, such as vehicle.bus.rigid, or a misspelt one."""
    text = "".join(character for character in name if character.isprintable()).strip().lower()
    first, *others = text.replace("-", "_").split(".")
    for word in reversed(others or [first]):  # the first of several is wide: vehicle, human, ..
        known = class_of_word(word)
        if known is None and len(word) >= _MIN_MISSPELT:
            close = difflib.get_close_matches(word, _BY_WORD, n=1, cutoff=_MIN_LIKENESS)
            known = _BY_WORD[close[0]] if close else None
        if known is not None:
            return known
    return None


def class_of_word(word: str) -> str | None:
    """Class of KITTI's, or two to choose from, for a class of another data set in small letters."""
    singular = word.removesuffix("s")
    return (_BY_WORD | _SYNONYMS).get(word) or (_BY_WORD | _SYNONYMS).get(singular)


def is_empty_box2d(
    boxes2d: Float64[np.ndarray, "num_boxes 4"],
) -> Bool[np.ndarray, " num_boxes"]:
    """Mask of the 2D boxes without any extent, as written where there are none."""
    return np.asarray((boxes2d[:, :2] == boxes2d[:, 2:]).all(axis=1))


def gives_box3d(objects: KittiObjects) -> Bool[np.ndarray, " num_objects"]:
    """Mask of the objects with a 3D part; tools for 2D labels fill its fields by one number."""
    names = np.array(objects.class_names, dtype=object)
    is_filled = (objects.dimensions_hwl <= 0).all(axis=1)
    is_filled &= np.ptp(objects.locations, axis=1) == 0
    is_given = (objects.locations != NO_LOCATION).any(axis=1)
    return np.asarray(is_given & ~is_filled & (names != _REGION))


def lacks_box3d(objects: KittiObjects) -> Bool[np.ndarray, " num_objects"]:
    """Mask of the objects of KITTI's classes without a 3D part."""
    names = np.array(objects.class_names, dtype=object)
    return np.asarray(np.isin(names, CLASS_NAMES) & ~gives_box3d(objects))


def in_degrees(objects: KittiObjects) -> Bool[np.ndarray, " num_objects"]:
    """Mask of the objects with an angle beyond two pi, which cannot be in radians."""
    angles = np.stack((objects.rotation_y, objects.alpha), axis=1)
    is_given = angles != (NO_ROTATION, NO_ALPHA)
    return np.asarray((is_given & (np.abs(angles) > 2 * np.pi)).any(axis=1))


def doubts_in_space(objects: KittiObjects) -> list[tuple[str, str]]:
    """Find sizes, places and angles of most objects in another order or unit.

    Returns:
        Problems, as the rest of a sentence about the file, with their remedies.
    """
    has_box3d = gives_box3d(objects)
    sizes = objects.dimensions_hwl
    names = np.array([each.capitalize() for each in objects.class_names], dtype=object)
    faults = []
    if (sizes[has_box3d] > _MAX_SIZE_M).any():
        largest = sizes[has_box3d].max()
        faults.append((f"has objects of up to {largest:.6g} m in size", "write sizes in metres"))
    elif has_box3d.any() and 0 < sizes[has_box3d].max() < MIN_LARGEST_M:
        largest = sizes[has_box3d].max()
        problem = f"has no object larger than {largest:.4g} m"
        faults.append((problem, "write sizes, and x, y, z, in metres"))
    else:
        order = order_of_sizes(sizes[has_box3d], names[has_box3d])
        if order is not None:
            problem = (
                f"has the sizes of most objects probably in the order {order}, expected height, "
                "width, length"
            )
            faults.append((problem, "write height, width, length"))
    distances_m = np.linalg.norm(objects.locations[has_box3d], axis=1)
    if (distances_m > MAX_RANGE_M).any():
        problem = f"has objects as far away as {distances_m.max():.6g} m"
        faults.append((problem, "write x, y, z in metres, in the camera's frame"))
    num_in_degrees = int(np.count_nonzero(in_degrees(objects)))
    if num_in_degrees:
        problem = (
            f"has angles beyond two pi at {num_in_degrees} of {len(objects)} objects: rotation_y "
            "and alpha are probably in degrees"
        )
        faults.append((problem, "write radians, from -pi to pi"))
    return faults


def _doubts_in_image(objects: KittiObjects, size: tuple[int, int] | None) -> list[tuple[str, str]]:
    """Find 2D boxes of most objects in another convention, like `doubts_in_space`."""
    boxes = objects.boxes2d[np.array(objects.class_names, dtype=object) != _REGION]
    num_empty = int(np.count_nonzero(is_empty_box2d(boxes)))
    if num_empty > len(boxes) / 2:
        problem = (
            f"has placeholders such as 0 0 0 0 for {num_empty} of {len(boxes)} 2D boxes: "
            "evaluation ignores objects lower than 25 px in the image, also from above and in 3D"
        )
        return [(problem, "write the projections of the 3D boxes")]
    doubt = doubt_about_boxes2d(objects, size)
    return [] if doubt is None else [doubt]


def doubt_about_boxes2d(
    objects: KittiObjects, size: tuple[int, int] | None
) -> tuple[str, str] | None:
    """Find 2D boxes in another unit or order, like `doubts_in_space`; None: they are in pixels."""
    boxes = objects.boxes2d[np.array(objects.class_names, dtype=object) != _REGION]
    if size is not None and len(boxes) and (boxes.max(axis=1) <= 1).all() and min(size) > 10:
        problem = (
            "has all 2D boxes within the first pixel: they are probably relative to the image size"
        )
        return problem, _IN_PIXELS
    misread = _misread_boxes2d(objects, size)
    return None if misread is None else (misread, _IN_PIXELS)


def _doubts_about_values(objects: KittiObjects) -> list[tuple[str, str]]:
    """Find angles and truncations beyond their range, like `doubts_in_space`."""
    faults = []
    angles = np.where(objects.alpha == NO_ALPHA, 0.0, objects.alpha)
    is_outside = np.maximum(np.abs(objects.rotation_y), np.abs(angles)) > _MAX_ANGLE
    num_outside = int(np.count_nonzero(is_outside & gives_box3d(objects) & ~in_degrees(objects)))
    if num_outside:
        problem = f"has angles outside -pi to pi at {num_outside} of {len(objects)} objects"
        remedy = "subtract 2 pi from those above pi, and add it to those below -pi"
        faults.append((problem, remedy))
    truncations = objects.truncation[objects.truncation != UNKNOWN]
    outside = truncations[(truncations < 0) | (truncations > 1)]
    if len(outside):
        largest = outside[np.abs(outside).argmax()]
        problem = (
            f"has {len(outside)} of {len(objects)} truncations other than -1 or 0 to 1, such as "
            f"{largest:g}"
        )
        faults.append((problem, _remedy_for_truncations(truncations)))
    return faults


def _remedy_for_truncations(given: Float64[np.ndarray, " num_given"]) -> str:
    share = "write the share of each object outside the image, 0 to 1"
    if np.isin(given, (0, 1, 2)).all():
        return f"{share}: they are probably KITTI tracking's levels 0 to 2"
    if given.min() >= 0 and 2 < given.max() <= 100:
        return f"{share}: divide them by 100 if they are in percent"
    return f"{share}, or -1 where it is not known"


def _misread_boxes2d(objects: KittiObjects, size: tuple[int, int] | None) -> str | None:
    """Find 2D boxes that fit into the image only if they are read in another convention."""
    boxes = objects.boxes2d
    num_faulty = int(np.count_nonzero(_is_no_box2d(boxes, size)))
    if num_faulty < max(_MIN_MISREAD, _MIN_MISREAD_SHARE * len(boxes)):
        return None
    fitting = [
        name
        for name, convert in BOX2D_CONVENTIONS.items()
        if not _is_no_box2d(convert(boxes), size).any()
    ]
    if not fitting:
        return None
    return (
        f"has {num_faulty} of {len(boxes)} 2D boxes that end before they begin or lie far outside "
        f"the image: all are probably {' or '.join(fitting)}"
    )


def _is_no_box2d(
    boxes: Float64[np.ndarray, "num_boxes 4"], size: tuple[int, int] | None
) -> Bool[np.ndarray, " num_boxes"]:
    """Mask of the boxes that are inside out or far outside the image."""
    return np.asarray(is_inside_out(boxes) | _is_far_outside(boxes, size))


def is_inside_out(
    boxes: Float64[np.ndarray, "num_boxes 4"],
) -> Bool[np.ndarray, " num_boxes"]:
    """Mask of the 2D boxes with a maximum below its minimum."""
    return np.asarray((boxes[:, 2:] < boxes[:, :2]).any(axis=1))


def _is_far_outside(
    boxes: Float64[np.ndarray, "num_boxes 4"], size: tuple[int, int] | None
) -> Bool[np.ndarray, " num_boxes"]:
    width_height = np.array([np.inf, np.inf] if size is None else [size[1], size[0]])
    margin = _MAX_OUTSIDE_SHARE * width_height
    return np.asarray(
        ((boxes[:, :2] < -margin) | (boxes[:, 2:] > width_height + margin)).any(axis=1)
    )


def order_of_sizes(sizes_hwl: np.ndarray, names: np.ndarray) -> str | None:
    """Probable order of sizes that are not height, width, length; None: they are.

    Args:
        sizes_hwl: Sizes [m] of objects, num_objects x 3.
        names: KITTI's class names of the objects; only some classes determine the order.
    """
    is_long, is_tall = np.isin(names, _LONG_CLASSES), np.isin(names, _TALL_CLASSES)
    heights, widths, lengths = sizes_hwl.T
    height_first = (is_long & (heights > _MIN_SIZE_RATIO * lengths)) | (
        is_tall & (lengths > _MIN_SIZE_RATIO * heights)
    )
    width_largest = (is_long & (widths > _MIN_SIZE_RATIO * lengths) & ~height_first) | (
        is_tall & (widths > _MIN_SIZE_RATIO * heights) & ~height_first
    )
    is_wrong = height_first | width_largest
    if np.count_nonzero(is_wrong) <= np.count_nonzero(is_long | is_tall) / 2:
        return None
    # A person's width and length are alike: only the position of the height is known.
    decisive = is_wrong & is_long if (is_wrong & is_long).any() else is_wrong
    return _likely_orders(sizes_hwl[decisive], names[decisive])


def scale_of_sizes(
    sizes: Float64[np.ndarray, "3"], name: str, typical: Float64[np.ndarray, "3"] | None = None
) -> str | None:
    """Find a class whose sizes are all halves or doubles of the expected ones; None: they are not.

    Args:
        sizes: Median height, width, length [m].
        name: Class of the objects, as KITTI writes it.
        typical: Expected sizes. None: those of KITTI's labels.

    Returns:
        "halves" or "doubles".
    """
    if typical is None:
        typical = np.array(TYPICAL_HWL_M.get(name, (np.nan, np.nan, np.nan)))
    ratios = np.log2(np.maximum(sizes, 1e-6) / typical)
    for scale, word in ((-1, "halves"), (1, "doubles")):
        if (np.abs(ratios - scale) < _SCALE_MARGIN).all():
            return word
    return None


def _likely_orders(
    sizes: Float64[np.ndarray, "num_objects 3"], names: Shaped[np.ndarray, " num_objects"]
) -> str:
    """Name the orders, other than the expected one, that fit the classes' typical sizes best."""
    typical = np.array([TYPICAL_HWL_M[name] for name in names])
    ratios = {
        order: np.log(np.maximum(sizes, 1e-6) / typical[:, order])
        for order in itertools.permutations(range(3))
        if order != (0, 1, 2)
    }
    misfits = {order: np.abs(np.median(each, axis=0)).sum() for order, each in ratios.items()}
    likely = sorted(misfits, key=lambda order: misfits[order])
    margin = _SIZE_SPREAD / np.sqrt(len(sizes))
    return " or ".join(
        ", ".join(_SIZE_NAMES[place] for place in order)
        for order in likely[:2]
        if misfits[order] <= misfits[likely[0]] + margin
    )


def impossible_values(objects: KittiObjects) -> dict[str, Bool[np.ndarray, " num_objects"]]:
    """Masks of the objects with values that no label has and evaluation relies on, by the fault."""
    return {
        "a 2D box with its maximum below its minimum": is_inside_out(objects.boxes2d),
        "an occlusion other than -1 to 3": ~np.isin(objects.occlusion, _OCCLUSIONS),
        "a truncation other than -1 or 0 to 1": (objects.truncation != UNKNOWN)
        & ((objects.truncation < 0) | (objects.truncation > 1)),
    }


def _check_each(objects: KittiObjects, size: tuple[int, int] | None, path: Path) -> list[Problem]:
    is_misread = _misread_boxes2d(objects, size) is not None  # reported once for all
    has_box3d = gives_box3d(objects)
    inside_out, occlusion, _ = impossible_values(objects).items()  # truncations: for the file
    faults = {
        f"has {inside_out[0]}": inside_out[1] & (not is_misread),
        "has a 2D box far outside the image": _is_far_outside(objects.boxes2d, size)
        & (not is_misread),
        "has a 3D box of a size that is not positive": has_box3d
        & (objects.dimensions_hwl <= 0).any(axis=1),
        f"has {occlusion[0]}": occlusion[1],
    }
    problems = []
    for fault, faulty in faults.items():
        places = np.flatnonzero(faulty).tolist()
        problems += [
            f"object {index + 1} of {len(objects)} "
            f"({shortened(objects.class_names[index], 24)}) {fault}"
            for index in places[:_MAX_LISTED]
        ]
        if len(places) > _MAX_LISTED:
            problems.append(
                f"{fault} at {len(places) - _MAX_LISTED} more of {len(objects)} objects"
            )
    remedy = "correct the line or extract the labels again"
    return [Problem(path=path, problem=problem, remedy=remedy) for problem in problems]
