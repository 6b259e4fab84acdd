import math
from dataclasses import replace

import numpy as np
import pytest

from sightline.data.formats.kitti_boxes import box_corners, project_box
from sightline.data.formats.kitti_labels import read_labels, write_objects
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.simulation.camera.camera import CameraFrame, render_camera
from sightline.simulation.labels import FrameLabels, label_frame
from sightline.simulation.scene import Mesh, Pose, Street, world_from_footprint
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import calibration_of, simulate_frame
from tests.simulation.small_streets import Straight, block, box_actor, ground, street

SIZE = (188, 621)
CALIBRATION = calibration_of(SimulationConfig(image_size=SIZE, focal_px=360.0))


def render_and_label(scenery: Street) -> tuple[CameraFrame, FrameLabels]:
    scene = scenery.snapshot(0.0)
    frame = render_camera(scene, CALIBRATION, SIZE, rng=np.random.default_rng(0))
    return frame, label_frame(scene, frame.owners, CALIBRATION, KITTI_LIDAR_HEIGHT_M)


def empty_street(rng: np.random.Generator, *, duration_s: float) -> Street:  # noqa: ARG001
    return street()


def mask_box(frame: CameraFrame, actor: int) -> np.ndarray:
    y, x = np.nonzero(frame.owners == actor)
    return np.array([x.min(), y.min(), x.max(), y.max()])


@pytest.mark.parametrize("seed", range(4))
def test_the_box_of_a_car_is_its_3d_boxs_and_the_visible_box_what_the_picture_shows(seed: int):
    rng = np.random.default_rng(seed)
    places = [(9.0, 3.5), (14.0, -4.0), (22.0, 0.0), (6.5, -4.5), (5.0, 3.2)]
    cars = [box_actor(x, y, yaw=rng.uniform(-3, 3)) for x, y in places]
    frame, labels = render_and_label(street(*cars))
    assert (labels.actors >= 0).sum() >= 4
    for row in np.flatnonzero(labels.actors >= 0).tolist():
        actor, objects = labels.actors[row], labels.objects
        corners = box_corners(
            objects.locations[row], objects.dimensions_hwl[row], float(objects.rotation_y[row])
        )
        expected = project_box(corners, CALIBRATION.image_from_camera, SIZE)
        assert objects.boxes2d[row] == pytest.approx(expected.box, abs=1e-6)
        assert objects.truncation[row] == pytest.approx(expected.truncation)
        visible_box = labels.visible_boxes[row]
        assert np.array_equal(visible_box, mask_box(frame, actor))
        # Aerials, roof boxes and tow bars extend beyond the labelled box.
        slack = 1.5 + 0.25 * (expected.box[3] - expected.box[1])
        assert (visible_box[:2] >= expected.box[:2] - slack).all()
        assert (visible_box[2:] <= expected.box[2:] + slack).all()


def test_a_pedestrians_box_is_as_wide_as_the_person_and_as_high_as_the_3d_box():
    class Diamond:
        def at(self, time_s: float) -> Mesh:  # noqa: ARG002 - a `Shape`
            return block((0.0, 0.0, 0.9), (0.1, 0.2, 0.7))

    size = (1.0, 0.9, 1.8)
    person = replace(
        box_actor(10.0, -2.0, yaw=0.4, size_lwh=size, class_name="Pedestrian"), shape=Diamond()
    )
    frame, labels = render_and_label(street(person))
    box, visible_box = labels.objects.boxes2d[0], mask_box(frame, 0)
    corners = box_corners(
        labels.objects.locations[0], np.array(size[::-1]), float(labels.objects.rotation_y[0])
    )
    whole = project_box(corners, CALIBRATION.image_from_camera, SIZE).box
    assert box[[1, 3]] == pytest.approx(whole[[1, 3]])
    gaps = (visible_box[[0, 2]] - box[[0, 2]]) * [1, -1]
    assert gaps == pytest.approx(0.7, abs=0.6)  # 2 cm
    assert whole[0] < box[0] - 3 < box[2] + 3 < whole[2]


def test_a_label_has_the_size_that_annotators_give():
    plain = box_actor(10.0, -2.0, yaw=0.4, size_lwh=(1.0, 0.6, 1.8))
    _, labels = render_and_label(street(replace(plain, labelled_lwh=(0.8, 0.7, 1.7))))
    assert labels.objects.dimensions_hwl[0].tolist() == [1.7, 0.7, 0.8]


