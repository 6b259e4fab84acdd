import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.simulation.bodies.cyclists import make_cyclist
from sightline.simulation.bodies.figure import Build, make_figure
from sightline.simulation.bodies.models import KITTI_SIZES
from sightline.simulation.bodies.people import (
    WalkingPerson,
    draw_outfit,
    make_pedestrian,
    make_sitting_person,
)
from sightline.simulation.bodies.skeleton import (
    REST_JOINTS,
    Bone,
    Turn,
    bone_transforms,
    reach,
    turn_matrices,
)
from sightline.simulation.scene import Material
from tests.simulation.shapes.mesh_checks import assert_sound, share_of_front_faces

WALKING_MPS = 1.4
MAKERS = {
    "walking": lambda rng: make_pedestrian(rng, WALKING_MPS),
    "standing": lambda rng: make_pedestrian(rng, 0.0),
    "sitting": make_sitting_person,
    "cycling": lambda rng: make_cyclist(rng, 4.5),
}
TIMES = np.linspace(0.0, 2.5, 21)


def test_people_stay_in_their_box_and_fill_it_over_time():
    for seed in range(4):
        for make in MAKERS.values():
            model = make(np.random.default_rng(seed))
            corners = [model.shape.at(float(time)).vertices for time in TIMES]
            low = np.min([vertices.min(axis=0) for vertices in corners], axis=0)
            high = np.max([vertices.max(axis=0) for vertices in corners], axis=0)
            length, width, height = model.size_lwh
            assert (low > (-length / 2 - 0.01, -width / 2 - 0.01, -0.01)).all()
            assert (high < (length / 2 + 0.01, width / 2 + 0.01, height + 0.01)).all()
            # Times between those at which the box was measured miss its sides by a little.
            assert (high - low > np.array(model.size_lwh) - 0.03).all()


def test_feet_are_on_the_ground_at_all_times():
    for seed in range(3):
        shape = make_pedestrian(np.random.default_rng(seed), WALKING_MPS).shape
        for time in TIMES:
            assert shape.at(float(time)).vertices[:, 2].min() == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("name", MAKERS)
def test_meshes_are_sound(name):
    for seed in range(8):
        shape = MAKERS[name](np.random.default_rng(seed)).shape
        for time in (0.0, 0.4):
            assert_sound(shape.at(time))


@pytest.mark.parametrize("name", MAKERS)
def test_from_outside_a_ray_meets_front_faces(name):
    for seed in range(4):
        mesh = MAKERS[name](np.random.default_rng(seed)).shape.at(0.3)
        assert share_of_front_faces(mesh) > 0.97


@pytest.mark.parametrize("name", ["walking", "cycling"])
def test_moving_people_change_their_pose_with_time_and_standing_ones_do_not(name):
    shape = MAKERS[name](np.random.default_rng(0)).shape
    change = np.abs(shape.at(0.0).vertices - shape.at(0.25).vertices).max()
    assert change > 0.1
    still = MAKERS["standing"](np.random.default_rng(0)).shape
    assert (still.at(0.0).vertices == still.at(0.25).vertices).all()


def test_walking_is_periodic_and_its_halves_mirror_each_other_in_the_feet():
    walker = make_pedestrian(np.random.default_rng(0), WALKING_MPS).shape
    assert isinstance(walker, WalkingPerson)
    stride_s = 1 / walker.gait.stride_hz
    now, later = walker.at(0.3).vertices, walker.at(0.3 + stride_s).vertices
    assert now == pytest.approx(later, abs=1e-4)
    half = walker.at(0.3 + stride_s / 2).vertices
    assert np.abs(now - half).max() > 0.2
    assert half[:, 0].max() == pytest.approx(now[:, 0].max(), abs=0.05)


def ankles(walker, time_s):
    """x of both ankles."""
    mesh = walker.at(time_s)
    weights = walker.figure.skinned.weights
    shoes = mesh.materials == Material.RUBBER
    vertices = np.unique(mesh.faces[shoes])
    return [
        mesh.vertices[vertices[weights[vertices, foot] > 0.5], 0].mean()
        for foot in (Bone.LEFT_FOOT, Bone.RIGHT_FOOT)
    ]


