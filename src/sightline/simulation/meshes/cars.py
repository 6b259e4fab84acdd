"""Cars of several body styles, sized as KITTI's labels are."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sightline.simulation.materials import Material
from sightline.simulation.meshes.body import BLACK_PLASTIC, Body, BodyForm, lower_body
from sightline.simulation.meshes.cabin import cabin
from sightline.simulation.meshes.car_parts import (
    ALLOY,
    CHROME,
    front_trim,
    handles,
    mirrors,
    plate,
    rear_door_gap,
    rear_trim,
    roof_rails,
    seats,
    wheel,
    wheels,
)
from sightline.simulation.meshes.edits import fitted
from sightline.simulation.meshes.models import ActorModel, RigidShape
from sightline.simulation.meshes.primitives import Color, Finish
from sightline.simulation.meshes.sizes import KITTI_SIZES, Kind, Size, draw_kind
from sightline.simulation.scene import Mesh


@dataclass(frozen=True, kw_only=True, slots=True)
class CarStyle:
    """A body style of cars or vans."""

    kind: Kind
    form: BodyForm
    rails: float = 0.0
    """Probability of roof rails."""
    seat_rows: tuple[float, ...] = (-0.05, -0.50)
    """Places of the seats' backs."""
    white_share: float = 0.0
    """Probability of white paint beyond that of all cars."""


