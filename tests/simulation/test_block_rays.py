"""Rays against blocks, judged by the points along them."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.geometry.boxes3d import Boxes3D
from sightline.simulation.block_rays import GROUND, NOTHING, Block, cast_rays

seeds = st.integers(0, 10_000)


def random_blocks(rng: np.random.Generator) -> list[Block]:
    return [
        Block(
            center=tuple(rng.uniform([-9, -9, -1], [9, 9, 3]).tolist()),
            size=tuple(rng.uniform(0.5, 4, 3).tolist()),
            yaw=float(rng.choice([0.0, rng.uniform(-3, 3)])),
            surface="plain",
            color=(0.5, 0.5, 0.5),
        )
        for _ in range(6)
    ]


def as_boxes(blocks: list[Block], margin: float) -> Boxes3D:
    rows = [(*block.center, *block.size, block.yaw) for block in blocks]
    return Boxes3D(torch.tensor(rows, dtype=torch.float64)).enlarge(margin)


def random_rays(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    directions = rng.normal(size=(3, 40)).astype(np.float32)
    return np.array([[0.0], [0.0], [20.0]], np.float32), directions


@settings(max_examples=25)
@given(seed=seeds)
def test_a_ray_stops_on_a_surface_and_passes_none_before(seed):
    rng = np.random.default_rng(seed)
    blocks = random_blocks(rng)
    origin, directions = random_rays(rng)
    hits = cast_rays([blocks[:2], blocks[2:]], origin, directions, ground_z=None)
    shrunk, grown = as_boxes(blocks, -0.01), as_boxes(blocks, 0.01)
    is_hit = hits.blocks != NOTHING
    ends = np.where(is_hit, hits.distances, 60.0)
    along = np.linspace(0, 1, 400)[:, None, None] * (ends * directions)  # steps, axes, rays
    points = torch.from_numpy(origin + along).permute(2, 0, 1).reshape(-1, 3)
    before_the_end = shrunk.contain(points).reshape(len(blocks), -1, 400)[:, :, :-1]
    assert not before_the_end.any()
    met = torch.from_numpy((origin + ends * directions).T[is_hit])
    assert grown.contain(met)[hits.blocks[is_hit], range(len(met))].all()


@settings(max_examples=25)
@given(seed=seeds)
def test_rays_with_origins_of_their_own_hit_what_a_shared_origin_hits(seed):
    rng = np.random.default_rng(seed)
    blocks = random_blocks(rng)
    origin, directions = random_rays(rng)
    shared = cast_rays([blocks], origin, directions, ground_z=-2.0)
    spread = np.repeat(origin, directions.shape[1], axis=1)
    each = cast_rays([[block] for block in blocks], spread, directions, ground_z=-2.0)
    np.testing.assert_array_equal(shared.blocks, each.blocks)
    np.testing.assert_allclose(shared.distances, each.distances, rtol=1e-5)


def test_each_face_of_a_turned_block_is_named_by_its_side():
    block = Block(
        center=(0.0, 0.0, 0.0),
        size=(4.0, 2.0, 2.0),
        yaw=np.pi / 2,
        surface="plain",
        color=(0.5, 0.5, 0.5),
    )
    sides = np.array(  # the block's own +x is the LiDAR frame's +y
        [[0, 9, 0], [0, -9, 0], [-9, 0, 0], [9, 0, 0], [0, 0, 9], [0, 0, -9]], np.float32
    ).T + np.array([[0.1], [0.1], [0.1]], np.float32)
    hits = cast_rays([[block]], sides, 0.1 - sides + np.float32(0.05), ground_z=None)
    assert hits.blocks.tolist() == [0] * 6
    assert hits.faces.tolist() == [0, 1, 2, 3, 4, 5]


def test_the_ground_is_met_below_the_horizon_only():
    directions = np.array([[1.0, 0.0, -0.1], [1.0, 0.0, 0.1]], np.float32).T
    hits = cast_rays([], np.array([[0.0], [0.0], [0.0]], np.float32), directions, ground_z=-2.0)
    assert hits.blocks.tolist() == [GROUND, NOTHING]
    assert hits.distances.tolist() == [20.0, np.inf]


def test_no_rays_meet_nothing():
    origin, none = np.zeros((3, 1), np.float32), np.zeros((3, 0), np.float32)
    blocks = random_blocks(np.random.default_rng(0))
    assert len(cast_rays([blocks], origin, none, ground_z=-2.0).blocks) == 0
    assert len(cast_rays([blocks], none, origin + 1, ground_z=-2.0).blocks) == 0
