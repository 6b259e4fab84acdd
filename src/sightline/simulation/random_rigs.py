"""Random rigs, for networks that meet other cameras and LiDARs than KITTI's."""

import math
from typing import Final, get_args

import numpy as np

from sightline.simulation.rigs import CameraRig, LidarRig, PointOrder, Rig, Rosette

_RINGS: Final = (16, 32, 40, 64, 128)
_FOCAL_PX: Final = (500.0, 2500.0)
_WIDTH_PX: Final = (800.0, 2048.0)
_WIDTH_DEG: Final = (30.0, 100.0)
_ASPECT: Final = (0.3, 0.75)  # height by width
_HORIZON: Final = (0.15, 0.75)  # limits of the horizon's row, as a share of the height
_MAX_PITCH_DEG, _MAX_ROLL_DEG = 8.0, 3.0
_CAMERA_HEIGHT_M: Final = (1.1, 2.5)
_LIDAR_HEIGHT_M: Final = (1.2, 2.5)
_NO_REFLECTANCE_SHARE, _ROSETTE_SHARE, _LEVEL_SHARE, _BONNET_SHARE = 0.15, 0.1, 0.4, 0.5
_BONNET: Final = (0.72, 0.98)  # limits of the bonnet's upper edge, as a share of the height
_BONNET_AWAY_M: Final = 1.3  # about the distance of this edge
_BONNET_HEIGHT_M: Final = (0.75, 1.6)
_MIN_BONNET_GAP_M: Final = 0.12
_DIRTY_SHARE, _ROLLING_SHARE, _ROOF_SHARE = 0.35, 0.5, 0.5
_DIRT: Final = (0.1, 0.8)
_READOUT_MS: Final = (5.0, 35.0)
_ORDER_SHARES: Final = {"rings": 0.45, "firings": 0.4, "none": 0.15}
_ROOF_M: Final = (1.3, 2.2)
_ABOVE_ROOF_M: Final = (0.12, 0.6)


def random_rig(rng: np.random.Generator) -> Rig:
    """Draw a rig; the same generator state gives the same rig."""
    lidar_height_m = float(rng.uniform(*_LIDAR_HEIGHT_M))
    return Rig(
        name="random",
        camera=_random_camera(rng, lidar_height_m),
        lidar=_random_lidar(rng, lidar_height_m),
    )


def _random_camera(rng: np.random.Generator, lidar_height_m: float) -> CameraRig:
    focal_px = 0.0
    while not _FOCAL_PX[0] <= focal_px <= _FOCAL_PX[1]:
        width = int(_log_uniform(rng, *_WIDTH_PX)) // 2 * 2
        focal_px = width / 2 / math.tan(math.radians(rng.uniform(*_WIDTH_DEG)) / 2)
    height = int(width * rng.uniform(*_ASPECT)) // 2 * 2
    x, y = (float(rng.normal(size / 2, 0.015 * size)) for size in (width, height))
    # A low view keeps its horizon, so that the road is in view.
    highest, lowest = (math.degrees(math.atan((y - s * height) / focal_px)) for s in _HORIZON)
    pitch_deg = np.clip(
        _peaked(rng, _MAX_PITCH_DEG), max(lowest, -_MAX_PITCH_DEG), min(highest, _MAX_PITCH_DEG)
    )
    lowest_m, highest_m = _CAMERA_HEIGHT_M
    height_m = float(
        rng.uniform(max(lowest_m, lidar_height_m - 1), min(highest_m, lidar_height_m + 0.2))
    )
    gain = float(rng.uniform(0.85, 1.18))
    # A bonnet is as high as it takes to reach a row of the image, where a car's can be so high.
    below_deg = pitch_deg + math.degrees(math.atan((rng.uniform(*_BONNET) * height - y) / focal_px))
    bonnet_m = height_m - _BONNET_AWAY_M * math.tan(math.radians(below_deg))
    has_bonnet = rng.random() < _BONNET_SHARE
    lowest_m, highest_m = _BONNET_HEIGHT_M
    has_bonnet &= lowest_m < bonnet_m < min(highest_m, height_m - _MIN_BONNET_GAP_M)
    return CameraRig(
        image_size=(height, width),
        focal_px=round(focal_px, 2),
        principal_px=(round(x, 1), round(y, 1)),
        height_m=round(height_m, 3),
        ahead_m=round(float(rng.uniform(-0.3, 1.8)), 3),
        left_m=round(float(rng.uniform(-0.5, 0.5)), 3),
        pitch_deg=round(float(pitch_deg), 2),
        roll_deg=round(_peaked(rng, _MAX_ROLL_DEG), 2),
        white_balance=(round(gain, 3), 1.0, round(float(1 / gain * rng.uniform(0.93, 1.07)), 3)),
        jpeg_quality=int(rng.integers(60, 100)) if rng.random() < 0.7 else 100,
        bonnet_m=round(float(bonnet_m), 2) if has_bonnet else 0.0,
        dirt=round(float(rng.uniform(*_DIRT)), 2) if rng.random() < _DIRTY_SHARE else 0.0,
        readout_ms=round(float(rng.uniform(*_READOUT_MS)), 1)
        if rng.random() < _ROLLING_SHARE
        else 0.0,
    )