@pytest.mark.parametrize("yaw", [0.0, math.pi])
@pytest.mark.parametrize(("class_name", "left_out"), [("Car", 0.4), ("Truck", 0.0)])
def test_the_box_of_a_car_ends_on_the_far_side_where_its_flank_does(
    yaw: float, class_name: str, left_out: float
):
    class Wedged:
        def at(self, time_s: float) -> Mesh:  # noqa: ARG002 - a `Shape`
            sides = block((0.0, 0.0, 0.75), (1.6, 0.8, 0.75))
            return Mesh.joined([sides, block((0.0, 0.0, 0.75), (2.0, 0.3, 0.75))])

    plain = box_actor(15.0, 2.0, yaw=yaw, class_name=class_name)
    _, labels = render_and_label(street(replace(plain, shape=Wedged())))
    objects = labels.objects
    assert objects.dimensions_hwl[0].tolist() == pytest.approx([1.5, 1.6, 4.0 - left_out])
    middle = CALIBRATION.camera_from_lidar[:3] @ (15.0 - left_out / 2, 2.0, 0.0, 1.0)
    assert objects.locations[0, [0, 2]] == pytest.approx(middle[[0, 2]], abs=1e-3)


def test_what_is_largely_hidden_and_cut_by_the_image_is_of_unknown_occlusion():
    for ahead, offset, level in ((8.0, 0.0, 3), (14.0, 0.3, 2)):  # the image cuts the first
        hidden = box_actor(ahead, 5.0, size_lwh=(4.0, 1.8, 1.5))
        wall = block((5.0, 25.0 / ahead + offset, 2.0), (0.05, 0.5, 2.0))
        _, labels = render_and_label(street(hidden, scenery=Mesh.joined([ground(), wall])))
        assert (labels.objects.truncation[0] > 0) == (level == 3)
        assert labels.objects.occlusion[0] == level


@pytest.mark.parametrize("tilt", [(0.04, 0.0), (-0.03, 0.05)])
def test_labels_follow_a_camera_that_is_tilted(monkeypatch, tilt: tuple[float, float]):
    pitch, roll = tilt

    def tilted(pose: Pose, height_m: float) -> np.ndarray:
        level = world_from_footprint(pose, height_m)
        if height_m == 0:  # of an actor
            return level
        c, s = math.cos(pitch), math.sin(pitch)
        about_left = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])
        c, s = math.cos(roll), math.sin(roll)
        about_ahead = np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])
        return level @ about_left @ about_ahead

    monkeypatch.setattr("sightline.simulation.labels.world_from_footprint", tilted)
    monkeypatch.setattr("sightline.simulation.camera.samples.world_from_footprint", tilted)
    frame, labels = render_and_label(
        street(box_actor(18.0, 1.0, yaw=0.3, size_lwh=(0.8, 0.8, 1.8)))
    )
    box, visible_box = labels.objects.boxes2d[0], mask_box(frame, 0)
    assert np.abs(box - visible_box).max() <= 3  # upright in the camera's frame, not in the world
    assert labels.visible_boxes[0].tolist() == visible_box.tolist()


def test_occlusion_follows_the_share_of_a_truck_that_a_wall_hides():
    truck = box_actor(20.0, 0.0, size_lwh=(8.0, 2.4, 3.0), class_name="Truck")
    levels = {}
    for share, edge in {0.0: 1.2, 0.05: 1.08, 0.3: 0.48, 0.6: -0.24}.items():
        # The camera stands 0.06 m to the left; the wall at 8 m hides all left of `edge` at 16 m.
        at_wall = 0.06 + (edge - 0.06) * (8.0 - 0.27) / (16.0 - 0.27)
        wall = block((8.0, at_wall + 3.0, 2.0), (0.01, 3.0, 2.0))
        _, labels = render_and_label(street(truck, scenery=Mesh.joined([ground(), wall])))
        assert labels.objects.class_names == ("Truck",), share
        levels[share] = int(labels.objects.occlusion[0])
    assert levels == {0.0: 0, 0.05: 1, 0.3: 1, 0.6: 2}


def test_the_box_of_an_occluded_object_is_that_of_the_whole_object():
    truck = box_actor(20.0, 0.0, size_lwh=(8.0, 2.4, 3.0), class_name="Truck")
    wall = block((8.0, 3.0, 2.0), (0.01, 3.0, 2.0))
    _, hidden = render_and_label(street(truck, scenery=Mesh.joined([ground(), wall])))
    _, free = render_and_label(street(truck))
    assert np.array_equal(hidden.objects.boxes2d, free.objects.boxes2d)


def test_truncation_is_the_share_of_the_outline_beyond_the_image():
    # Seen end on, the near face (2 m wide, 8 m ahead of the camera) is the whole outline.
    left_edge = (0 - float(CALIBRATION.image_from_camera[0, 2])) / 360.0 * 8.0
    left = 0.06 - left_edge  # of the LiDAR, at that distance
    actor = box_actor(8.27 + 0.01, left + 0.5, size_lwh=(0.02, 2.0, 1.5))
    _, labels = render_and_label(street(actor))
    assert float(labels.objects.truncation[0]) == pytest.approx(0.75, abs=0.02)
    assert float(labels.objects.boxes2d[0, 0]) == 0