_BOOT = (0.14, 0.06, 0.01, 0.0, 0.03, 0.045, 0.055, 0.065, 0.075, 0.11, 0.16)
_HATCHBACK = BodyForm(
    front_wheel=0.60,
    rear_wheel=-0.65,
    wheel_radius=0.205,
    clearance=0.125,
    shoulder=((-1.0, 0.68), (-0.6, 0.67), (0.36, 0.63), (0.46, 0.645), (0.9, 0.54), (1.0, 0.50)),
    screen_base=0.40,
    screen_top=0.07,
    rear_base=-0.915,
    rear_top=-0.76,
    pillars=(-0.08, -0.56),
    door_gaps=(0.37, -0.09, -0.50),
    tail_levels=(0.69, 0.95),
    tail_inner=0.70,
    tail_start=-0.92,
)
STYLES: dict[str, CarStyle] = {
    "hatchback": CarStyle(kind=Kind(share=0.27, mean_size=Size(3.80, 1.63, 1.47)), form=_HATCHBACK),
    "sedan": CarStyle(
        kind=Kind(share=0.17, mean_size=Size(4.25, 1.65, 1.43)),
        form=replace(
            _HATCHBACK,
            rear_wheel=-0.60,
            wheel_radius=0.215,
            shoulder=(
                *((-1.0, 0.69), (-0.72, 0.72), (-0.5, 0.69)),
                *((0.36, 0.645), (0.45, 0.655), (0.9, 0.55), (1.0, 0.50)),
            ),
            screen_top=0.08,
            rear_insets_m=_BOOT,
            rear_base=-0.68,
            rear_top=-0.42,
            rear_bow_m=0.16,
            roof_width=0.72,
            roof_fall_rear_m=0.07,
            pillars=(-0.05, -0.44),
            door_gaps=(0.36, -0.06, -0.40),
            tail_levels=(0.58, 0.82),
            tail_inner=0.62,
            tail_start=-0.90,
        ),
    ),
    "city car": CarStyle(
        kind=Kind(share=0.13, mean_size=Size(3.35, 1.55, 1.48)),
        seat_rows=(-0.12,),
        form=replace(
            _HATCHBACK,
            front_wheel=0.66,
            rear_wheel=-0.71,
            wheel_radius=0.19,
            shoulder=(
                (-1.0, 0.66),
                (-0.5, 0.65),
                (0.45, 0.61),
                (0.55, 0.63),
                (0.9, 0.55),
                (1.0, 0.50),
            ),
            screen_base=0.50,
            screen_top=0.20,
            rear_base=-0.895,
            rear_top=-0.82,
            roof_width=0.78,
            pillars=(-0.16, -0.74),
            door_gaps=(0.44, -0.20),
            front_roundness=4.2,
            rear_roundness=7.5,
            lamp_end=0.74,
        ),
    ),
    "estate": CarStyle(
        kind=Kind(share=0.14, mean_size=Size(4.35, 1.66, 1.47)),
        rails=0.55,
        form=replace(
            _HATCHBACK,
            rear_wheel=-0.58,
            shoulder=(
                (-1.0, 0.67),
                (-0.5, 0.66),
                (0.36, 0.63),
                (0.45, 0.645),
                (0.9, 0.55),
                (1.0, 0.50),
            ),
            screen_base=0.38,
            screen_top=0.08,
            rear_base=-0.92,
            rear_top=-0.80,
            pillars=(-0.05, -0.42),
            door_gaps=(0.35, -0.06, -0.38),
            glazed=(True, True, True),
            last_window_end=0.78,
        ),
    ),
    "suv": CarStyle(
        kind=Kind(share=0.09, mean_size=Size(4.15, 1.71, 1.69)),
        rails=0.6,
        form=replace(
            _HATCHBACK,
            rear_wheel=-0.63,
            wheel_radius=0.215,
            clearance=0.15,
            shoulder=(
                (-1.0, 0.68),
                (-0.5, 0.66),
                (0.36, 0.64),
                (0.45, 0.655),
                (0.9, 0.60),
                (1.0, 0.55),
            ),
            screen_base=0.40,
            screen_top=0.13,
            rear_base=-0.915,
            rear_top=-0.80,
            roof_width=0.79,
            pillars=(-0.05, -0.48),
            door_gaps=(0.36, -0.06, -0.44),
            glazed=(True, True, True),
            last_window_end=0.72,
            cladding=True,
        ),
    ),
    "coupe": CarStyle(
        kind=Kind(share=0.05, mean_size=Size(4.00, 1.67, 1.35)),
        seat_rows=(-0.15,),
        form=replace(
            _HATCHBACK,
            rear_wheel=-0.60,
            wheel_radius=0.235,
            clearance=0.12,
            shoulder=(
                (-1.0, 0.70),
                (-0.75, 0.73),
                (-0.4, 0.70),
                (0.36, 0.65),
                (0.9, 0.55),
                (1.0, 0.48),
            ),
            screen_base=0.36,
            screen_top=0.02,
            rear_insets_m=_BOOT,
            rear_base=-0.80,
            rear_top=-0.34,
            rear_bow_m=0.14,
            roof_width=0.71,
            pillars=(-0.16, -0.50),
            door_gaps=(0.34, -0.18),
            front_roundness=4.5,
            tail_levels=(0.58, 0.82),
            tail_inner=0.60,
            tail_start=-0.90,
        ),
    ),
    "mpv": CarStyle(
        kind=Kind(share=0.13, mean_size=Size(4.10, 1.67, 1.63)),
        rails=0.35,
        form=replace(
            _HATCHBACK,
            front_wheel=0.62,
            rear_wheel=-0.64,
            wheel_radius=0.19,
            shoulder=(
                (-1.0, 0.66),
                (-0.5, 0.64),
                (0.45, 0.60),
                (0.55, 0.62),
                (0.9, 0.54),
                (1.0, 0.48),
            ),
            screen_base=0.50,
            screen_top=0.14,
            screen_bow_m=0.20,
            rear_base=-0.92,
            rear_top=-0.84,
            roof_width=0.79,
            pillars=(0.0, -0.48),
            door_gaps=(0.44, -0.01, -0.44),
            glazed=(True, True, True),
            last_window_end=0.75,
        ),
    ),
    "pickup": CarStyle(
        kind=Kind(share=0.02, mean_size=Size(4.75, 1.75, 1.73)),
        seat_rows=(0.02, -0.18),
        form=replace(
            _HATCHBACK,
            front_wheel=0.63,
            rear_wheel=-0.55,
            wheel_radius=0.215,
            clearance=0.16,
            shoulder=(
                (-1.0, 0.63),
                (-0.5, 0.63),
                (0.36, 0.62),
                (0.45, 0.635),
                (0.9, 0.59),
                (1.0, 0.55),
            ),
            screen_base=0.39,
            screen_top=0.19,
            rear_base=-0.25,
            rear_top=-0.20,
            rear_bow_m=0.02,
            roof_width=0.77,
            pillars=(0.04, -0.20),
            door_gaps=(0.35, 0.03, -0.22),
            rear_roundness=10.0,
            tail_levels=(0.58, 0.95),
            tail_inner=0.78,
            tail_start=-0.96,
            cladding=True,
            covered_bed=True,
        ),
    ),
}
"""By name; shares sum to 1."""

_STYLE_SPREAD = Size(0.30, 0.08, 0.08)
_WHITE = Finish(Material.CAR_PAINT, (0.68, 0.68, 0.66))
_PAINTS: tuple[tuple[float, Color], ...] = (  # share, linear albedo; roughly Germany around 2010
    (0.27, (0.012, 0.012, 0.013)),
    (0.13, (0.045, 0.047, 0.052)),
    (0.14, (0.13, 0.135, 0.14)),
    (0.18, (0.36, 0.37, 0.38)),
    (0.12, (0.68, 0.68, 0.66)),
    (0.05, (0.012, 0.025, 0.095)),
    (0.03, (0.045, 0.12, 0.32)),
    (0.045, (0.33, 0.015, 0.015)),
    (0.01, (0.13, 0.012, 0.02)),
    (0.012, (0.02, 0.07, 0.035)),
    (0.008, (0.55, 0.36, 0.02)),
    (0.005, (0.35, 0.14, 0.02)),
)


