"""Sweep of a scene by a simulated LiDAR."""

from dataclasses import replace
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64

from sightline.ops.compiled import compiled
from sightline.simulation.arrays import Points, RayRows, RayVectors, Values
from sightline.simulation.lidar_config import KITTI_REACH_M, LidarConfig
from sightline.simulation.rays.kernels import dot, row_of
from sightline.simulation.rays.raycast import Hits, Raycaster
from sightline.simulation.rays.surfaces import (
    MeshTables,
    Rays,
    cast_through_foliage,
    face_normal,
    mesh_tables,
)
from sightline.simulation.rigs import Rosette
from sightline.simulation.scene import SURFACES, Material, Mesh, Motion, Scene, world_from_footprint

_MID_GREY = 0.25  # linear albedo of the sample for `Surface.lidar_reflectance`
_COLOR_RANGE = (0.35, 1.8)  # range of the colour's factor on the reflectance at 905 nm
# Paint, lamps and panes send most of the light elsewhere, more so at a slant;
# fitted to the points and readings on KITTI's cars.
_GLEAMING_ECHO = 0.10  # share of the echo from such a surface
_GLEAMING_COSINE_POWER = 0.5  # exponent of that echo's cosine
_THROUGH_GLASS = 0.1  # share of the light after passing a pane twice
_STEEPNESS = 10.0  # slope of the detection probability around the detectable echo
_REACH_SPREAD_M = 6.0
_BEHIND_GLASS_M = 1e-3
_TURN_S = 0.1
_OFFSET_SHARE = (5**0.5 - 1) / 2  # of an encoder's step, from laser to laser: spread evenly
# Turns of a rosette's prisms in a frame, about Livox's, in opposite directions; their ratio is the
# golden one, which closes latest, so that loops are spread evenly.
_PRISM_RATES: Final = (73.03, -45.13)

# Fitted to the reflectances of KITTI's files: overall, by range, between shots and on cars.
# The reading is roughly the logarithm of the echo, independent of the slant of rough surfaces.
_READING = 0.60  # reading of a white wall nearby
_READING_PER_E = 0.15  # increase for e times the light
_COSINE_POWER, _GLEAMING_READING_POWER = 0.23, 2.0
_FADING = 0.24  # subtracted at 40 m
_FADING_POWER = 2.0
_SPECKLE = 0.028  # mean deviation of a reading
_FAINTEST = (0.06, 0.09)  # weaker readings are reported as 0; the limit is drawn between these

# By material.
_REFLECTANCE = np.array([SURFACES[material].lidar_reflectance for material in Material])
_SPREAD = np.array([SURFACES[material].lidar_spread for material in Material])
_TRANSMISSION = np.array([SURFACES[material].lidar_transmission for material in Material])
# Metal beside streets is zinc-plated or painted, dull enough for KITTI's poles to return well.
_GLEAMS = np.array([SURFACES[item].mirror > 0 and item is not Material.METAL for item in Material])