@pytest.mark.parametrize("speed_mps", [0.8, 1.4, 1.8])
def test_two_steps_are_as_long_as_the_way_walked_meanwhile(speed_mps):
    walker = make_pedestrian(np.random.default_rng(1), speed_mps).shape
    stride_s = 1 / walker.gait.stride_hz
    strike_s = (2 * np.pi - walker.gait.start) / (2 * np.pi * walker.gait.stride_hz)
    left, right = ankles(walker, strike_s)
    assert left - right == pytest.approx(speed_mps * stride_s / 2, rel=0.25)


def test_the_standing_foot_stays_on_its_spot_of_the_road():
    walker = make_pedestrian(np.random.default_rng(1), WALKING_MPS).shape
    stride_s = 1 / walker.gait.stride_hz
    strike_s = (2 * np.pi - walker.gait.start) / (2 * np.pi * walker.gait.stride_hz)
    times = strike_s + stride_s * np.linspace(0.1, 0.4, 7)  # only the left foot stands
    on_road = [ankles(walker, time)[0] + WALKING_MPS * time for time in times]
    way = WALKING_MPS * (times[-1] - times[0])
    assert np.ptp(on_road) < 0.25 * way


def test_faster_people_take_longer_and_quicker_steps():
    slow, fast = (make_pedestrian(np.random.default_rng(2), speed).shape for speed in (0.8, 1.8))
    assert fast.gait.swing > slow.gait.swing
    assert fast.gait.stride_hz > slow.gait.stride_hz


def test_a_turn_of_the_cranks_brings_the_cyclist_back_and_half_a_turn_does_not():
    cyclist = make_cyclist(np.random.default_rng(0), 4.0).shape
    rider_now = cyclist.turned_to(0.0, 0.0).vertices
    rider_later = cyclist.turned_to(2 * np.pi, 0.0).vertices
    assert rider_now == pytest.approx(rider_later, abs=1e-4)
    assert np.abs(cyclist.turned_to(np.pi, 0.0).vertices - rider_now).max() > 0.2


def test_riders_keep_feet_on_pedals_and_hands_near_the_grips():
    for seed in range(5):
        cyclist = make_cyclist(np.random.default_rng(seed), 4.0).shape
        weights = cyclist.rider.skinned.weights
        for crank in (0.0, 1.0, 2.5, 4.0):
            transforms, shift = cyclist._rider_transforms(crank)
            bent = cyclist.rider.skinned.bent_vertices(transforms) + shift
            sole = bent[weights[:, Bone.LEFT_FOOT] > 0.9, 2].min()
            pedal = 0.29 + 0.17 * np.cos(crank)
            assert sole == pytest.approx(pedal, abs=0.06)
            hand = bent[weights[:, Bone.LEFT_FOREARM] > 0.99]
            distance = np.linalg.norm(hand - np.array(cyclist.bicycle.grips), axis=1).min()
            assert distance < 0.07


def test_sizes_are_near_those_of_kitti():
    for name, class_name, tolerance in (
        ("sitting", "Person_sitting", (0.15, 0.15, 0.05)),
        ("cycling", "Cyclist", (0.05, 0.10, 0.05)),
    ):
        sizes = [MAKERS[name](np.random.default_rng(seed)).size_lwh for seed in range(20)]
        assert (
            np.abs(np.mean(sizes, axis=0) / np.array(KITTI_SIZES[class_name].mean) - 1) < tolerance
        ).all()


def test_labels_of_pedestrians_are_as_large_as_kittis_and_spread_as_they():
    speeds = np.random.default_rng(0).choice([0.0, 1.0, 1.2, 1.4, 1.6], 200, p=[0.28, *[0.18] * 4])
    sizes = np.array(
        [
            make_pedestrian(np.random.default_rng(i), float(speed)).labelled_lwh
            for i, speed in enumerate(speeds)
        ]
    )
    kitti = KITTI_SIZES["Pedestrian"]
    assert np.abs(sizes.mean(axis=0) - kitti.mean).max() < 0.05
    assert np.abs(sizes.std(axis=0) - kitti.deviation).max() < 0.04
    assert (sizes[:, :2] >= kitti.low[:2]).all()
    assert (sizes[:, :2] <= kitti.high[:2]).all()


@pytest.mark.parametrize("speed_mps", [0.0, 1.4])
def test_what_is_written_on_labels_changes_nothing_that_is_drawn(monkeypatch, speed_mps: float):
    rng = np.random.default_rng(7)
    labelled = make_pedestrian(rng, speed_mps)
    after = rng.bit_generator.state
    assert labelled.labelled_lwh != labelled.size_lwh
    monkeypatch.setattr(
        "sightline.simulation.bodies.people._annotated", lambda _, model, **__: model
    )
    rng = np.random.default_rng(7)
    assert make_pedestrian(rng, speed_mps).size_lwh == labelled.size_lwh
    assert rng.bit_generator.state == after


