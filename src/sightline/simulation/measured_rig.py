"""Measurement of a recording's rig: camera, LiDAR and mounts as the simulator takes them."""

import contextlib
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, Final

import numpy as np
import yaml
from jaxtyping import Float64

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.formats.rings import rings_of_any_order
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.tilt import Tilt
from sightline.simulation.camera.samples import LEVEL_CAMERA_AXES
from sightline.simulation.rigs import CameraRig, LidarRig, Rig, Rosette
from sightline.structures.sample import CameraLidarSample

_FRAMES: Final = 5  # of the recording, evenly spread
_MIN_POINTS: Final = 1000
_MIN_RING_POINTS: Final = 20  # of a ring whose elevation counts
_FARTHEST_SHARE: Final = 0.999  # of the points: beyond are stray echoes
_VIEW_SHARES: Final = (0.005, 0.995)  # of the points: edges of a LiDAR without rings
_REACH_SHARE: Final = 0.9  # of the largest range: farther returns are rare
_RANGES_M: Final = (20.0, 250.0)
_STEPS_DEG: Final = (0.02, 5.0)
_SAME_CAMERA: Final = 1.05
"""Largest ratio of focal lengths, or widths, of one camera: those of KITTI's days differ by 2 %."""
_SAME_LIDAR: Final = 1.5
"""Largest ratio of the numbers of rings of one LiDAR: those into the sky have no return."""
_CLOSE_STEP: Final = 0.2
"""Share of a wide step between rings that steps between parts of one ring do not reach."""
_WIDE_STEP_QUANTILE: Final = 0.9
_MIN_CLOSE_SHARE: Final = 0.25
_MAX_PARTS: Final = 6  # of a ring
_REMEDY: Final = "give the rig's file by --rig (docs/guides/simulate.md, Other rigs)"


@dataclass(frozen=True, kw_only=True, slots=True)
class MeasuredRig:
    """Rig of a recording, and what could not be measured."""

    rig: Rig
    notes: tuple[str, ...]
    """Assumptions in place of measurements."""


