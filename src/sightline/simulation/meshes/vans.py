"""Vans: small delivery vans, minibuses and panel vans, sized as KITTI's labels are."""

from dataclasses import replace

import numpy as np

from sightline.simulation.meshes.body import BodyForm
from sightline.simulation.meshes.cars import CarStyle, make_vehicle
from sightline.simulation.meshes.models import ActorModel
from sightline.simulation.meshes.sizes import Kind, Size

_DELIVERY = BodyForm(
    front_wheel=0.62,
    rear_wheel=-0.62,
    wheel_radius=0.165,
    clearance=0.11,
    shoulder=((-1.0, 0.55), (0.45, 0.54), (0.55, 0.56), (0.9, 0.47), (1.0, 0.45)),
    screen_base=0.50,
    screen_top=0.20,
    screen_bow_m=0.20,
    rear_base=-0.945,
    rear_top=-0.92,
    rear_bow_m=0.03,
    base_width=0.935,
    roof_width=0.84,
    roof_fall_rear_m=0.02,
    pillars=(0.02, -0.44),
    door_gaps=(0.44, 0.0, -0.42),
    glazed=(True, False, False),
    window_top=0.80,
    rear_insets_m=(0.12, 0.05, 0.01, 0.0, 0.03, 0.035, 0.035, 0.04, 0.045, 0.05, 0.07),
    rear_roundness=9.0,
    split_rear=True,
    tail_levels=(0.58, 0.95),
    tail_inner=0.82,
    tail_start=-0.965,
)
_PANEL_VAN = replace(
    _DELIVERY,
    wheel_radius=0.135,
    clearance=0.09,
    shoulder=((-1.0, 0.50), (0.62, 0.49), (0.70, 0.49), (0.92, 0.41), (1.0, 0.39)),
    front_wheel=0.68,
    rear_wheel=-0.48,
    screen_base=0.68,
    screen_top=0.40,
    screen_bow_m=0.24,
    rear_base=-0.965,
    rear_top=-0.945,
    roof_width=0.87,
    pillars=(0.28, -0.25),
    door_gaps=(0.62, 0.26, -0.10),
    window_top=0.66,
    rear_glazed=False,
    roof_crown_m=0.07,
    roof_fall_front_m=0.16,
)


VAN_STYLES: dict[str, CarStyle] = {
    "delivery van": CarStyle(
        kind=Kind(share=0.25, mean_size=Size(4.35, 1.76, 1.88)),
        white_share=0.4,
        seat_rows=(0.02,),
        form=_DELIVERY,
    ),
    "minibus": CarStyle(
        kind=Kind(share=0.45, mean_size=Size(4.95, 1.89, 2.08)),
        white_share=0.15,
        seat_rows=(0.18, -0.22, -0.6),
        form=replace(
            _DELIVERY,
            shoulder=((-1.0, 0.54), (0.55, 0.53), (0.64, 0.54), (0.92, 0.47), (1.0, 0.45)),
            wheel_radius=0.155,
            screen_base=0.60,
            screen_top=0.31,
            pillars=(0.18, -0.36),
            door_gaps=(0.54, 0.16, -0.32),
            split_rear=False,
            glazed=(True, True, True),
            last_window_end=0.85,
        ),
    ),
    "panel van": CarStyle(
        kind=Kind(share=0.30, mean_size=Size(5.85, 2.03, 2.55)),
        white_share=0.55,
        seat_rows=(0.36,),
        form=_PANEL_VAN,
    ),
}
"""By name; shares sum to 1."""

_STYLE_SPREAD = Size(0.45, 0.10, 0.15)


def make_van(rng: np.random.Generator, style: str | None = None) -> ActorModel:
    """A van; without a `style` one of `VAN_STYLES` that suits a size drawn as KITTI's are.

    Raises:
        ValueError: If there is no such style.
    """
    return make_vehicle(rng, "Van", VAN_STYLES, _STYLE_SPREAD, style)