def make_car(rng: np.random.Generator, style: str | None = None) -> ActorModel:
    """A car; without a `style` one of `STYLES` that suits a size drawn as KITTI's are.

    Raises:
        ValueError: If there is no such style.
    """
    return make_vehicle(rng, "Car", STYLES, _STYLE_SPREAD, style)


def make_vehicle(
    rng: np.random.Generator,
    class_name: str,
    styles: Mapping[str, CarStyle],
    spread: Size,
    style: str | None,
) -> ActorModel:
    """A car or a van in one of the styles of its class; `spread` [m] is that within a style.

    Raises:
        ValueError: If there is no such style.
    """
    names = list(styles)
    if style is not None and style not in styles:
        raise ValueError(f"no {class_name} style is called {style!r}; use one of {names}")
    wanted = None if style is None else names.index(style)
    kinds = [styles[name].kind for name in names]
    index, size = draw_kind(rng, KITTI_SIZES[class_name], kinds, spread, wanted)
    chosen = styles[names[index]]
    white = rng.random() < chosen.white_share
    body = Body(
        form=varied(rng, chosen.form),
        length=size.length,
        width=size.width,
        height=size.height,
        paint=_WHITE if white else draw_paint(rng),
    )
    parts = vehicle_parts(rng, body, chosen.seat_rows)
    if rng.random() < chosen.rails:
        parts += roof_rails(body, CHROME if rng.random() < 0.5 else BLACK_PLASTIC)
    if chosen.form.split_rear:
        parts.append(rear_door_gap(body))
    mesh = fitted(Mesh.joined(parts), size)
    return ActorModel(class_name=class_name, size_lwh=size, shape=RigidShape(mesh=mesh))


def vehicle_parts(rng: np.random.Generator, body: Body, seat_rows: tuple[float, ...]) -> list[Mesh]:
    """A body with all that every car and van has mounted."""
    tyre = 0.20 if body.wheel_radius < 0.33 else 0.22
    one = wheel(rng, body.wheel_radius, tyre, rim=ALLOY)
    half = body.length / 2
    shell = body.paint if rng.random() < 0.75 else BLACK_PLASTIC
    rear_level = 0.64 if body.form.tail_levels[0] > 0.6 or rng.random() < 0.6 else 0.38
    return [
        lower_body(body),
        cabin(body),
        *wheels(one, body.wheel_places, body.width / 2 - tyre / 2 - 0.015, body.wheel_radius),
        *mirrors(body, shell),
        *handles(body, shell),
        *front_trim(rng, body),
        *rear_trim(rng, body),
        *plate(rng, body.front_x(0.40) + 0.004, body.level_height(half, 0.40), 1),
        *plate(rng, body.rear_x(rear_level) - 0.004, body.level_height(-half, rear_level), -1),
        *seats(body, [place * half for place in seat_rows]),
    ]


def varied(rng: np.random.Generator, form: BodyForm) -> BodyForm:
    """The form with the differences between makes."""
    slope, rear, roof, wheel_size, nose = rng.uniform(-1.0, 1, 5)
    lamp_low, lamp_high = ((0.58, 0.78), (0.69, 0.82))[int(rng.integers(2))]
    grille_high = 0.78 if rng.random() < 0.6 else 0.69
    front = np.array(form.front_insets_m) * (1 + 0.25 * nose)
    return replace(
        form,
        screen_top=form.screen_top + 0.025 * slope,
        rear_top=form.rear_top + 0.025 * rear,
        roof_width=form.roof_width + 0.012 * roof,
        wheel_radius=form.wheel_radius * (1 + 0.03 * wheel_size),
        front_roundness=form.front_roundness * (1 + 0.12 * nose),
        front_insets_m=tuple(front.tolist()),
        lamp_levels=(lamp_low, lamp_high),
        lamp_inner=float(rng.uniform(0.50, 0.62)),
        lamp_end=form.lamp_end + float(rng.uniform(-0.02, 0.05)),
        grille_half_width=float(rng.uniform(0.28, 0.46)),
        grille_levels=(0.58, grille_high),
        tail_inner=form.tail_inner + float(rng.uniform(-0.03, 0.04)),
    )


def draw_paint(rng: np.random.Generator) -> Finish:
    """A colour as often as it is seen on German roads."""
    shares = np.array([share for share, _ in _PAINTS])
    base = _PAINTS[int(rng.choice(len(_PAINTS), p=shares / shares.sum()))][1]
    shade = np.clip(np.array(base) * rng.uniform(0.8, 1.2) * rng.uniform(0.95, 1.05, 3), 0, 0.9)
    red, green, blue = shade.tolist()
    return Finish(Material.CAR_PAINT, (red, green, blue))
