"""Body styles of cars and vans: proportions, frequencies and sizes."""

from dataclasses import dataclass, replace

from sightline.simulation.meshes.body import BodyForm
from sightline.simulation.meshes.sizes import Kind, Size


@dataclass(frozen=True, kw_only=True, slots=True)
class CarStyle:
    """A body style of cars or vans."""

    kind: Kind
    form: BodyForm
    seat_rows: tuple[float, ...] = (-0.05, -0.50)
    """Places of the seats' backs."""
    rails: float = 0.0
    """Probability of roof rails; the following fields are probabilities of other parts."""
    spoiler: float = 0.0
    """Spoiler over the rear window."""
    pillar_lamps: float = 0.0
    """Tail lights beside the rear window."""
    spare_wheel: float = 0.0
    """Spare wheel on the rear door."""
    roof_load: float = 0.01
    """Box or ladder on the roof, which labels exclude."""
    soft_top: float = 0.0
    """Roof of cloth."""
    white: float = 0.0
    """White paint, in addition to that of all cars."""


def _shoulder(
    rear: float,
    sill: float,
    wing: float,
    nose: float,
    *,
    boot: float | None = None,
    dash: float = 0.36,
) -> tuple[tuple[float, float], ...]:
    """Build the shoulder's line: rear end, boot lid, window sill, dashboard, wing and nose."""
    behind = ((-0.55, rear - 0.01),) if boot is None else ((-0.73, boot), (-0.45, rear))
    ahead = ((dash, sill), (dash + 0.09, sill + 0.015), (0.9, wing), (1.0, nose))
    return ((-1.0, rear), *behind, *ahead)


_HATCHBACK = BodyForm(
    front_wheel=0.60, rear_wheel=-0.65, wheel_radius=0.205, clearance=0.125,
    shoulder=_shoulder(0.68, 0.63, 0.51, 0.47), screen_base=0.40, screen_top=0.07, rear_base=-0.915,
    rear_top=-0.70, pillars=(-0.08, -0.56), door_gaps=(0.37, -0.09, -0.50),
    tail_levels=(0.69, 0.95), tail_inner=0.70, tail_start=-0.92,
)  # fmt: skip
_SEDAN = replace(
    _HATCHBACK, rear_wheel=-0.60, wheel_radius=0.215,
    shoulder=_shoulder(0.69, 0.645, 0.52, 0.47, boot=0.72), screen_top=0.08,
    rear_insets_m=(0.14, 0.06, 0.01, 0.0, 0.03, 0.045, 0.055, 0.065, 0.075, 0.11, 0.16),
    rear_base=-0.68, rear_top=-0.36, rear_base_spread=0.06, rear_bow_m=0.16, roof_width=0.72,
    roof_fall_rear_m=0.07, pillars=(-0.05, -0.44), door_gaps=(0.36, -0.06, -0.40),
    tail_levels=(0.58, 0.82), tail_inner=0.62, tail_start=-0.90,
)  # fmt: skip
_ESTATE = replace(
    _HATCHBACK, rear_wheel=-0.58, shoulder=_shoulder(0.67, 0.63, 0.52, 0.47), screen_base=0.38,
    screen_top=0.08, rear_base=-0.92, rear_top=-0.75, pillars=(-0.05, -0.42),
    door_gaps=(0.35, -0.06, -0.38), glazed=(True, True, True), last_window_end=0.78,
)  # fmt: skip
_MPV = replace(
    _ESTATE, front_wheel=0.62, rear_wheel=-0.64, wheel_radius=0.19,
    shoulder=_shoulder(0.66, 0.60, 0.51, 0.45, dash=0.45), screen_base=0.50, screen_top=0.14,
    screen_bow_m=0.20, rear_top=-0.81, roof_width=0.79, pillars=(0.0, -0.48),
    door_gaps=(0.44, -0.01, -0.44), last_window_end=0.75,
)  # fmt: skip
_DELIVERY = replace(
    _HATCHBACK, front_wheel=0.62, rear_wheel=-0.62, wheel_radius=0.165, clearance=0.11,
    shoulder=_shoulder(0.55, 0.54, 0.44, 0.42, dash=0.45), screen_base=0.50, screen_top=0.20,
    screen_bow_m=0.20, rear_base=-0.945, rear_top=-0.91, rear_bow_m=0.03, base_width=0.935,
    roof_width=0.84, roof_fall_rear_m=0.02, pillars=(0.02, -0.44), door_gaps=(0.44, 0.0, -0.42),
    glazed=(True, False, False), window_top=0.80,
    rear_insets_m=(0.12, 0.05, 0.01, 0.0, 0.03, 0.035, 0.035, 0.04, 0.045, 0.05, 0.07),
    rear_roundness=9.0, split_rear=True, tail_levels=(0.58, 0.95), tail_inner=0.82,
    tail_start=-0.965,
)  # fmt: skip
_GLAZED_VAN = replace(_DELIVERY, split_rear=False, glazed=(True, True, True), last_window_end=0.85)