def measure_rig(dataset: SampleDataset, name: str) -> MeasuredRig:
    """Measure the rig from calibration, image size and a few sweeps of a recording.

    Rings are found by the order of the points or by elevation; a sweep without rings becomes a
    solid-state pattern of the same view and number of points. Range noise, scale of reflectances,
    exposure and the own car's parts in view are not measured.

    Args:
        dataset: Samples with points; images are not needed.
        name: Name for the rig.

    Raises:
        ValueError: No frame has enough points, or a number is beyond what can be simulated.
    """
    samples = spread_samples(dataset, _FRAMES)
    swept = swept_samples(samples)
    if not swept:
        has_clouds = any(sample.points is not None for sample in samples)
        lacking = f"{_MIN_POINTS} points" if has_clouds else "a point cloud"
        raise ValueError(
            f"none of {len(samples)} frames has {lacking}, by which the LiDAR is measured; "
            f"{_REMEDY}"
        )
    sample = swept[len(swept) // 2]
    notes = [*_notes_on_other_cameras(swept, sample), *_notes_on_other_lidars(swept)]
    if sample.lidar_height_m is None:
        notes.append(f"the LiDAR's height is not known: {KITTI_LIDAR_HEIGHT_M} m is assumed")
    try:
        lidar, lidar_notes = measure_lidar(swept)
        notes += lidar_notes
        rig = Rig(
            name=name,
            camera=measure_camera(sample),
            lidar=lidar,
            source="; ".join(["measured from a recording", *notes]),
        )
    except ValueError as error:
        raise ValueError(f"the rig cannot be simulated: {error}; {_REMEDY}") from error
    return MeasuredRig(rig=rig, notes=tuple(notes))


def _notes_on_other_cameras(
    samples: Sequence[CameraLidarSample], chosen: CameraLidarSample
) -> list[str]:
    """Tell that frames are of several cameras, of which one is taken."""
    views = [
        (float(each.calibration.image_from_camera[0, 0]), each.image_size[1]) for each in samples
    ]
    lows, highs = np.min(views, axis=0), np.max(views, axis=0)
    if (highs <= _SAME_CAMERA * lows).all():
        return []
    focal_px = float(chosen.calibration.image_from_camera[0, 0])
    return [
        f"the {len(samples)} frames measured have several cameras (focal length {lows[0]:.0f} to "
        f"{highs[0]:.0f} px, width {lows[1]:.0f} to {highs[1]:.0f} px): only that of "
        f"{chosen.sample_id}, {focal_px:.0f} px, is simulated; adapt to each by a data set of its "
        "frames"
    ]


def _notes_on_other_lidars(samples: Sequence[CameraLidarSample]) -> list[str]:
    """Tell that sweeps are of several LiDARs, of which the one with most points is taken."""
    counts = []
    for sample in samples:
        assert sample.points is not None, "a swept sample has points"
        with contextlib.suppress(ValueError):  # without rings
            elevations_deg, _ = _measure_rings(sample.points.double().numpy())
            counts.append(len(_joined_parts(elevations_deg)))
    if not counts or max(counts) <= _SAME_LIDAR * min(counts):
        return []
    return [
        f"the {len(samples)} frames measured have several LiDARs ({min(counts)} to {max(counts)} "
        "rings): only that of the frame with most points is simulated; adapt to each by a data "
        "set of its frames"
    ]


def _joined_parts(elevations_deg: Sequence[float]) -> list[float]:
    """Join rings of nearly one elevation, if there are many: lost points cut rings into parts."""
    ordered = np.sort(np.array(elevations_deg))
    steps = np.diff(ordered)
    if len(steps) < 2:
        return list(elevations_deg)
    is_close = steps < _CLOSE_STEP * np.quantile(steps, _WIDE_STEP_QUANTILE)
    if is_close.mean() < _MIN_CLOSE_SHARE:
        return list(elevations_deg)
    groups = np.split(ordered, np.flatnonzero(~is_close) + 1)
    if max(map(len, groups)) > _MAX_PARTS:  # a sensor with its rings close together in the middle
        return list(elevations_deg)
    return [round(float(np.median(group)), 2) for group in groups]


def spread_samples(dataset: SampleDataset, number: int) -> list[CameraLidarSample]:
    """Read up to `number` samples, evenly spread over a data set."""
    positions = np.linspace(0, len(dataset) - 1, min(number, len(dataset))).round().astype(int)
    return [dataset[int(position)] for position in positions]


def swept_samples(samples: Sequence[CameraLidarSample]) -> list[CameraLidarSample]:
    """Select the samples with enough points to measure their LiDAR."""
    return [
        sample
        for sample in samples
        if sample.points is not None and len(sample.points) >= _MIN_POINTS
    ]


def rig_text(rig: Rig) -> str:
    """Format a rig as the YAML file that `simulation.rigs.read_rig` reads."""
    height, width = rig.camera.image_size
    camera = {**_entries(rig.camera), "image_size": {"width": width, "height": height}}
    content = {"source": rig.source, "camera": camera, "lidar": _entries(rig.lidar)}
    text: str = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    return text


def _entries(part: CameraRig | LidarRig) -> dict[str, Any]:
    """Entries that differ from the defaults, with lists for tuples."""
    plain = asdict(part)
    return {
        each.name: _as_lists(plain[each.name])
        for each in fields(part)
        if getattr(part, each.name) != each.default
    }


def _as_lists(value: Any) -> Any:  # noqa: ANN401 - any plain value
    return [_as_lists(each) for each in value] if isinstance(value, tuple) else value


def _level_from_lidar(sample: CameraLidarSample) -> Float64[np.ndarray, "3 3"]:
    if sample.level_from_lidar is None:
        return np.eye(3)
    rotation: Float64[np.ndarray, "3 3"] = sample.level_from_lidar[:3, :3].numpy()
    return rotation


def _lidar_height_m(sample: CameraLidarSample) -> float:
    height_m = sample.lidar_height_m
    return KITTI_LIDAR_HEIGHT_M if height_m is None else height_m


def measure_camera(sample: CameraLidarSample) -> CameraRig:
    """Measure intrinsics, and the mount in the level frame, whose x axis lies along the view.

    Raises:
        ValueError: A number is beyond what can be simulated.
    """
    projection = sample.calibration.image_from_camera.numpy()
    camera_from_lidar = sample.calibration.camera_from_lidar.numpy()
    camera_from_level = camera_from_lidar[:3, :3] @ _level_from_lidar(sample).T
    # The image's own camera stands where the projection's last column says (KITTI's baseline).
    own = np.linalg.solve(projection[:, :3], projection[:, 3])
    place = -camera_from_level.T @ (camera_from_lidar[:3, 3] + own)
    body_from_level = LEVEL_CAMERA_AXES.T @ camera_from_level
    tilt = Tilt.from_up(body_from_level[:, 2])
    return CameraRig(
        image_size=sample.image_size,
        focal_px=round(float(projection[0, 0] + projection[1, 1]) / 2, 3),
        principal_px=(round(float(projection[0, 2]), 3), round(float(projection[1, 2]), 3)),
        height_m=round(_lidar_height_m(sample) + float(place[2]), 3),
        ahead_m=round(float(place[0]), 3),
        left_m=round(float(place[1]), 3),
        pitch_deg=_rounded(tilt.pitch_deg),
        roll_deg=_rounded(tilt.roll_deg),
    )


def measure_lidar(samples: Sequence[CameraLidarSample]) -> tuple[LidarRig, tuple[str, ...]]:
    """Measure a LiDAR by some samples, its mount by the middle one; also returns assumptions.

    Raises:
        ValueError: No ring has enough points, or a number is beyond what can be simulated.
    """
    middle = samples[len(samples) // 2]
    sweeps = [sample.points.double().numpy() for sample in samples if sample.points is not None]
    ranges_m = np.concatenate([np.linalg.norm(sweep[:, :3], axis=1) for sweep in sweeps])
    reach_m = np.quantile(ranges_m, _FARTHEST_SHARE)
    level_from_lidar = _level_from_lidar(middle)
    ahead = level_from_lidar.T[:, 0]  # of the level frame, in the LiDAR's own
    turn = math.atan2(ahead[1], ahead[0])
    own_from_ahead = np.array(
        [[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]]
    )
    tilt = Tilt.from_up(own_from_ahead.T @ level_from_lidar[2])
    common: dict[str, Any] = {
        "height_m": round(_lidar_height_m(middle), 3),
        "pitch_deg": _rounded(tilt.pitch_deg),
        "roll_deg": _rounded(tilt.roll_deg),
        "range_m": round(float((reach_m / _REACH_SHARE).clip(*_RANGES_M)), 1),
        "reflectance": float(any(sweep[:, 3].any() for sweep in sweeps)),
    }
    notes = []
    measured, sweep = None, max(sweeps, key=len)
    for number, each in enumerate(sorted(sweeps, key=len, reverse=True)):
        with contextlib.suppress(ValueError):  # without rings
            measured = _measure_rings(each)
            if number:
                notes.append(f"no rings are found in {number} of the sweeps measured, the largest")
            break
    if measured is None:
        xyz = sweep[:, :3] @ own_from_ahead
        azimuth_deg, elevation_deg = _angles_deg(xyz)
        notes.append("no rings are found: a pattern without rings is simulated")
        rosette = Rosette(
            width_deg=_span_deg(azimuth_deg, 5.0, 120.0),
            height_deg=_span_deg(elevation_deg, 5.0, 90.0),
            points=len(sweep),
        )
        return LidarRig(rosette=rosette, **common), tuple(notes)
    rings, steps = measured
    if not steps:
        raise ValueError(f"no ring of its LiDAR has {_MIN_RING_POINTS} points")
    whole = _joined_parts(rings)
    if len(whole) < len(rings):
        notes.append(
            f"{len(rings)} parts of rings are taken for {len(whole)} rings: many have nearly the "
            "elevation of another"
        )
    return LidarRig(
        elevations_deg=tuple(sorted(whole, reverse=True)),
        azimuth_step_deg=round(float(np.median(steps).clip(*_STEPS_DEG)), 3),
        **common,
    ), tuple(notes)


def _measure_rings(
    sweep: Float64[np.ndarray, "num_points 4"],
) -> tuple[list[float], list[float]]:
    """Elevations of the rings with enough points, and their steps of azimuth [degrees].

    Raises:
        ValueError: No rings are found.
    """
    numbers, _ = rings_of_any_order(sweep)
    azimuth_deg, elevation_deg = _angles_deg(sweep[:, :3])
    rings, steps = [], []
    for number in np.unique(numbers):
        is_ring = numbers == number
        if np.count_nonzero(is_ring) < _MIN_RING_POINTS:
            continue
        rings.append(round(float(np.median(elevation_deg[is_ring])), 2))
        # A firing may return twice; encoders round azimuths to steps of two lengths.
        gaps_deg = np.diff(np.unique(azimuth_deg[is_ring].round(3)))
        if len(gaps_deg):
            steps.append(float(gaps_deg[gaps_deg < 1.5 * np.median(gaps_deg)].mean()))
    return rings, steps


def _angles_deg(
    xyz: Float64[np.ndarray, "num_points 3"],
) -> tuple[Float64[np.ndarray, " num_points"], Float64[np.ndarray, " num_points"]]:
    """Azimuths, counter-clockwise from ahead, and elevations."""
    x, y, z = xyz.T
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))


def _rounded(angle_deg: float) -> float:
    return round(angle_deg, 2) + 0.0  # no -0.0


def _span_deg(angles_deg: Float64[np.ndarray, " num_points"], least: float, most: float) -> float:
    low, high = np.quantile(angles_deg, _VIEW_SHARES)
    return round(float(np.clip(high - low, least, most)), 1)