def test_what_is_wholly_inside_is_not_truncated():
    _, labels = render_and_label(street(box_actor(15.0, 0.0)))
    assert float(labels.objects.truncation[0]) == 0


def test_what_nothing_shows_of_has_no_label():
    wall = block((8.0, 0.0, 2.0), (0.1, 4.0, 2.0))
    _, labels = render_and_label(
        street(box_actor(15.0, 0.0), scenery=Mesh.joined([ground(), wall]))
    )
    assert len(labels.objects.class_names) == 0
    assert labels.objects.locations.shape == (0, 3)


def test_a_street_without_road_users_has_no_labels():
    frame = simulate_frame(SimulationConfig(image_size=(94, 310), focal_px=180.0), 0, empty_street)
    assert len(frame.objects.class_names) == 0
    assert not frame.instances.any()


def test_a_few_pixels_over_a_wall_do_not_make_a_label_but_a_region_to_ignore():
    # Of the person behind the wall only the top of the head shows.
    person = box_actor(6.0, 0.0, size_lwh=(0.5, 0.6, 1.8), class_name="Pedestrian")
    wall = block((5.0, 0.0, 0.865), (0.05, 2.0, 0.865))
    frame, labels = render_and_label(street(person, scenery=Mesh.joined([ground(), wall])))
    num_visible = (frame.owners == 0).sum()
    assert 25 <= num_visible < 200
    assert labels.objects.class_names == ("DontCare",)
    box, top = labels.objects.boxes2d[0], mask_box(frame, 0)
    assert (box[:2] <= top[:2] + 1).all()
    assert (box[2:] >= top[2:] - 1).all()
    assert box[3] > top[3] + 30  # down to the feet
    assert np.isnan(labels.visible_boxes).all()


def test_far_groups_are_one_region_without_a_3d_part(tmp_path):
    far = [box_actor(85.0, y) for y in (-1.0, 1.0, 3.0)] + [box_actor(88.0, 25.0)]
    _, labels = render_and_label(street(*far, box_actor(12.0, -3.0)))
    assert labels.objects.class_names == ("Car", "DontCare", "DontCare")
    assert labels.actors.tolist() == [4, -1, -1]
    write_objects(tmp_path / "0.txt", labels.objects)
    line = (tmp_path / "0.txt").read_text().splitlines()[1].split()
    assert line[:4] == ["DontCare", "-1", "-1", "-10"]
    assert line[8:] == ["-1", "-1", "-1", "-1000", "-1000", "-1000", "-10"]


@pytest.mark.parametrize("ego_yaw", [0.0, 0.7])
def test_3d_part_is_kittis(tmp_path, ego_yaw: float):
    cos, sin = math.cos(ego_yaw), math.sin(ego_yaw)
    ego = Pose(x=30.0, y=-20.0, z=0.0, yaw=ego_yaw)
    ahead, left = 15.27, 3.06  # 15 m ahead of the camera, 3 m to its left
    actor = box_actor(
        30.0 + cos * ahead - sin * left,
        -20.0 + sin * ahead + cos * left,
        yaw=ego_yaw + 0.2,
        size_lwh=(4.2, 1.7, 1.5),
    )
    _, labels = render_and_label(street(actor, ego=Straight(ego)))
    write_objects(tmp_path / "0.txt", labels.objects)
    read = read_labels(tmp_path / "0.txt")
    assert read.dimensions_hwl[0].tolist() == [1.5, 1.7, 4.2]
    # The bottom centre: the camera stands 1.65 m above the road. KITTI's camera 2 is 0.06 m left.
    assert read.locations[0] == pytest.approx([-3.06, 1.65, 15.0], abs=0.011)
    assert read.rotation_y[0] == pytest.approx(-0.2 - math.pi / 2, abs=0.006)
    bearing = math.atan2(-3.06, 15.0)
    assert read.alpha[0] == pytest.approx(-0.2 - math.pi / 2 - bearing, abs=0.011)


def test_an_actor_beside_the_camera_that_reaches_behind_it_is_labelled_without_a_fault():
    frame, labels = render_and_label(street(box_actor(1.5, 2.2, size_lwh=(6.0, 1.8, 1.6))))
    box = labels.objects.boxes2d[0]
    assert np.abs(box - mask_box(frame, 0)).max() <= 1.5
    assert 0.3 < float(labels.objects.truncation[0]) <= 1
