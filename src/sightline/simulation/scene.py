"""Contents of a simulated street: materials, meshes, road users and light, at one moment."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, Float64, Int32

from sightline.simulation.tables import read_table

Material = IntEnum(
    "Material",
    "ASPHALT PAVEMENT GRASS SOIL KERB CONCRETE PLASTER BRICK ROOF_TILE CAR_PAINT GLASS RUBBER "
    "PLASTIC METAL HEADLIGHT TAIL_LIGHT RETRO_REFLECTOR LEAF BARK CLOTH SKIN WOOD GRAVEL "
    "COBBLES WINDOW COATED_GLASS WET_ASPHALT WET_PAVEMENT WET_COBBLES",
    start=0,
)
"""Kind of surface, one per face of a mesh."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Surface:
    """Response of a material to light and laser."""

    lidar_reflectance: float
    """Reflectance of a mid-grey sample at the laser's wavelength and normal incidence, relative to
    a white wall; retroreflectors have more than 1."""
    lidar_spread: float = 1.5
    """Natural logarithm of the ratio of brightest to darkest at 905 nm among samples of the same
    visible colour, since pigments differ there; drawn from the colour itself, so it is 0 for
    materials of few colours."""
    lidar_transmission: float = 0.0
    """Probability that the beam is transmitted or lost instead of returning."""
    mirror: float = 0.0  # Fresnel reflectance at normal incidence; 0 = no mirror ray is cast
    highlight: float = 0.0  # strength of the sun's highlight
    highlight_power: float = 60.0  # sharpness of the highlight (Blinn-Phong exponent)