STYLES: dict[str, CarStyle] = {
    "hatchback": CarStyle(
        kind=Kind(share=0.26, mean_size=Size(3.80, 1.63, 1.47)), form=_HATCHBACK, spoiler=0.35,
        pillar_lamps=0.3,
    ),
    "sedan": CarStyle(kind=Kind(share=0.13, mean_size=Size(4.25, 1.65, 1.43)), form=_SEDAN),
    "liftback": CarStyle(
        kind=Kind(share=0.05, mean_size=Size(4.20, 1.66, 1.44)), spoiler=0.2,
        form=replace(
            _SEDAN, rear_base=-0.84, rear_top=-0.39, rear_base_spread=0.03, rear_bow_m=0.10
        ),
    ),
    "city car": CarStyle(
        kind=Kind(share=0.12, mean_size=Size(3.35, 1.55, 1.48)), seat_rows=(-0.12,), spoiler=0.2,
        pillar_lamps=0.3, soft_top=0.05,
        form=replace(
            _HATCHBACK, front_wheel=0.66, rear_wheel=-0.71, wheel_radius=0.19,
            shoulder=_shoulder(0.66, 0.61, 0.52, 0.47, dash=0.45), screen_base=0.50,
            screen_top=0.20, rear_base=-0.895, rear_top=-0.79, roof_width=0.78,
            pillars=(-0.16, -0.74), door_gaps=(0.44, -0.20), front_roundness=4.2,
            rear_roundness=7.5, lamp_end=0.74,
        ),
    ),
    "estate": CarStyle(
        kind=Kind(share=0.15, mean_size=Size(4.35, 1.66, 1.47)), rails=0.55, spoiler=0.2,
        pillar_lamps=0.35, roof_load=0.04, form=_ESTATE,
    ),
    "suv": CarStyle(
        kind=Kind(share=0.09, mean_size=Size(4.15, 1.71, 1.69)), rails=0.6, spoiler=0.3,
        pillar_lamps=0.2, spare_wheel=0.25, roof_load=0.03,
        form=replace(
            _ESTATE, rear_wheel=-0.63, wheel_radius=0.215, clearance=0.15,
            shoulder=_shoulder(0.68, 0.64, 0.57, 0.52), screen_base=0.40, screen_top=0.13,
            rear_base=-0.915, roof_width=0.79, pillars=(-0.05, -0.48),
            door_gaps=(0.36, -0.06, -0.44), last_window_end=0.72, cladding=True,
        ),
    ),
    "coupe": CarStyle(
        kind=Kind(share=0.05, mean_size=Size(4.00, 1.67, 1.35)), seat_rows=(-0.15,), soft_top=0.35,
        roof_load=0.0,
        form=replace(
            _SEDAN, wheel_radius=0.235, clearance=0.12,
            shoulder=_shoulder(0.70, 0.65, 0.52, 0.45, boot=0.73), screen_base=0.36,
            screen_top=0.02, rear_base=-0.80, rear_top=-0.29, rear_base_spread=0.04,
            rear_bow_m=0.14, roof_width=0.71, roof_fall_rear_m=0.06, pillars=(-0.16, -0.50),
            door_gaps=(0.34, -0.18), front_roundness=4.5, tail_inner=0.60,
        ),
    ),
    "mpv": CarStyle(
        kind=Kind(share=0.10, mean_size=Size(4.10, 1.67, 1.63)), rails=0.35, spoiler=0.25,
        pillar_lamps=0.4, roof_load=0.04, form=_MPV,
    ),
    "high mpv": CarStyle(
        kind=Kind(share=0.04, mean_size=Size(4.15, 1.72, 1.82)), rails=0.3, pillar_lamps=0.5,
        roof_load=0.03,
        form=replace(
            _GLAZED_VAN, wheel_radius=0.175, shoulder=_shoulder(0.60, 0.57, 0.47, 0.43, dash=0.45),
            tail_levels=(0.69, 0.95),
        ),
    ),
    "pickup": CarStyle(
        kind=Kind(share=0.01, mean_size=Size(4.75, 1.75, 1.73)), seat_rows=(0.02, -0.18),
        roof_load=0.0,
        form=replace(
            _HATCHBACK, front_wheel=0.63, rear_wheel=-0.55, wheel_radius=0.215, clearance=0.16,
            shoulder=_shoulder(0.63, 0.62, 0.56, 0.52), screen_base=0.39, screen_top=0.19,
            rear_base=-0.25, rear_top=-0.18, rear_base_spread=0.03, rear_bow_m=0.02,
            roof_width=0.77, pillars=(0.04, -0.20), door_gaps=(0.35, 0.03, -0.22),
            rear_roundness=10.0, tail_levels=(0.58, 0.95), tail_inner=0.78, tail_start=-0.96,
            cladding=True, covered_bed=True,
        ),
    ),
}  # fmt: skip
"""Styles of cars, by name; shares sum to 1."""

