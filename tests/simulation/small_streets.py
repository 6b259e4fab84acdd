"""Small streets of boxes for tests of the sensors and the files."""

from dataclasses import dataclass

import numpy as np

from sightline.simulation.bodies.models import RigidShape
from sightline.simulation.scene import Actor, Light, Material, Mesh, Pose, Street
from sightline.simulation.shapes.primitives import Finish, box, quads

GREY = (0.25, 0.25, 0.25)
LIGHT = Light(
    sun_direction=(0.0, 0.6, 0.8),
    sun_color=(2.5, 2.4, 2.2),
    sun_softness=0.01,
    sky_zenith=(0.2, 0.4, 0.8),
    sky_horizon=(0.7, 0.8, 0.9),
    cloud_cover=0.2,
    haze_m=900.0,
    exposure=0.7,
)


@dataclass(frozen=True)
class Straight:
    """Steady motion along the heading."""

    start: Pose
    speed_mps: float = 0.0

    def at(self, time_s: float) -> Pose:
        way = self.speed_mps * time_s
        return Pose(
            x=self.start.x + way * np.cos(self.start.yaw),
            y=self.start.y + way * np.sin(self.start.yaw),
            z=self.start.z,
            yaw=self.start.yaw,
        )


@dataclass(frozen=True)
class Turning:
    """Steady rotation on the spot."""

    rate_radps: float

    def at(self, time_s: float) -> Pose:
        return Pose(x=0.0, y=0.0, z=0.0, yaw=self.rate_radps * time_s)


def ground(half_size_m: float = 150.0, material: Material = Material.ASPHALT) -> Mesh:
    """A square at height 0."""
    s = half_size_m
    corners = np.array([[[-s, -s, 0], [s, -s, 0], [s, s, 0], [-s, s, 0]]], dtype=np.float64)
    return quads(corners, Finish(material, GREY))


def courtyard(half_size_m: float = 30.0) -> Mesh:
    """A ground with walls all around, so that every ring of a sweep has returns."""
    s = half_size_m
    walls = [
        block((x, y, 5.0), (0.2 if x else s, 0.2 if y else s, 5.0))
        for x, y in ((s, 0.0), (-s, 0.0), (0.0, s), (0.0, -s))
    ]
    return Mesh.joined([ground(), *walls])


def block(
    center: tuple[float, float, float],
    half_size: tuple[float, float, float],
    material: Material = Material.PLASTER,
    color: tuple[float, float, float] = GREY,
) -> Mesh:
    """An upright box."""
    return box(center, half_size, Finish(material, color))


def box_actor(
    x: float,
    y: float,
    *,
    yaw: float = 0.0,
    size_lwh: tuple[float, float, float] = (4.0, 1.6, 1.5),
    speed_mps: float = 0.0,
    class_name: str = "Car",
) -> Actor:
    """A road user that is its own box."""
    length, width, height = size_lwh
    shape = block((0.0, 0.0, height / 2), (length / 2, width / 2, height / 2), Material.CAR_PAINT)
    return Actor(
        class_name=class_name,
        size_lwh=size_lwh,
        shape=RigidShape(mesh=shape),
        motion=Straight(Pose(x=x, y=y, z=0.0, yaw=yaw), speed_mps),
    )


def street(
    *actors: Actor,
    scenery: Mesh | None = None,
    ego: Straight | Turning = Straight(Pose(x=0.0, y=0.0, z=0.0, yaw=0.0)),  # noqa: B008
) -> Street:
    """Actors on a plane."""
    return Street(
        ground_and_buildings=scenery or ground(), actors=tuple(actors), ego=ego, light=LIGHT
    )


def make_tiny_street(rng: np.random.Generator, *, duration_s: float) -> Street:  # noqa: ARG001
    """A courtyard with some boxes by chance: fast to build and to render."""
    actors = [
        box_actor(
            float(rng.uniform(8, 20)),
            float(rng.uniform(-5, 5)),
            yaw=float(rng.uniform(-np.pi, np.pi)),
            speed_mps=float(rng.uniform(0, 5)),
        )
        for _ in range(3)
    ]
    ego = Straight(Pose(x=0.0, y=0.0, z=0.0, yaw=0.1), float(rng.uniform(1, 8)))
    return street(*actors, scenery=courtyard(), ego=ego)