def take_sweep(
    scene: Scene,
    raycaster: Raycaster,
    *,
    rng: np.random.Generator,
    config: LidarConfig,
    ego: Motion | None = None,
    time_s: float = 0.0,
    own_car: Mesh | None = None,
) -> Float32[np.ndarray, "num_points 4"]:
    """Simulate one turn of the LiDAR: x, y, z [m] in its frame, reflectance in [0, 0.99].

    Points are in the order of KITTI's files, ring by ring from the top, each from straight ahead
    counter-clockwise, unless `config.order` is another. An echo grows with the reflectance of the
    surface and the cosine of incidence and falls with the square of the range. Weak echoes are
    lost, most of all from shiny surfaces, and slightly stronger ones are found but read as 0. Glass
    lets most of the light through: the surface behind it returns a weaker echo or none. The scene
    stands still during the turn, which starts at `time_s`; `raycaster` is over its mesh, and `ego`
    is the motion of the sensor. The body of the car below the sensor, `own_car` in the frame of its
    footprint, hides the scene and returns points itself.

    Raises:
        ValueError: The LiDAR has a rolling shutter, but no motion is given.
    """
    firings = _firings(config)
    if config.rolling_shutter:
        if ego is None:
            raise ValueError(
                "a LiDAR with rolling_shutter moves during its turn; give its way, ego"
            )
        world_from_lidar = _poses_in_turn(ego, time_s, firings.azimuths, config)
    else:
        world_from_lidar = mounted(world_from_footprint(scene.ego, config.height_m), config)[None]
    origins, directions = _in_world(firings, world_from_lidar)
    hits, behind_glass = _cast_through_glass(scene, raycaster, origins, directions, rng)
    if own_car is not None:
        scene = _hit_own_car(scene, own_car.placed(scene.ego), firings, config, hits, behind_glass)
    hit_rows = np.flatnonzero((hits.faces >= 0) & (hits.distances < config.max_range_m))
    ranges = hits.distances[hit_rows].astype(np.float64)
    reflectance, cosine = _surface_response(scene, hits.faces[hit_rows], directions[hit_rows])
    reflectance[behind_glass[hit_rows]] *= _THROUGH_GLASS
    gleams = _GLEAMS[scene.mesh.materials[hits.faces[hit_rows]]]
    share = np.where(gleams, _GLEAMING_ECHO * cosine**_GLEAMING_COSINE_POWER, cosine)
    echo = share * reflectance / (ranges / 40.0) ** 2
    found = (1 - config.drop_out) * -np.expm1(-((echo / config.detectable_echo) ** _STEEPNESS))
    found /= 1 + np.exp((ranges - config.reach_m) / _REACH_SPREAD_M)
    kept = (rng.random(len(hit_rows)) < found) & (ranges > config.min_range_m)
    slant = cosine ** np.where(gleams, _GLEAMING_READING_POWER, _COSINE_POWER)
    biases, faded_m = firings.reading_biases[hit_rows], ranges * (KITTI_REACH_M / config.reach_m)
    readings = _readings(reflectance * slant, faded_m, biases, rng) * config.reading_scale
    noise = firings.range_biases_m[hit_rows] + rng.normal(0.0, config.range_noise_m, len(hit_rows))
    places = firings.reported[hit_rows] * (ranges + noise)[:, None]
    places[:, 2] += firings.offsets_m[hit_rows]
    # KITTI's files store whole millimetres and hundredths.
    points = np.column_stack((places.round(3), readings.clip(0, 0.99).round(2))).astype(np.float32)
    if config.order == "rings":
        return np.asarray(points[kept])
    sequence = firings.sequence[hit_rows[kept]]
    order = np.argsort(sequence) if config.order == "firings" else rng.permutation(len(sequence))
    return np.asarray(points[kept][order])


class _Firings(NamedTuple):
    """All firings of a turn in the LiDAR frame, in the order of KITTI's files."""

    directions: Float64[np.ndarray, "num_rays 3"]  # unit vectors
    reported: Float64[np.ndarray, "num_rays 3"]  # the same, at the encoder's steps
    offsets_m: Float64[np.ndarray, " num_rays"]  # height of each origin above the sensor's
    azimuths: Float64[np.ndarray, " num_rays"]  # azimuths in [0, 2 pi)
    range_biases_m: Float64[np.ndarray, " num_rays"]
    reading_biases: Float64[np.ndarray, " num_rays"]
    sequence: Int64[np.ndarray, " num_rays"]
    """Rank of each in the order of time."""


@lru_cache(maxsize=1)  # the same for all frames; never written to
def _firings(config: LidarConfig) -> _Firings:
    if config.rosette is not None:
        return _rosette_firings(config, config.rosette)
    steps = np.deg2rad(np.arange(config.azimuth_step_deg / 2, 360.0, config.azimuth_step_deg))
    laser = np.repeat(np.arange(len(config.lasers)), len(steps))
    elevation = np.deg2rad([one.elevation_deg for one in config.lasers])[laser]
    azimuth = np.tile(steps, len(config.lasers))
    free = _is_free(config, elevation, azimuth)
    elevation, azimuth, laser = elevation[free], azimuth[free], laser[free]
    lean = np.deg2rad(config.lean_deg)
    cos, sin = np.cos(lean), np.sin(lean)
    leaning = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    return _Firings(
        directions=_directions(elevation, azimuth) @ leaning.T,
        reported=_directions(elevation, _reported(azimuth, laser, config)) @ leaning.T,
        offsets_m=np.array([one.offset_m for one in config.lasers])[laser],
        azimuths=azimuth,
        range_biases_m=np.array([one.range_bias_m for one in config.lasers])[laser],
        reading_biases=np.array([one.reading_bias for one in config.lasers])[laser],
        sequence=_sequence(azimuth, laser, len(config.lasers)),
    )


def _reported(azimuth: Values, laser: Int64[np.ndarray, " count"], config: LidarConfig) -> Values:
    """Round azimuths [rad] to the encoder's steps, plus each laser's own offset from it."""
    step = np.deg2rad(config.azimuth_resolution_deg)
    if step == 0:
        return azimuth
    offset = np.mod(laser * _OFFSET_SHARE, 1.0) * step
    rounded: Values = np.round((azimuth - offset) / step) * step + offset
    return rounded