VAN_STYLES: dict[str, CarStyle] = {
    "delivery van": CarStyle(
        kind=Kind(share=0.25, mean_size=Size(4.35, 1.76, 1.88)), white=0.4, seat_rows=(0.02,),
        roof_load=0.06, form=_DELIVERY,
    ),
    "minibus": CarStyle(
        kind=Kind(share=0.45, mean_size=Size(4.95, 1.89, 2.08)), white=0.15,
        seat_rows=(0.18, -0.22, -0.6), roof_load=0.03,
        form=replace(
            _GLAZED_VAN, shoulder=_shoulder(0.54, 0.53, 0.44, 0.42, dash=0.55), wheel_radius=0.155,
            screen_base=0.60, screen_top=0.31, pillars=(0.18, -0.36), door_gaps=(0.54, 0.16, -0.32),
        ),
    ),
    "panel van": CarStyle(
        kind=Kind(share=0.30, mean_size=Size(5.85, 2.03, 2.55)), white=0.55, seat_rows=(0.36,),
        roof_load=0.06,
        form=replace(
            _DELIVERY, wheel_radius=0.135, clearance=0.09,
            shoulder=_shoulder(0.50, 0.49, 0.38, 0.36, dash=0.62), front_wheel=0.68,
            rear_wheel=-0.48, screen_base=0.68, screen_top=0.40, screen_bow_m=0.24,
            rear_base=-0.965, rear_top=-0.937, roof_width=0.87, pillars=(0.28, -0.25),
            door_gaps=(0.62, 0.26, -0.10), window_top=0.66, rear_glazed=False, roof_crown_m=0.07,
            roof_fall_front_m=0.16,
        ),
    ),
}  # fmt: skip
"""Styles of vans, by name; shares sum to 1."""
