"""Cars and vans of several body styles, with sizes for labels like KITTI's.

A design is the common part of cars of one make. Nose, tail and the slope of the screens depend
little on its length: longer cars are longer mostly in the middle.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Final

import numpy as np
from jaxtyping import Float64

from sightline.simulation.bodies import car_parts
from sightline.simulation.bodies.body import (
    BLACK_PLASTIC,
    LEVELS,
    Body,
    BodyForm,
    cabin,
    lower_body,
)
from sightline.simulation.bodies.models import (
    KITTI_SIZES,
    ActorModel,
    Kind,
    LazyShape,
    Size,
    draw_kind,
)
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import stretched
from sightline.simulation.shapes.primitives import Color, Finish, moved
from sightline.simulation.tables import read_table


@dataclass(frozen=True, kw_only=True, slots=True)
class CarStyle:
    """A body style of cars or vans."""

    kind: Kind
    form: BodyForm
    seat_rows: tuple[float, ...] = (-0.05, -0.50)  # places of the seats' backs
    rails: float = 0.0
    """Probability of roof rails; the following fields are probabilities of other parts."""
    spoiler: float = 0.0  # spoiler over the rear window
    pillar_lamps: float = 0.0  # tail lights beside the rear window
    spare_wheel: float = 0.0  # spare wheel on the rear door
    roof_load: float = 0.01  # box or ladder on the roof, which labels exclude
    soft_top: float = 0.0  # roof of cloth
    white: float = 0.0  # white paint, in addition to that of all cars


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


def _form(row: dict[str, Any]) -> BodyForm:
    """Build a form from a row, which names the differences from another form if it has `like`."""
    row = dict(row)
    if "shoulder" in row:
        row["shoulder"] = _shoulder(**row["shoulder"])
    like = row.pop("like", None)
    return BodyForm(**row) if like is None else replace(_form(_TABLES["forms"][like]), **row)


def _style(row: dict[str, Any]) -> CarStyle:
    row = dict(row)
    kind = Kind(share=row.pop("share"), mean_size=Size(*row.pop("mean_size")))
    return CarStyle(kind=kind, form=_form(row.pop("form")), **row)


_TABLES: Final = read_table(__file__, "car_styles")
STYLES: Final = {name: _style(row) for name, row in _TABLES["cars"].items()}
VAN_STYLES: Final = {name: _style(row) for name, row in _TABLES["vans"].items()}
"""Styles of cars and of vans, by name; the shares of each sum to 1."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Family:
    """Vehicle family: cars or vans."""

    class_name: str
    styles: Mapping[str, CarStyle]
    spread: Size  # standard deviations within a style [m]


UNSEEN_M = 0.28
"""Mean part of an end facing away that labels exclude (`labelled_ends`): bodies are longer than
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

    Without a `style` one is drawn that suits a size drawn as KITTI's are.

    Raises:
        ValueError: The family has no such style.
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
            class_name=self._family.class_name, size_lwh=size, shape=LazyShape(make=make)
        )

    def _draw_size(self, rng: np.random.Generator, target: int | None) -> tuple[int, Size]:
        kinds = [style.kind for style in self._family.styles.values()]
        statistics = KITTI_SIZES[self._family.class_name]
        kind, size = draw_kind(rng, statistics, kinds, self._family.spread, target)
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
        beyond = [*car_parts.extras(rng, body, self._style.roof_load), car_parts.mirrors(rng, body)]
        mesh = Mesh.joined([labelled, *beyond])
        front, rear = body.wheel_places
        reach, top = 1.12 * body.wheel_radius + 0.04, body.form.screen_top * length / 2
        knots = (low[0], rear - reach, rear + reach, top, front - reach, front + reach, high[0])
        size = Size(*(high - low).tolist())
        return moved(mesh, -origin), np.array(knots, np.float64) - origin[0], size


def _parts(rng: np.random.Generator, body: Body, style: CarStyle) -> list[Mesh]:
    """Build all parts within the label's box."""
    tyre = 0.20 if body.wheel_radius < 0.33 else 0.22
    one = car_parts.wheel(rng, body.wheel_radius, tyre, rim=car_parts.ALLOY)
    half = body.length / 2
    shell = body.paint if rng.random() < 0.75 else BLACK_PLASTIC
    rear_level = 0.64 if body.form.tail_levels[0] > 0.6 or rng.random() < 0.6 else 0.38
    ahead = max(body.front_x(0.40 + reach) for reach in (-0.09, 0.0, 0.09))  # a plate is upright
    behind = min(body.rear_x(rear_level + reach) for reach in (-0.09, 0.0, 0.09))
    parts = [
        lower_body(body),
        cabin(body),
        car_parts.wheels(
            one, body.wheel_places, body.width / 2 - tyre / 2 - 0.015, body.wheel_radius
        ),
        *car_parts.handles(body, shell),
        *car_parts.front_trim(rng, body),
        *car_parts.rear_trim(rng, body),
        *car_parts.plate(rng, ahead + 0.004, body.level_height(half, 0.40), 1),
        *car_parts.plate(rng, behind - 0.004, body.level_height(-half, rear_level), -1),
        car_parts.seats(
            body, [max(row, body.form.rear_top + 0.06) * half for row in style.seat_rows]
        ),
    ]
    if rng.random() < style.rails:
        parts.append(
            car_parts.roof_rails(body, car_parts.CHROME if rng.random() < 0.5 else BLACK_PLASTIC)
        )
    if rng.random() < style.spoiler:
        parts.append(car_parts.spoiler(rng, body))
    if rng.random() < style.spare_wheel:
        parts.append(car_parts.spare_wheel(one, body))
    if body.form.split_rear:
        parts.append(car_parts.rear_door_gap(body))
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
    target = spans * np.clip(follows, 0.65, 1.45)
    target[[1, 4]] = spans[[1, 4]] * height_ratio
    left = length - target.sum() + target[2]
    target[2] = np.clip(left, 0.65 * spans[2], 1.5 * spans[2])
    free = [0, 2, 3, 5]
    target[free] *= 1 + (length - target.sum()) / target[free].sum()
    return np.asarray(np.cumsum([-length / 2, *target]))


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
