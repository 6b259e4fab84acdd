"""Street maker: ground, buildings, plants, objects, traffic and light."""

import numpy as np

from sightline.simulation.crowd import FASTEST_EGO_MPS
from sightline.simulation.dressing import dress
from sightline.simulation.fleet import Fleet
from sightline.simulation.layout import StreetKind
from sightline.simulation.layout_drawing import draw_layout
from sightline.simulation.lots import bays_of, draw_lots, with_lowered_kerbs
from sightline.simulation.meshes.horizon import make_horizon
from sightline.simulation.meshes.markings import make_markings
from sightline.simulation.meshes.plots import make_plots
from sightline.simulation.meshes.roads import make_ground
from sightline.simulation.motion import draw_rocking
from sightline.simulation.placement import place_traffic
from sightline.simulation.scene import Mesh, Street
from sightline.simulation.weather import draw_light


def make_street(
    rng: np.random.Generator,
    *,
    duration_s: float = 0.0,
    kind: StreetKind | None = None,
    hard: bool = False,
    hard_negatives: bool = False,
) -> Street:
    """Draw a street with its traffic and weather.

    Args:
        rng: Source of all randomness; the same state gives the same street.
        duration_s: Duration of the ego's drive. No road users collide until then, and the street is
            long enough.
        kind: Kind of street; None draws it.
        hard: Whether it is fuller and hillier than usual, with more objects far away and hidden.
        hard_negatives: Whether to place many objects that are easily mistaken for a person or a
            car.

    Raises:
        ValueError: `duration_s` is negative.
    """
    if duration_s < 0:
        raise ValueError(f"duration_s must not be negative, got {duration_s}")
    layout = draw_layout(rng, kind, extra_length_m=FASTEST_EGO_MPS * duration_s, hard=hard)
    lots = draw_lots(rng, layout)
    layout = with_lowered_kerbs(layout, lots)
    bays = bays_of(rng, lots)
    traffic = place_traffic(rng, layout, lots, bays, Fleet(), duration_s, hard=hard)
    parts = [make_ground(rng, layout), make_markings(rng, layout)]
    parts += make_plots(rng, layout, lots)
    parts += make_horizon(rng, layout)
    parts += dress(rng, layout, traffic.taken, hard_negatives=hard_negatives)
    return Street(
        ground_and_buildings=Mesh.joined(parts),
        actors=traffic.actors,
        ego=draw_rocking(rng, traffic.ego),
        light=draw_light(rng),
    )
