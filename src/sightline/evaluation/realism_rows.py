"""Rows of the comparison of simulated and real frames: names and computations."""

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Final, Literal

import numpy as np
from jaxtyping import Float64, Shaped

from sightline.data.formats.kitti_labels import CLASS_NAMES, NO_LOCATION, parse_objects
from sightline.evaluation.realism_measures import GRADIENTS, BoxFit, Measures
from sightline.evaluation.realism_points import FreeCar

_DISTANCES_M: Final = (5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0)
"""Borders of the distance bins in which cars are compared by their points."""
_MIN_OBJECTS: Final = 5
"""Minimum number of objects for a statistic."""
_FAR_M: Final = 30.0
"""Minimum distance at which the height of objects on the ground measures its flatness."""
_SEEN_WELL_M: Final = 25.0
"""Maximum distance at which flanks of cars are compared with their labels."""
_AXIS_RAD: Final = np.radians(5)
_GROUP_M: Final = 1.5
_NO_OBJECTS: Final = parse_objects(b"", "no labels", with_scores=False)

_BOX_PARTS: Final[Mapping[str, Callable[[BoxFit], float]]] = {
    "IoU": lambda fit: fit.iou,
    "width": lambda fit: fit.width_ratio,
    "height": lambda fit: fit.height_ratio,
}

_Compute = Callable[[Measures], float | None]
_Values = Sequence[int] | Sequence[float] | Shaped[np.ndarray, " num_values"]


def _mean(values: _Values, min_count: int = 1) -> float | None:
    return float(np.mean(values)) if len(values) >= min_count else None


def _quantile(values: _Values, share: float, min_count: int = 1) -> float | None:
    return float(np.quantile(values, share)) if len(values) >= min_count else None


def _spread(values: _Values) -> float | None:
    """Compute the standard deviation."""
    return float(np.std(values)) if len(values) else None


def _half_spread(values: _Values) -> float | None:
    """Compute half the width of the middle two thirds: the deviation of a normal distribution."""
    return float(np.diff(np.quantile(values, (0.16, 0.84)))[0] / 2) if len(values) else None


def _pooled(values: Sequence[Shaped[np.ndarray, " _"]]) -> Shaped[np.ndarray, " num_values"]:
    return np.concatenate([np.zeros(0), *values])


_Column = Literal["dimensions_hwl", "locations", "truncation", "occlusion", "boxes2d", "rotation_y"]


def _column(
    measures: Measures, names: Collection[str], column: _Column
) -> Float64[np.ndarray, "num_objects *fields"]:
    """Take a column of all objects of some classes with a 3D part."""
    columns: list[Float64[np.ndarray, "num_objects *fields"]] = []
    for objects in (_NO_OBJECTS, *measures.objects):
        chosen = np.isin(objects.class_names, [*names])
        chosen &= objects.locations[:, 0] != NO_LOCATION
        columns.append(getattr(objects, column)[chosen])
    return np.concatenate(columns)


def _size(name: str, axis: int) -> _Compute:
    return lambda m: _mean(_column(m, [name], "dimensions_hwl")[:, axis], _MIN_OBJECTS)


def _length_ratio(share: float) -> _Compute:
    return lambda m: _quantile(
        np.divide(*_column(m, ["Car"], "dimensions_hwl")[:, [2, 0]].T), share
    )


def _length_unknown(measures: Measures) -> float | None:
    """Compute the deviation of cars' length from a linear fit to their height and width."""
    height, width, length = _column(measures, ["Car"], "dimensions_hwl").T
    terms = np.column_stack((height, width, np.ones(len(length))))
    return _spread(length - terms @ np.linalg.lstsq(terms, length, rcond=None)[0])


def _distances(measures: Measures, name: str) -> Float64[np.ndarray, " num_objects"]:
    return np.asarray(np.hypot(*_column(measures, [name], "locations")[:, [0, 2]].T))


def _distance(name: str, share: float) -> _Compute:
    return lambda measures: _quantile(_distances(measures, name), share, _MIN_OBJECTS)


def _far_bottoms(measures: Measures) -> Float64[np.ndarray, " num_cars"]:
    """Compute how far below the camera the far cars stand [m]."""
    far = _distances(measures, "Car") > _FAR_M
    return np.asarray(_column(measures, ["Car"], "locations")[far, 1])