SURFACES: Final = {
    Material[name]: Surface(**row) for name, row in read_table(__file__, "surfaces").items()
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Mesh:
    """Triangles with the surface properties for the camera and the LiDAR.

    The frame is that of the mesh's maker: objects have their origin in the middle of their
    footprint, x ahead, y left, z up; metres.
    """

    vertices: Float32[np.ndarray, "num_vertices 3"]
    normals: Float32[np.ndarray, "num_vertices 3"]
    """Unit normals for shading; smooth surfaces share vertices, sharp edges do not."""
    uvs: Float32[np.ndarray, "num_vertices 2"]  # position on the surface [m], for its texture
    faces: Int32[np.ndarray, "num_faces 3"]
    materials: Int32[np.ndarray, " num_faces"]  # `Material` of each face
    colors: Float32[np.ndarray, "num_faces 3"]  # linear RGB albedo in [0, 1] before texture

    def placed(self, pose: "Pose") -> "Mesh":
        """Place the mesh of an object at a pose."""
        world_from_object = world_from_footprint(pose, 0.0)
        rotation = world_from_object[:3, :3]
        return replace(
            self,
            vertices=(self.vertices @ rotation.T + world_from_object[:3, 3]).astype(np.float32),
            normals=(self.normals @ rotation.T).astype(np.float32),
        )

    @staticmethod
    def joined(parts: Sequence["Mesh"]) -> "Mesh":
        """Join meshes of one frame."""
        starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
        shifted = [part.faces + start for part, start in zip(parts, starts, strict=False)]
        return Mesh(
            vertices=np.concatenate([part.vertices for part in parts]),
            normals=np.concatenate([part.normals for part in parts]),
            uvs=np.concatenate([part.uvs for part in parts]),
            faces=np.concatenate(shifted).astype(np.int32),
            materials=np.concatenate([part.materials for part in parts]),
            colors=np.concatenate([part.colors for part in parts]),
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class Pose:
    """Position of the middle of a footprint [m], heading and tilt."""

    x: float
    y: float
    z: float
    yaw: float  # radians, counter-clockwise from above, 0 faces +x
    pitch: float = 0.0  # radians, positive with the nose down
    roll: float = 0.0  # radians, positive with the left side up


@runtime_checkable  # for beartype, which checks arguments under pytest
class Motion(Protocol):
    """Path through the street."""

    def at(self, time_s: float) -> Pose:
        """Compute the pose at a time [s]; time 0 is the first frame."""


@runtime_checkable
class Shape(Protocol):
    """Appearance of an actor, which may change with its motion (legs, wheels)."""

    def at(self, time_s: float) -> Mesh:
        """Compute the mesh in the actor's own frame."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Actor:
    """Road user: class, size, shape and motion."""

    class_name: str  # KITTI class: Car, Van, Truck, Pedestrian, Person_sitting, Cyclist, Tram, Misc
    size_lwh: tuple[float, float, float]
    """Size of the upright box [m] around `shape` without roof loads, aerials and tow bars, to 1
    cm."""
    shape: Shape
    motion: Motion
    labelled_lwh: tuple[float, float, float] | None = None
    """Size [m] in the label, if it differs from `size_lwh`; both have the same middle."""

    @property
    def box_lwh(self) -> tuple[float, float, float]:
        """Length, width, height [m] of its label; for a car, before `labelled_ends`."""
        return self.labelled_lwh or self.size_lwh


@dataclass(frozen=True, kw_only=True, slots=True)
class Light:
    """Sun and sky."""

    sun_direction: tuple[float, float, float]  # unit vector towards the sun, world frame
    sun_color: tuple[float, float, float]
    """Linear RGB irradiance of the unoccluded sun; zero when overcast."""
    sun_softness: float  # angular radius [rad] of the disc over which shadow rays are spread
    sky_zenith: tuple[float, float, float]
    sky_horizon: tuple[float, float, float]  # linear RGB radiance of the sky at the horizon
    cloud_cover: float  # 0 clear to 1 overcast
    haze_m: float  # distance over which contrast falls to 1/e
    exposure: float  # factor on `SensorConfig.sensitivity` suitable for this light


@dataclass(frozen=True, kw_only=True, slots=True)
class Street:
    """Place with its traffic over time; world frame: z up, the ego starts near the origin."""

    ground_and_buildings: Mesh  # all static meshes
    actors: tuple[Actor, ...]
    ego: Motion  # motion of the point on the road below the LiDAR
    light: Light

    def snapshot(self, time_s: float = 0.0) -> "Scene":
        """Take the street at one moment."""
        poses = tuple(actor.motion.at(time_s) for actor in self.actors)
        parts = [self.ground_and_buildings]
        for actor, pose in zip(self.actors, poses, strict=True):
            parts.append(actor.shape.at(time_s).placed(pose))
        owners = [np.full(len(part.faces), index - 1) for index, part in enumerate(parts)]
        return Scene(
            mesh=Mesh.joined(parts),
            owners=np.concatenate(owners).astype(np.int32),
            actors=self.actors,
            poses=poses,
            ego=self.ego.at(time_s),
            light=self.light,
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class Scene:
    """Street at one moment, ready for the sensors; world frame."""

    mesh: Mesh
    owners: Int32[np.ndarray, " num_faces"]
    """Index into `actors` of each face; -1 for the street itself."""
    actors: tuple[Actor, ...]
    poses: tuple[Pose, ...]  # poses of `actors`
    ego: Pose  # pose of the point on the road below the LiDAR
    light: Light


def world_from_footprint(pose: Pose, height_m: float) -> Float64[np.ndarray, "4 4"]:
    """Compute the frame `height_m` above a pose, along its own z: x ahead, y left, z up."""
    (cos_yaw, cos_pitch, cos_roll), (sin_yaw, sin_pitch, sin_roll) = (
        turn(np.array((pose.yaw, pose.pitch, pose.roll))) for turn in (np.cos, np.sin)
    )
    heading = np.array([[cos_yaw, -sin_yaw, 0.0], [sin_yaw, cos_yaw, 0.0], [0.0, 0.0, 1.0]])
    nose = np.array([[cos_pitch, 0.0, sin_pitch], [0.0, 1.0, 0.0], [-sin_pitch, 0.0, cos_pitch]])
    side = np.array([[1.0, 0.0, 0.0], [0.0, cos_roll, -sin_roll], [0.0, sin_roll, cos_roll]])
    transform = np.eye(4)
    transform[:3, :3] = heading @ nose @ side
    transform[:3, 3] = (pose.x, pose.y, pose.z) + height_m * transform[:3, 2]
    return transform
