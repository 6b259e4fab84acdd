"""Cars and vans of several body styles, with sizes for labels like KITTI's.

A design is the common part of cars of one make. Nose, tail and the slope of the screens depend
little on its length: longer cars are longer mostly in the middle.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from jaxtyping import Float64

from sightline.simulation.bodies.body import (
    BLACK_PLASTIC,
    LEVELS,
    Body,
    BodyForm,
    cabin,
    lower_body,
)
from sightline.simulation.bodies.car_parts import (
    ALLOY,
    CHROME,
    extras,
    front_trim,
    handles,
    mirrors,
    plate,
    rear_door_gap,
    rear_trim,
    roof_rails,
    seats,
    spare_wheel,
    spoiler,
    wheel,
    wheels,
)
from sightline.simulation.bodies.models import (
    KITTI_SIZES,
    ActorModel,
    Kind,
    LateShape,
    Size,
    draw_kind,
)
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import stretched
from sightline.simulation.shapes.primitives import Color, Finish, moved


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


@dataclass(frozen=True, kw_only=True, slots=True)
class Family:
    """Vehicle family: cars or vans."""

    class_name: str
    styles: Mapping[str, CarStyle]
    spread: Size
    """Standard deviations within a style [m]."""


UNSEEN_M = 0.28
"""Mean part of an end facing away that labels exclude (`label_ends`): bodies are longer than
KITTI's labels by this."""
CARS = Family(class_name="Car", styles=STYLES, spread=Size(0.35, 0.08, 0.08))
VANS = Family(class_name="Van", styles=VAN_STYLES, spread=Size(0.45, 0.10, 0.15))

_FREEDOM = np.array([0.20, 0.0, 0.0, 0.12, 0.0, 0.18])
"""Random variation of the parts of a length, as a share; see `proportioned`."""
_UNPAINTED = Finish(Material.CAR_PAINT, (0.5, 0.5, 0.5))
_SOFT_TOP = Finish(Material.CLOTH, (0.02, 0.02, 0.022))
_WHITE = Finish(Material.CAR_PAINT, (0.68, 0.68, 0.66))
_PAINTS: tuple[tuple[float, Color], ...] = (  # share, linear albedo; roughly Germany around 2010
    (0.27, (0.012, 0.012, 0.013)), (0.13, (0.045, 0.047, 0.052)), (0.14, (0.13, 0.135, 0.14)),
    (0.18, (0.36, 0.37, 0.38)), (0.12, (0.68, 0.68, 0.66)), (0.05, (0.012, 0.025, 0.095)),
    (0.03, (0.045, 0.12, 0.32)), (0.045, (0.33, 0.015, 0.015)), (0.01, (0.13, 0.012, 0.02)),
    (0.012, (0.02, 0.07, 0.035)), (0.008, (0.55, 0.36, 0.02)), (0.005, (0.35, 0.14, 0.02)),
)  # fmt: skip