def _counts(measures: Measures, name: str) -> list[int]:
    """Count the objects of a class in each frame."""
    return [objects.class_names.count(name) for objects in measures.objects]


def _count(name: str) -> _Compute:
    return lambda measures: _mean(_counts(measures, name))


def _frames_with(name: str, min_count: int, max_count: float = np.inf) -> _Compute:
    return lambda m: _mean([min_count <= count <= max_count for count in _counts(m, name)])


def _low_boxes(height_px: int) -> _Compute:
    def compute(measures: Measures) -> float | None:
        _, top, _, bottom = _column(measures, CLASS_NAMES, "boxes2d").T
        low = float((bottom - top < height_px).sum())
        return low / len(measures.objects) if measures.objects else None

    return compute


def _along_an_axis(measures: Measures) -> float | None:
    turns = _column(measures, ["Car"], "rotation_y")
    off = np.abs(np.remainder(turns + np.pi / 4, np.pi / 2) - np.pi / 4)
    return _mean(off < _AXIS_RAD)


def _in_company(measures: Measures) -> float | None:
    """Compute the share of pedestrians with another one nearby."""
    near: list[bool] = []
    for objects in measures.objects:
        places = objects.locations[np.isin(objects.class_names, "Pedestrian")][:, [0, 2]]
        apart = np.linalg.norm(places[:, None] - places, axis=2)
        near += ((apart < _GROUP_M).sum(axis=1) > 1).tolist()  # each is near to itself
    return _mean(near)


def _truncated(limit: float) -> _Compute:
    return lambda measures: _mean(_column(measures, ["Car"], "truncation") > limit)


def _occluded(name: str, level: int) -> _Compute:
    return lambda measures: _mean(_column(measures, [name], "occlusion") == level)


def _box_fit(name: str, part: Callable[[BoxFit], float], share: float) -> _Compute:
    return lambda measures: _quantile(
        [part(fit) for fit in measures.box_fits if fit.class_name == name], share
    )


def _cars(measures: Measures, nearest_m: float, farthest_m: float) -> list[FreeCar]:
    return [car for car in measures.cars if nearest_m <= car.distance_m < farthest_m]


def _points_on_cars(nearest_m: float, farthest_m: float, share: float) -> _Compute:
    return lambda measures: _quantile(
        [len(car.reflectances) for car in _cars(measures, nearest_m, farthest_m)],
        share,
        _MIN_OBJECTS,
    )


def _on_cars(measures: Measures, nearest_m: float, farthest_m: float) -> _Values:
    """Pool the reflectances of all points in the boxes of unoccluded cars."""
    return _pooled([car.reflectances for car in _cars(measures, nearest_m, farthest_m)])


def _reflectance_on_cars(nearest_m: float, farthest_m: float) -> _Compute:
    return lambda measures: _quantile(_on_cars(measures, nearest_m, farthest_m), 0.5)


def _label_beyond_flank(share: float) -> _Compute:
    return lambda measures: _quantile(
        [
            car.beyond_flank_m
            for car in _cars(measures, 0.0, _SEEN_WELL_M)
            if car.beyond_flank_m is not None
        ],
        share,
        _MIN_OBJECTS,
    )


def _with_mirrors(measures: Measures) -> float | None:
    return _mean([car.shows_mirrors for car in _cars(measures, 0.0, _FAR_M)], _MIN_OBJECTS)


def _reflectance(share: float) -> _Compute:
    return lambda measures: _quantile(_pooled(measures.reflectances), share)


def _gradient_share(position: int) -> _Compute:
    return lambda measures: _mean([float(shares[position]) for shares in measures.gradients])


