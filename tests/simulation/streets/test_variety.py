"""Streets as varied as other rigs than KITTI's meet them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sightline.simulation.camera.camera import CameraConfig, render_camera
from sightline.simulation.lidar import take_sweep
from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.rays.surfaces import puddle_share
from sightline.simulation.rig_sensors import lidar_config, mount
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import QuadBatch
from sightline.simulation.street import draw_light, make_street, place_traffic, wetted
from sightline.simulation.streets.bicycle_rows import park_bicycles
from sightline.simulation.streets.free_ground import Occupancy, StreetObjects
from sightline.simulation.streets.layout import StreetKind
from sightline.simulation.streets.layout_drawing import draw_layout
from sightline.simulation.streets.variety import Variety, draw_variety
from sightline.simulation.surroundings.buildings import (
    BuildingSite,
    build,
    draw_town_house,
    glazed,
    heightened,
)
from sightline.simulation.traffic.varied_traffic import VariedFleet
from tests.simulation.shapes.mesh_checks import assert_sound
from tests.simulation.small_streets import block, ground, street
from tests.simulation.test_rig_frames import CAMERA, LIDAR, RIG

PLAIN = Variety(
    kind=StreetKind.CITY, is_tall=False, glazed_share=0.0, has_wide_junction=False,
    bicycle_rows=0.0, cyclists=1.0, heavy=1.0, motorcycles=0.0, sitting=0.0, is_wet=False,
    is_dusk=False,
)  # fmt: skip


def test_every_difference_is_drawn_alone_and_with_others():
    drawn = [draw_variety(np.random.default_rng(seed)) for seed in range(400)]
    assert {each.kind for each in drawn} == set(StreetKind)
    for name in ("is_tall", "has_wide_junction", "is_wet", "is_dusk"):
        assert 0.05 < np.mean([getattr(each, name) for each in drawn]) < 0.6
    for name in ("glazed_share", "bicycle_rows", "sitting"):
        assert 0.2 < np.mean([getattr(each, name) > 0 for each in drawn]) < 0.7
    assert all(0 <= each.glazed_share <= 0.8 and each.cyclists <= 14 for each in drawn)
    country = [each for each in drawn if each.kind is StreetKind.COUNTRY]
    assert not any(each.is_tall or each.has_wide_junction for each in country)


@pytest.mark.parametrize("seed", range(4))
def test_varied_streets_are_sound_and_the_same_for_a_seed(seed):
    first, again = (make_street(np.random.default_rng(seed), varied=True) for _ in range(2))
    assert first.snapshot().mesh.vertices.tobytes() == again.snapshot().mesh.vertices.tobytes()
    assert_sound(first.ground_and_buildings)
    usual = make_street(np.random.default_rng(seed))
    assert first.light != usual.light or len(first.actors) != len(usual.actors)


def bicycles(seed, mean_rows=4.0):
    rng = np.random.default_rng(seed)
    layout = draw_layout(rng, StreetKind.CITY)
    objects = StreetObjects(rng, layout, Occupancy(1))
    return layout, park_bicycles(rng, layout, objects, mean_rows)


def test_parked_bicycles_stand_in_rows_on_the_ground_beside_the_road():
    layout, meshes = bicycles(2)
    assert len(meshes) > 2
    for mesh in meshes:
        if len(mesh.faces):
            assert_sound(mesh)
            heights = mesh.vertices[:, 2] - layout.terrain.height(
                mesh.vertices[:, :2].astype(np.float64)
            )
            assert -0.15 < heights.min() < 0.16
            assert heights.max() < 1.4


def test_parked_bicycles_return_points_and_have_no_label():
    _, meshes = bicycles(2)
    scenery = Mesh.joined([ground(), *meshes])
    usual, parked = (street(scenery=each).snapshot() for each in (ground(), scenery))
    assert parked.actors == ()
    sweeps = [
        take_sweep(
            scene,
            Raycaster(scene.mesh),
            rng=np.random.default_rng(0),
            config=lidar_config(LIDAR),
        )
        for scene in (usual, parked)
    ]
    standing = [(sweep[:, 2] > -LIDAR.height_m + 0.3).sum() for sweep in sweeps]
    assert standing[0] == 0
    assert standing[1] > 100


def front(form, rng):
    batch = QuadBatch()
    site = BuildingSite(
        corner=(12.0, 10.0), yaw=-np.pi / 2, ground=0.0, width=20.0, depth=10.0, is_far=False
    )
    build(rng, batch, site, form)
    return batch.mesh()


def test_tall_houses_have_six_storeys_or_more():
    rng = np.random.default_rng(0)
    forms = [heightened(rng, draw_town_house(rng)) for _ in range(20)]
    assert {form.storeys for form in forms} <= set(range(6, 16))
    mesh = front(forms[0], rng)
    assert_sound(mesh)
    assert mesh.vertices[:, 2].max() > 6 * forms[0].storey_height


def test_a_glass_front_mirrors_the_street_and_returns_few_points():
    rng = np.random.default_rng(0)
    form = replace(draw_town_house(rng), has_shop=False, storeys=4)
    counts = []
    for each in (form, glazed(rng, form)):
        mesh = Mesh.joined([ground(), front(each, np.random.default_rng(1))])
        scene = street(scenery=mesh).snapshot()
        points = take_sweep(
            scene, Raycaster(mesh), rng=np.random.default_rng(0), config=lidar_config(LIDAR)
        )
        wall = (np.abs(points[:, 0] - 12.0) < 0.3) & (points[:, 2] > -1.0)
        counts.append(int(wall.sum()))
    assert counts[0] > 500
    assert counts[1] < 0.35 * counts[0]
    mesh = front(glazed(rng, form), np.random.default_rng(1))
    panes = mesh.materials == Material.COATED_GLASS
    area = np.linalg.norm(
        np.cross(
            mesh.vertices[mesh.faces[:, 1]] - mesh.vertices[mesh.faces[:, 0]],
            mesh.vertices[mesh.faces[:, 2]] - mesh.vertices[mesh.faces[:, 0]],
        ),
        axis=1,
    )
    facing = (mesh.vertices[mesh.faces, 0].mean(axis=1) < 12.2) & panes
    assert area[facing].sum() / 2 > 0.7 * 20 * 4 * form.storey_height


def test_water_changes_roads_and_pavements_alone():
    mesh = make_street(np.random.default_rng(1), kind=StreetKind.CITY).ground_and_buildings
    wet = wetted(mesh)
    changed = {
        (Material(int(a)), Material(int(b)))
        for a, b in zip(mesh.materials, wet.materials, strict=True)
        if a != b
    }
    assert (Material.ASPHALT, Material.WET_ASPHALT) in changed
    assert {dry for dry, _ in changed} <= {Material.ASPHALT, Material.PAVEMENT, Material.COBBLES}
    np.testing.assert_array_equal(mesh.vertices, wet.vertices)


def test_a_wet_road_is_darker_mirrors_what_stands_on_it_and_returns_less():
    tower = block((18.0, 0.0, 4.0), (0.5, 3.0, 4.0), color=(0.9, 0.02, 0.02))
    dry = Mesh.joined([ground(), tower])
    returns, reds, levels = [], [], []
    for mesh in (dry, wetted(dry)):
        scene = street(scenery=mesh).snapshot()
        raycaster = Raycaster(mesh)
        points = take_sweep(
            scene, raycaster, rng=np.random.default_rng(0), config=lidar_config(LIDAR)
        )
        is_road = points[:, 2] < -LIDAR.height_m + 0.1
        returns.append(int((is_road & (np.hypot(*points[:, :2].T) > 22)).sum()))
        shown = render_camera(
            scene,
            mount(RIG).level_calibration,
            CAMERA.image_size,
            rng=np.random.default_rng(0),
            config=CameraConfig(lidar_height_m=LIDAR.height_m),
            raycaster=raycaster,
        )
        assert shown.image is not None
        image = shown.image.astype(float)
        before = image[150:165, 190:210]  # the road before the tower
        reds.append(float((before[..., 0] - before[..., 1]).max()))
        levels.append(image[200:, :100].mean() / image[:40].mean())
    assert returns[0] > 500
    assert returns[1] < 0.3 * returns[0]
    assert reds[1] > reds[0] + 5
    assert levels[1] < levels[0]


def test_water_lies_in_some_places_and_not_in_others():
    shares = [puddle_share(0.7 * x, 0.9 * y) for x in range(40) for y in range(40)]
    assert 0.03 < np.mean([share > 0.8 for share in shares]) < 0.4
    assert np.mean([share == 0 for share in shares]) > 0.3


def test_at_nightfall_there_is_no_sun_and_little_light():
    lights = [
        draw_light(np.random.default_rng(seed), replace(PLAIN, is_dusk=True)) for seed in range(20)
    ]
    assert all(light.sun_color == (0.0, 0.0, 0.0) for light in lights)
    assert max(max(light.sky_zenith) for light in lights) < 0.2
    usual = draw_light(np.random.default_rng(0))
    assert draw_light(np.random.default_rng(0), PLAIN) == usual


def test_a_wide_junction_has_several_lanes_each_way_on_both_roads():
    for seed in range(6):
        layout = draw_layout(np.random.default_rng(seed), StreetKind.AVENUE, wide=True)
        assert layout.junction is not None
        assert layout.junction.radius >= 8
        assert layout.junction.opens_left
        assert layout.junction.opens_right
        for road in layout.roads:
            for direction in (-1, 1):
                lanes = [
                    lane
                    for lane in road.lanes
                    if lane.direction == direction and not lane.for_trams
                ]
                assert 2 <= len(lanes) <= 3


@cache  # several tests compare with the same plain street
def crowd_of(variety, seed):
    rng = np.random.default_rng(seed)
    layout = draw_layout(rng, StreetKind.CITY)
    return place_traffic(rng, layout, (), (), VariedFleet(), 0.0, variety=variety)


def count(variety, name, tall=0.0, seeds=8):
    crowds = [crowd_of(variety, seed) for seed in range(seeds)]
    return sum(
        actor.class_name == name and actor.size_lwh[2] > tall
        for crowd in crowds
        for actor in crowd.actors
    )


def test_bicycle_traffic_and_sitting_groups_are_labelled_as_what_they_are():
    assert count(replace(PLAIN, cyclists=10.0), "Cyclist") > 3 * count(PLAIN, "Cyclist") + 5
    sitting = count(replace(PLAIN, sitting=3.0), "Person_sitting")
    assert sitting > count(PLAIN, "Person_sitting") + 10


def test_ridden_motorcycles_are_cyclists_and_parked_ones_misc():
    many = replace(PLAIN, motorcycles=3.0)
    assert count(many, "Cyclist") > count(PLAIN, "Cyclist") + 5
    assert count(many, "Misc") > count(PLAIN, "Misc") + 5


def test_the_fleet_has_buses_and_lorries_of_many_sizes_as_trucks():
    rng = np.random.default_rng(0)
    models = [VariedFleet().draw(rng, "Truck", 0.0) for _ in range(60)]
    assert {model.class_name for model in models} == {"Truck"}
    lengths = [model.size_lwh[0] for model in models]
    assert min(lengths) < 8
    assert max(lengths) > 16
    assert any(model.size_lwh[2] > 4.0 for model in models)


def test_no_road_user_of_a_varied_street_floats_or_sinks():
    for seed in range(3):
        made = make_street(np.random.default_rng([seed, 4]), varied=True)
        caster = Raycaster(made.ground_and_buildings)
        for actor in made.actors:
            pose = actor.motion.at(0.0)
            start = np.array([[pose.x, pose.y, pose.z + 0.25]], np.float32)
            down = caster.cast(start, np.array([[0.0, 0.0, -1.0]], np.float32)).distances[0]
            assert down == pytest.approx(0.25, abs=0.12), actor.class_name