class VehicleDesign:
    """Make of cars or vans, built when the first one is needed.

    Args:
        rng: Source of randomness.
        family: Cars or vans.
        style: Name of one of its styles; None draws one that suits a size drawn as KITTI's are.

    Raises:
        ValueError: If the family has no such style.
    """

    def __init__(self, rng: np.random.Generator, family: Family, style: str | None = None) -> None:
        names = list(family.styles)
        if style is not None and style not in names:
            raise ValueError(
                f"no {family.class_name} style is called {style!r}; use one of {names}"
            )
        self._family = family
        self._index, size = self._draw_size(rng, None if style is None else names.index(style))
        self._style = family.styles[names[self._index]]
        length = self._style.kind.mean_size.length * float(rng.uniform(0.94, 1.06))
        self._size = Size(length + UNSEEN_M, size.width, size.height)
        self._seed = int(rng.integers(2**32))

    def model(self, rng: np.random.Generator) -> ActorModel:
        """Draw a vehicle of this make with its own size, proportions and paint."""
        _, size = self._draw_size(rng, self._index)
        paint = _WHITE if rng.random() < self._style.white else draw_paint(rng)
        make = partial(self._one, size, paint, int(rng.integers(2**32)))
        return ActorModel(
            class_name=self._family.class_name, size_lwh=size, shape=LateShape(make=make)
        )

    def _draw_size(self, rng: np.random.Generator, wanted: int | None) -> tuple[int, Size]:
        kinds = [style.kind for style in self._family.styles.values()]
        statistics = KITTI_SIZES[self._family.class_name]
        kind, size = draw_kind(rng, statistics, kinds, self._family.spread, wanted)
        return kind, Size(size.length + UNSEEN_M, size.width, size.height)

    def _one(self, size: Size, paint: Finish, seed: int) -> Mesh:
        mesh, knots, (_, width, height) = self._built
        scale = (size.width / width, size.height / height)
        places = proportioned(np.random.default_rng(seed), knots, size.length, scale[1])
        is_paint = (mesh.materials == Material.CAR_PAINT)[:, None]
        colors = np.where(is_paint, np.array(paint.color, np.float32), mesh.colors)
        return replace(stretched(mesh, knots, places, scale), colors=colors)

    @cached_property
    def _built(self) -> tuple[Mesh, Float64[np.ndarray, "7"], Size]:
        """Build the design, the knots along x [m] for variation between cars, and its size.

        Knots are the ends, both sides of both wheels and the upper edge of the windscreen.
        """
        rng, (length, width, height) = np.random.default_rng(self._seed), self._size
        body = Body(
            form=varied(rng, self._style, length / 2),
            length=length,
            width=width,
            height=height,
            paint=_UNPAINTED,
            roof=_SOFT_TOP if rng.random() < self._style.soft_top else _UNPAINTED,
        )
        labelled = Mesh.joined(_parts(rng, body, self._style))
        low, high = labelled.vertices.min(axis=0), labelled.vertices.max(axis=0)
        origin = np.array([*(low + high)[:2] / 2, low[2]])
        beyond = [*extras(rng, body, self._style.roof_load), mirrors(rng, body)]
        mesh = Mesh.joined([labelled, *beyond])
        front, rear = body.wheel_places
        reach, top = 1.12 * body.wheel_radius + 0.04, body.form.screen_top * length / 2
        knots = (low[0], rear - reach, rear + reach, top, front - reach, front + reach, high[0])
        size = Size(*(high - low).tolist())
        return moved(mesh, -origin), np.array(knots, np.float64) - origin[0], size


def _parts(rng: np.random.Generator, body: Body, style: CarStyle) -> list[Mesh]:
    """Build all parts within the label's box."""
    tyre = 0.20 if body.wheel_radius < 0.33 else 0.22
    one = wheel(rng, body.wheel_radius, tyre, rim=ALLOY)
    half = body.length / 2
    shell = body.paint if rng.random() < 0.75 else BLACK_PLASTIC
    rear_level = 0.64 if body.form.tail_levels[0] > 0.6 or rng.random() < 0.6 else 0.38
    ahead = max(body.front_x(0.40 + reach) for reach in (-0.09, 0.0, 0.09))  # a plate is upright
    behind = min(body.rear_x(rear_level + reach) for reach in (-0.09, 0.0, 0.09))
    parts = [
        lower_body(body),
        cabin(body),
        wheels(one, body.wheel_places, body.width / 2 - tyre / 2 - 0.015, body.wheel_radius),
        *handles(body, shell),
        *front_trim(rng, body),
        *rear_trim(rng, body),
        *plate(rng, ahead + 0.004, body.level_height(half, 0.40), 1),
        *plate(rng, behind - 0.004, body.level_height(-half, rear_level), -1),
        seats(body, [max(row, body.form.rear_top + 0.06) * half for row in style.seat_rows]),
    ]
    if rng.random() < style.rails:
        parts.append(roof_rails(body, CHROME if rng.random() < 0.5 else BLACK_PLASTIC))
    if rng.random() < style.spoiler:
        parts.append(spoiler(rng, body))
    if rng.random() < style.spare_wheel:
        parts.append(spare_wheel(one, body))
    if body.form.split_rear:
        parts.append(rear_door_gap(body))
    return parts


def proportioned(
    rng: np.random.Generator, knots: Float64[np.ndarray, "7"], length: float, height_ratio: float
) -> Float64[np.ndarray, "7"]:
    """Place the knots of a design in a car of a given length [m].

    Overhangs and windscreen depend a little on the length and more on chance; wheels on the height,
    so that they stay round; the cabin takes the rest, up to a limit. The remainder is shared by all
    parts except the wheels.
    """
    spans = np.diff(knots)  # rear overhang, rear wheel, cabin, screen, front wheel, front overhang
    follows = 1 + 0.3 * (length / spans.sum() - 1) + rng.normal(0.0, 1.0, 6) * _FREEDOM
    wanted = spans * np.clip(follows, 0.65, 1.45)
    wanted[[1, 4]] = spans[[1, 4]] * height_ratio
    left = length - wanted.sum() + wanted[2]
    wanted[2] = np.clip(left, 0.65 * spans[2], 1.5 * spans[2])
    free = [0, 2, 3, 5]
    wanted[free] *= 1 + (length - wanted.sum()) / wanted[free].sum()
    places: Float64[np.ndarray, "7"] = np.cumsum([-length / 2, *wanted])
    return places