_POINTS: Final[Mapping[str, _Compute]] = {
    "points in the image": lambda m: _mean(m.points_in_image),
    "points in the image, 5 % quantile": lambda m: _quantile(m.points_in_image, 0.05),
    "points in the image, 95 % quantile": lambda m: _quantile(m.points_in_image, 0.95),
    "share of pixels with a point, 1216x352": lambda m: _mean(m.pixel_shares),
    "first row with a point there": lambda m: _mean(m.first_rows),
    "first row with a point there, least": lambda m: _quantile(m.first_rows, 0.0),
    "points in a whole sweep": lambda m: _mean(m.points_in_sweep),
    **{
        f"reflectance, {share:.0%} quantile": _reflectance(share)
        for share in (0.1, 0.25, 0.5, 0.75, 0.9, 0.99)
    },
    "reflectance, share of zeros": lambda m: _mean(_pooled(m.reflectances) == 0),
    **{
        f"points on a free car, {start:.0f} to {end:.0f} m": _points_on_cars(start, end, 0.5)
        for start, end in itertools.pairwise(_DISTANCES_M)
    },
    **{
        f"points on a free car, {start:.0f} to {end:.0f} m, 10 %": _points_on_cars(start, end, 0.1)
        for start, end in itertools.pairwise(_DISTANCES_M[1:-1])
    },
    **{
        f"reflectance on free cars, {start:.0f} to {end:.0f} m": _reflectance_on_cars(start, end)
        for start, end in itertools.pairwise(_DISTANCES_M)
    },
    "reflectance on free cars, share of zeros": lambda m: _mean(
        np.equal(_on_cars(m, 0.0, np.inf), 0)
    ),
    **{
        f"label beyond a free car's flank [m], {share:.0%}": _label_beyond_flank(share)
        for share in (0.25, 0.5, 0.75)
    },
    "free cars within 30 m with points on mirrors": _with_mirrors,
    "ground off a plane [m], median": lambda m: _quantile([g.residual_m for g in m.grounds], 0.5),
    "ground off a plane [m], 90 %": lambda m: _quantile([g.residual_90_m for g in m.grounds], 0.5),
    "ground's pitch [degrees], spread": lambda m: _half_spread([g.pitch_deg for g in m.grounds]),
    "ground's roll [degrees], spread": lambda m: _half_spread([g.roll_deg for g in m.grounds]),
}
_OBJECTS: Final[Mapping[str, _Compute]] = {
    **{
        f"{name} {side} [m]": _size(name, axis)
        for name in ("Car", "Van", "Truck", "Pedestrian", "Cyclist")
        for axis, side in enumerate(("height", "width", "length"))
    },
    **{f"Car length / height, {share:.0%}": _length_ratio(share) for share in (0.1, 0.5, 0.9)},
    "Car length [m], not told by the front": _length_unknown,
    **{
        f"{name} distance [m], {share:.0%} quantile": _distance(name, share)
        for name in ("Car", "Pedestrian", "Cyclist")
        for share in (0.1, 0.5, 0.9)
    },
    "Car bottom beyond 30 m [m], spread": lambda m: _spread(_far_bottoms(m)),
    "Car bottom beyond 30 m [m], half 16 to 84 %": lambda m: _half_spread(_far_bottoms(m)),
    "Car yaw within 5 degrees of an axis": _along_an_axis,
    "Pedestrian within 1.5 m of another": _in_company,
    **{f"{name} per frame": _count(name) for name in (*CLASS_NAMES, "DontCare")},
    "frames without Car": _frames_with("Car", 0, 0.0),
    **{f"frames with more than {count} Car": _frames_with("Car", count + 1) for count in (8, 12)},
    "frames with DontCare": _frames_with("DontCare", 1),
    **{f"labels under {height} px per frame": _low_boxes(height) for height in (15, 25)},
    **{f"Car truncated more than {limit:.0%}": _truncated(limit) for limit in (0.0, 0.15, 0.5)},
    **{
        f"{name} occlusion {level}": _occluded(name, level)
        for name in ("Car", "Pedestrian", "Cyclist")
        for level in (0, 1, 2, 3)
    },
    **{
        f"{name} box, {text} by the 3D box's": _box_fit(name, part, 0.5)
        for name in ("Car", "Van", "Cyclist", "Pedestrian")
        for text, part in _BOX_PARTS.items()
    },
    **{
        f"Pedestrian box, width by the 3D box's, {share:.0%}": _box_fit(
            "Pedestrian", _BOX_PARTS["width"], share
        )
        for share in (0.1, 0.9)
    },
}
_IMAGES: Final[Mapping[str, _Compute]] = {
    "image brightness": lambda m: _mean(m.brightness),
    "image brightness, spread of frames": lambda m: _spread(m.brightness),
    "image contrast": lambda m: _mean(m.contrasts),
    "image darker than 32, below the horizon": lambda m: _mean(m.dark_shares),
    **{
        f"image gradient {start} to {end}": _gradient_share(position)
        for position, (start, end) in enumerate(itertools.pairwise((0, *GRADIENTS, "more")))
    },
}
STATISTICS: Final[Mapping[str, _Compute]] = {**_POINTS, **_OBJECTS, **_IMAGES}