def _sequence(
    azimuth: Values, laser: Int64[np.ndarray, " count"], num_lasers: int
) -> Int64[np.ndarray, " count"]:
    """Rank firings by time: a turn starts behind, and the lasers of both halves take turns.

    So the lasers' numbers do not follow from the order, as little as in most sensors' packets.
    """
    half = -(-num_lasers // 2)
    turn = np.mod(azimuth + np.pi, 2 * np.pi)
    order = np.lexsort((2 * (laser % half) + laser // half, turn))
    ranks = np.empty(len(order), np.int64)
    ranks[order] = np.arange(len(order))
    return ranks


def _rosette_firings(config: LidarConfig, rosette: Rosette) -> _Firings:
    """Firings through two turning prisms, each of which bends the beam by half of the field.

    They turn against each other at incommensurate rates; the rosette is stretched to the width.
    """
    turns = np.linspace(0.0, 1.0, rosette.points, endpoint=False) * 2 * np.pi
    angles = [rate * turns for rate in _PRISM_RATES]
    across, up = (
        np.deg2rad(field_deg) / 4 * (wave(angles[0]) + wave(angles[1]))
        for field_deg, wave in ((rosette.width_deg, np.cos), (rosette.height_deg, np.sin))
    )
    azimuth = np.mod(across, 2 * np.pi)
    free = _is_free(config, up, azimuth)
    elevation, azimuth = up[free], azimuth[free]
    none = np.zeros(len(elevation))
    directions = _directions(elevation, azimuth)
    return _Firings(
        directions=directions,
        reported=directions,
        offsets_m=none,
        azimuths=azimuth,
        range_biases_m=none,
        reading_biases=none,
        sequence=np.arange(len(elevation)),
    )


def _is_free(config: LidarConfig, elevation: Values, azimuth: Values) -> Bool[np.ndarray, " count"]:
    """Test which beams [rad] pass the blind sectors."""
    free = np.ones(len(azimuth), dtype=bool)
    for sector in config.blind_sectors:
        start, end = np.deg2rad(sector.azimuth_deg)
        hidden = (azimuth >= start) & (azimuth < end) & (elevation < np.deg2rad(sector.below_deg))
        free &= ~hidden
    return free


def _directions(elevation: Values, azimuth: Values) -> Points:
    """Compute the unit vectors of angles [rad]."""
    cos = np.cos(elevation)
    return np.stack((cos * np.cos(azimuth), cos * np.sin(azimuth), np.sin(elevation)), axis=-1)


def mounted(
    world_from_level: Float64[np.ndarray, "4 4"], config: LidarConfig
) -> Float64[np.ndarray, "4 4"]:
    """Compute the pose of a LiDAR in a level mount."""
    if config.tilt is None:
        return world_from_level
    world_from_lidar: Float64[np.ndarray, "4 4"] = world_from_level @ config.tilt.level_from_lidar
    return world_from_lidar


def _in_world(
    firings: _Firings, world_from_lidar: Float64[np.ndarray, "num_poses 4 4"]
) -> tuple[RayVectors, RayVectors]:
    """Transform firings to origins and directions in the world; one pose for all, or one each."""
    rotations, positions = world_from_lidar[:, :3, :3], world_from_lidar[:, :3, 3]
    origins = positions + rotations[:, :, 2] * firings.offsets_m[:, None]
    if len(rotations) == 1:
        directions = firings.directions @ rotations[0].T
    else:
        directions = (rotations @ firings.directions[:, :, None])[:, :, 0]
    return origins.astype(np.float32), directions.astype(np.float32)


def _poses_in_turn(
    ego: Motion, time_s: float, azimuths: Float64[np.ndarray, " num_rays"], config: LidarConfig
) -> Float64[np.ndarray, "num_rays 4 4"]:
    """Compute the sensor's pose at each firing; a turn starts behind, counter-clockwise."""
    since_start = np.mod(azimuths + np.pi, 2 * np.pi) / (2 * np.pi) * _TURN_S
    moments, firing = np.unique(since_start, return_inverse=True)
    poses = [
        mounted(world_from_footprint(ego.at(time_s + moment), config.height_m), config)
        for moment in moments.tolist()
    ]
    return np.stack(poses)[firing]


def _cast_through_glass(
    scene: Scene,
    raycaster: Raycaster,
    origins: RayVectors,
    directions: RayVectors,
    rng: np.random.Generator,
) -> tuple[Hits, Bool[np.ndarray, " num_rays"]]:
    """Find first hits, with some rays passing one pane, and mark the rays that hit behind it."""
    hits = cast_through_foliage(raycaster, mesh_tables(scene.mesh), Rays(origins, directions))
    passed = np.flatnonzero(_passes(scene, hits.faces, rng))
    advance = hits.distances[passed] + np.float32(_BEHIND_GLASS_M)
    behind = raycaster.cast(
        origins[passed] + directions[passed] * advance[:, None], directions[passed]
    )
    # Light that passes a second pane is lost: it has to come back through all of them.
    lost = _passes(scene, behind.faces, rng)
    faces, distances, barycentric = (np.array(column) for column in hits)
    faces[passed] = np.where(lost, -1, behind.faces)
    distances[passed] = np.where(lost, np.inf, behind.distances + advance)
    barycentric[passed] = behind.barycentric
    behind_glass = np.zeros(len(faces), dtype=bool)
    behind_glass[passed] = True
    return Hits(faces, distances.astype(np.float32), barycentric), behind_glass


def _hit_own_car(
    scene: Scene,
    car: Mesh,
    firings: _Firings,
    config: LidarConfig,
    hits: Hits,
    behind_glass: Bool[np.ndarray, " num_rays"],
) -> Scene:
    """Replace, in place, the hits of rays that meet the own car first; add its mesh to the scene.

    The car moves with the sensor, so one pose is enough for all rays.
    """
    pose = mounted(world_from_footprint(scene.ego, config.height_m), config)[None]
    own = Raycaster(car).cast(*_in_world(firings, pose), coherent=True)
    met = (own.faces >= 0) & (own.distances < hits.distances)
    hits.faces[met] = own.faces[met] + len(scene.mesh.faces)
    hits.distances[met], hits.barycentric[met] = own.distances[met], own.barycentric[met]
    behind_glass[met] = False
    owners = np.concatenate((scene.owners, np.full(len(car.faces), -1, np.int32)))
    return replace(scene, mesh=Mesh.joined([scene.mesh, car]), owners=owners)


def _passes(
    scene: Scene, faces: RayRows, rng: np.random.Generator
) -> Bool[np.ndarray, " num_rays"]:
    chance = np.where(faces >= 0, _TRANSMISSION[scene.mesh.materials[faces]], 0.0)
    return rng.random(len(faces)) < chance


def _surface_response(
    scene: Scene,
    faces: Int32[np.ndarray, " num_hits"],
    directions: Float32[np.ndarray, "num_hits 3"],
) -> tuple[Float64[np.ndarray, " num_hits"], Float64[np.ndarray, " num_hits"]]:
    """Compute each surface's reflectance, given its colour, and the cosine of incidence."""
    materials, colors = scene.mesh.materials[faces], scene.mesh.colors[faces]
    reflectance = _REFLECTANCE[materials] * np.exp(_SPREAD[materials] * (_pigments(colors) - 0.5))
    reflectance *= np.clip(0.5 + 0.5 * colors.mean(axis=1) / _MID_GREY, *_COLOR_RANGE)
    return reflectance, _cosines(mesh_tables(scene.mesh), faces, directions)


def _pigments(colors: Float32[np.ndarray, "num_hits 3"]) -> Float64[np.ndarray, " num_hits"]:
    """Derive a pseudo-random number, uniform in 0 to 1, from each colour."""
    bits = colors.view(np.uint32) * np.array((2654435761, 2246822519, 3266489917), np.uint32)
    mixed = np.bitwise_xor.reduce(bits ^ (bits >> np.uint32(15)), axis=1) * np.uint32(668265263)
    return np.asarray((mixed >> np.uint32(8)) / 2.0**24)


@compiled
def _cosines(
    mesh: MeshTables,
    faces: Int32[np.ndarray, " num_hits"],
    directions: Float32[np.ndarray, "num_hits 3"],
) -> Float64[np.ndarray, " num_hits"]:
    """Compute cosines between rays of unit length and the normals of the faces hit."""
    cosines = np.empty(faces.shape[0])
    for hit in range(faces.shape[0]):
        cosines[hit] = abs(dot(face_normal(mesh, faces[hit]), row_of(directions, hit)))
    return cosines


def _readings(
    returned: Float64[np.ndarray, " num_hits"],
    ranges: Float64[np.ndarray, " num_hits"],
    biases: Float64[np.ndarray, " num_hits"],
    rng: np.random.Generator,
) -> Float64[np.ndarray, " num_hits"]:
    """Compute the sensor's reading of an echo, given as a share of a white wall's."""
    reading = _READING + _READING_PER_E * np.log(np.maximum(returned, 1e-9)) + biases
    reading -= _FADING * (ranges / 40.0) ** _FADING_POWER
    reading += rng.laplace(0.0, _SPECKLE, len(ranges))
    reported: Float64[np.ndarray, " num_hits"] = reading.clip(0.0, 0.99)
    reported[reading < rng.uniform(*_FAINTEST, len(ranges))] = 0.0
    return reported