def varied(rng: np.random.Generator, style: CarStyle, half_length: float) -> BodyForm:
    """Draw the form of a style with the differences between makes."""
    form = style.form
    nose, tail, sill, slope, width, top, base, inner = rng.uniform(-1.0, 1.0, 8)
    bow, crown, fall, rake, front_round, rear_round = np.exp(rng.uniform(-0.4, 0.4, 6))
    above = np.clip((LEVELS - 0.475) / 0.525, 0.0, 1.0)
    front = np.array(form.front_insets_m) * (1 + 0.3 * nose) + float(rng.uniform(0, 0.12)) * above
    rear = np.array(form.rear_insets_m) + float(rng.uniform(-0.02, 0.10)) * above
    front[3:] += float(rng.uniform(0.0, 0.07))  # the bumpers' depth
    rear[3:] += float(rng.uniform(0.0, 0.06))
    rear[:2] *= float(rng.uniform(0.4, 1.8))
    places, heights = np.array(form.shoulder).T
    ends = 0.045 * nose * (places > 0.8) + 0.03 * tail * (places < -0.6)
    rear_base = form.rear_base + form.rear_base_spread * base
    rear_base += (rear[-1] - form.rear_insets_m[-1]) / half_length
    screen_top = form.screen_top + 0.05 * slope
    rear_top = rear_base + (form.rear_top - form.rear_base) * rake**1.5
    tail_inner, roundness = form.tail_inner + 0.05 * inner, form.rear_roundness * rear_round
    corner = (1 - (tail_inner + 0.1) ** roundness) ** (1 / roundness)
    low, high = ((0.58, 0.78), (0.69, 0.82))[int(rng.integers(2))]
    return replace(
        form,
        shoulder=tuple(zip(places.tolist(), (heights + ends + 0.02 * sill).tolist(), strict=True)),
        clearance=form.clearance * (1 + 0.1 * top),
        wheel_radius=form.wheel_radius * (1 + 0.05 * inner),
        front_insets_m=tuple(front.tolist()),
        rear_insets_m=tuple(rear.tolist()),
        front_roundness=max(4.2, form.front_roundness * front_round),
        rear_roundness=roundness,
        screen_top=screen_top,
        screen_bow_m=form.screen_bow_m * bow,
        rear_base=rear_base,
        rear_top=min(rear_top, form.rear_top + 0.08, screen_top - 0.3),
        rear_bow_m=form.rear_bow_m * bow,
        roof_width=form.roof_width + 0.03 * width,
        roof_crown_m=form.roof_crown_m * crown,
        roof_fall_front_m=form.roof_fall_front_m * bow,
        roof_fall_rear_m=form.roof_fall_rear_m * fall**1.5,
        window_top=form.window_top + 0.03 * top,
        lamp_levels=(low, high),
        lamp_inner=float(rng.uniform(0.50, 0.62)),
        lamp_end=form.lamp_end + float(rng.uniform(-0.02, 0.05)),
        grille_half_width=float(rng.uniform(0.28, 0.46)),
        grille_levels=(0.58, 0.78 if rng.random() < 0.6 else 0.69),
        tail_inner=tail_inner,
        tail_start=max(form.tail_start, -corner),  # round corners leave no room for lamps
        pillar_lamps=bool(rng.random() < style.pillar_lamps),
    )


def draw_paint(rng: np.random.Generator) -> Finish:
    """Draw a colour by its frequency on German roads."""
    shares = np.array([share for share, _ in _PAINTS])
    base = _PAINTS[int(rng.choice(len(_PAINTS), p=shares / shares.sum()))][1]
    shade = np.clip(np.array(base) * rng.uniform(0.8, 1.2) * rng.uniform(0.95, 1.05, 3), 0, 0.9)
    red, green, blue = shade.tolist()
    return Finish(Material.CAR_PAINT, (red, green, blue))
