"""Times of ray casting by Sightline and by embreex: `python -m benchmarks.raycast`.

One run, in turns, one process each: in a shared process, helper threads of embreex's device would
run without pause. Its last line is kept in benchmarks/results/raycast.json. Both call the Embree
library in the package embreex: `Raycaster` directly, the peer through the classes `TriangleMesh`
and `EmbreeScene` of embreex.

- search tree: a mesh is handed over and the tree is built (embreex builds it at the first cast).
- camera: a ray through each pixel of 1242x375, with nearly equal neighbours.
- around: a ray in a random direction from the surface of every second pixel.
- shadow: visibility of a sun high on the left from these points.

Processor time, which other programs on the machine disturb least and which counts helper threads,
too; the sum over the streets, median over the repeats.
"""

import functools
import multiprocessing
import statistics
import time
from typing import NamedTuple, Protocol

import jsonargparse
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy import ndarray

from benchmarks.record import print_record
from sightline.simulation.camera.samples import camera_view
from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.rays.surfaces import Rays
from sightline.simulation.scene import Mesh
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import calibration_of, lidar_of, simulate_street

_LIFT = np.float32(0.999)  # share of the distance to a surface at which rays around it start
_SUN = np.array((0.48, 0.36, 0.8), np.float32)
_STAGES = ("search tree", "camera", "around", "shadow")


class Work(NamedTuple):
    """A street and the rays that are cast in it."""

    mesh: Mesh
    camera: Rays
    around: Rays
    shadow: Rays


class Peer(Protocol):
    """Interface to cast rays."""

    def __init__(self, mesh: Mesh) -> None:
        """Build the search tree."""

    def cast_rays(self, rays: Rays) -> tuple[ndarray, ndarray]:
        """Cast rays of neighbouring pixels: faces, distances and weights of corners."""

    def scatter(self, rays: Rays) -> tuple[ndarray, ndarray]:
        """Cast rays in any direction."""

    def shade(self, rays: Rays) -> ndarray:
        """Test whether rays meet anything."""


class Sightline:
    """`Raycaster` of Sightline."""

    def __init__(self, mesh: Mesh) -> None:
        self._raycaster = Raycaster(mesh)

    def cast_rays(self, rays: Rays) -> tuple[ndarray, ndarray]:
        """Cast coherent rays, like the camera."""
        hits = self._raycaster.cast(*rays, coherent=True)
        return hits.faces, hits.distances

    def scatter(self, rays: Rays) -> tuple[ndarray, ndarray]:
        """Cast rays in any direction, like ambient light."""
        hits = self._raycaster.cast(*rays)
        return hits.faces, hits.distances

    def shade(self, rays: Rays) -> ndarray:
        """Test coherent rays, like sunlight."""
        return self._raycaster.occluded(*rays, coherent=True)


class Embreex:
    """The classes of embreex."""

    def __init__(self, mesh: Mesh) -> None:
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, mesh.vertices, mesh.faces)
        ray = np.ones((1, 3), np.float32)
        self._scene.run(ray, ray)

    def cast_rays(self, rays: Rays) -> tuple[ndarray, ndarray]:
        """Cast rays one by one."""
        found = self._scene.run(*rays, output=1)
        return found["primID"], found["tfar"]

    scatter = cast_rays

    def shade(self, rays: Rays) -> ndarray:
        """Cast rays one by one."""
        first: ndarray = self._scene.run(*rays, query="OCCLUDED")
        return first >= 0


PEERS: dict[str, type[Peer]] = {"sightline": Sightline, "embreex": Embreex}


def main(streets: int = 6, repeats: int = 5, seed: int = 11) -> None:
    """Print a table, then one line of JSON."""
    start_afresh = multiprocessing.get_context("spawn")
    times: dict[str, list[list[float]]] = {name: [] for name in PEERS}
    pools = {name: start_afresh.Pool(1) for name in PEERS}
    for repeat in range(repeats + 1):  # the first warms up
        for name, pool in pools.items():
            seconds = pool.apply(measure, (name, streets, seed))
            if repeat:
                times[name].append(seconds)
    seen = [pool.apply(all_seen, (name, streets, seed)) for name, pool in pools.items()]
    for pool in pools.values():
        pool.terminate()
    results = {
        name: {
            stage: 1e3 * statistics.median(row[column] for row in rows)
            for column, stage in enumerate(_STAGES)
        }
        for name, rows in times.items()
    }
    for stage, own_ms in results["sightline"].items():
        peer_ms = results["embreex"][stage]
        print(f"{stage:<12} {own_ms:8.1f} ms  embreex {peer_ms:8.1f} ms  {peer_ms / own_ms:5.2f} x")
    (own_faces, own_depths), (peer_faces, peer_depths) = seen
    others = own_faces != peer_faces
    elsewhere = others & ~np.isclose(own_depths, peer_depths, rtol=1e-5, atol=0.0)
    hits = {"camera_rays": len(others), "other_faces": int(others.sum())}
    hits["at_other_distances"] = int(elsewhere.sum())
    print(", ".join(f"{name} {count:,}" for name, count in hits.items()))
    print_record({"streets": streets, "repeats": repeats, "results_ms": results, **hits}, seed=seed)


@functools.cache
def street_works(name: str, streets: int, seed: int) -> list[Work]:
    """Streets, and rays as the simulator casts them; the process holds no other peer's device."""
    config = SimulationConfig(seed=seed)
    return [_street_work(PEERS[name], config, index) for index in range(1, streets + 1)]


def _street_work(peer: type[Peer], config: SimulationConfig, index: int) -> Work:
    scene = simulate_street(config, index).snapshot(0.0)
    rows, columns = np.indices(config.image_size, dtype=np.float32).reshape(2, -1)
    view = camera_view(calibration_of(config), scene.ego, lidar_of(config).height_m)
    camera = view.rays(columns, rows)
    faces, distances = peer(scene.mesh).cast_rays(camera)
    hit_rows = np.flatnonzero(faces >= 0)[::2]
    starts = (
        camera.origins[hit_rows] + _LIFT * distances[hit_rows, None] * camera.directions[hit_rows]
    )
    directions = np.random.default_rng(index).normal(size=starts.shape).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    shadow = Rays(starts, np.tile(_SUN, (len(starts), 1)))
    return Work(scene.mesh, camera, Rays(starts, directions), shadow)


def measure(name: str, streets: int, seed: int) -> list[float]:
    """Processor time [s] of each stage, over all streets."""
    seconds = np.zeros(len(_STAGES))
    for work in street_works(name, streets, seed):
        clock = [time.process_time()]
        peer = PEERS[name](work.mesh)
        clock.append(time.process_time())
        for cast, rays in (
            (peer.cast_rays, work.camera),
            (peer.scatter, work.around),
            (peer.shade, work.shadow),
        ):
            cast(rays)
            clock.append(time.process_time())
        seconds += np.diff(clock)
    return seconds.tolist()


def all_seen(name: str, streets: int, seed: int) -> ndarray:
    """Faces and distances that the camera's rays meet in all streets, in two rows."""
    works = street_works(name, streets, seed)
    return np.concatenate([PEERS[name](work.mesh).cast_rays(work.camera) for work in works], axis=1)


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