def _random_lidar(rng: np.random.Generator, height_m: float) -> LidarRig:
    rosette, elevations = None, _random_rings(rng)
    if rng.random() < _ROSETTE_SHARE:
        rosette, elevations = _random_rosette(rng), ()
    is_level = rng.random() < _LEVEL_SHARE
    pitch_deg, roll_deg = (0.0 if is_level else _peaked(rng, 3.0) for _ in range(2))
    dense = len(elevations) > 64
    hides_rear = rng.random() < 0.5
    roof_m = round(height_m - float(rng.uniform(*_ABOVE_ROOF_M)), 2)
    has_roof = rng.random() < _ROOF_SHARE and _ROOF_M[0] <= roof_m <= _ROOF_M[1]
    orders = get_args(PointOrder)
    order = orders[int(rng.choice(len(orders), p=[_ORDER_SHARES[each] for each in orders]))]
    return LidarRig(
        elevations_deg=elevations,
        rosette=rosette,
        azimuth_step_deg=round(float(rng.uniform(0.17 if dense else 0.1, 0.4)), 4),
        blind_sectors=((150.0, 210.0, -15.0),) if hides_rear else (),
        height_m=round(height_m, 3),
        pitch_deg=round(pitch_deg, 2),
        roll_deg=round(roll_deg, 2),
        range_m=round(_log_uniform(rng, 60.0, 200.0), 1),
        range_noise_m=round(_log_uniform(rng, 0.01, 0.05), 4),
        reflectance=0.0
        if rng.random() < _NO_REFLECTANCE_SHARE
        else round(float(rng.uniform(0.3, 1.5)), 2),
        order=order,
        roof_m=roof_m if has_roof else 0.0,
    )


def _random_rings(rng: np.random.Generator) -> tuple[float, ...]:
    """Draw rings in equal steps, or denser around the horizon as in long-range sensors."""
    count = int(rng.choice(_RINGS))
    top_deg, bottom_deg = float(rng.uniform(2, 22)), float(rng.uniform(-30, -14))
    places = np.linspace(0, 1, count)
    elevations = top_deg + (bottom_deg - top_deg) * places
    if rng.random() < 0.5:
        middle = rng.uniform(-4, 0)
        reach = np.where(elevations > middle, top_deg - middle, middle - bottom_deg)
        shares = (elevations - middle) / reach
        elevations = middle + reach * np.sign(shares) * np.abs(shares) ** rng.uniform(1.2, 2.2)
    return tuple(float(each) for each in elevations.round(3))


def _random_rosette(rng: np.random.Generator) -> Rosette:
    return Rosette(
        width_deg=round(float(rng.uniform(60, 120)), 1),
        height_deg=round(float(rng.uniform(22, 40)), 1),
        points=int(rng.integers(20_000, 80_000)),
    )


def _peaked(rng: np.random.Generator, limit: float) -> float:
    """Draw an angle within +-`limit`, small ones more often."""
    return float(rng.uniform(-limit, limit) * rng.uniform())


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