@pytest.mark.parametrize("name", MAKERS)
def test_the_same_seed_makes_the_same_person_whatever_the_global_generator_does(name):
    np.random.seed(1)  # noqa: NPY002
    state = np.random.get_state()[1].tobytes()  # noqa: NPY002
    first = MAKERS[name](np.random.default_rng(3))
    assert np.random.get_state()[1].tobytes() == state  # noqa: NPY002
    np.random.seed(2)  # noqa: NPY002
    second = MAKERS[name](np.random.default_rng(3))
    assert first.size_lwh == second.size_lwh
    assert first.labelled_lwh == second.labelled_lwh
    one, other = first.shape.at(0.7), second.shape.at(0.7)
    assert one.vertices.tobytes() == other.vertices.tobytes()
    assert one.colors.tobytes() == other.colors.tobytes()


def test_triangle_budgets_are_kept():
    for seed in range(5):
        for name, limit in (("walking", 3000), ("standing", 3000), ("cycling", 5500)):
            mesh = MAKERS[name](np.random.default_rng(seed)).shape.at(0.0)
            assert 1500 < len(mesh.faces) < limit


@settings(max_examples=25)
@given(
    height=st.floats(1.1, 2.0),
    girth=st.floats(0.85, 1.4),
    head=st.floats(1.0, 1.3),
    seed=st.integers(0, 1000),
)
def test_a_figure_is_as_tall_as_its_build_says(height, girth, head, seed):
    build = Build(height=height, girth=girth, head=head)
    figure = make_figure(build, draw_outfit(np.random.default_rng(seed)))
    assert np.ptp(figure.skinned.mesh.vertices[:, 2]) == pytest.approx(height, rel=0.02)
    assert figure.skinned.weights.sum(axis=1) == pytest.approx(1.0, abs=1e-5)


def test_the_resting_pose_moves_nothing():
    transforms = bone_transforms({}, REST_JOINTS)
    assert transforms[:, :, :3] == pytest.approx(np.tile(np.eye(3), (len(Bone), 1, 1)))
    assert transforms[:, :, 3] == pytest.approx(0.0)


def test_convention_positive_turns_swing_a_hanging_limb_forward_and_to_the_left():
    hanging = np.array((0.0, 0.0, -1.0))
    forward, left, twist = turn_matrices(
        np.array([Turn(forward=0.5), Turn(left=0.5), Turn(twist=0.5)])
    )
    assert forward @ hanging == pytest.approx((np.sin(0.5), 0, -np.cos(0.5)))
    assert left @ hanging == pytest.approx((0, np.sin(0.5), -np.cos(0.5)))
    assert twist @ (1.0, 0.0, 0.0) == pytest.approx((np.cos(0.5), np.sin(0.5), 0))


def test_children_of_a_bone_follow_it():
    transforms = bone_transforms({Bone.LEFT_THIGH: Turn(forward=np.pi / 2)}, REST_JOINTS)
    ankle = transforms[Bone.LEFT_FOOT, :, :3] @ REST_JOINTS[Bone.LEFT_FOOT]
    ankle = ankle + transforms[Bone.LEFT_FOOT, :, 3]
    hip = REST_JOINTS[Bone.LEFT_THIGH]
    assert ankle == pytest.approx((hip[0] + hip[2] - 0.08, hip[1], hip[2]))
    still = transforms[Bone.RIGHT_FOOT]
    assert still == pytest.approx(np.eye(3, 4))


@given(ahead=st.floats(-0.7, 0.7), above=st.floats(-0.7, 0.7))
def test_a_limb_reaches_every_point_within_its_length(ahead, above):
    upper, lower = 0.4, 0.45
    distance = np.hypot(ahead, above)
    if not 0.06 < distance < 0.84:
        return
    way = reach(ahead, above, upper, lower)
    first = way.toward + way.opening
    second = first - way.bend
    end = (
        upper * np.sin(first) + lower * np.sin(second),
        -upper * np.cos(first) - lower * np.cos(second),
    )
    assert end == pytest.approx((ahead, above), abs=1e-6)
