"""Road users: positions over time, and counts of visible ones."""

from collections import Counter
from dataclasses import astuple
from functools import cache
from itertools import product

import numpy as np
import pytest

from sightline.simulation.street import place_traffic
from sightline.simulation.streets.free_ground import Occupancy, rectangles_overlap
from sightline.simulation.streets.layout_drawing import draw_layout
from sightline.simulation.streets.lots import bays_of, draw_lots, footprint_corners, footprint_of
from sightline.simulation.traffic.crowd import EGO_SIZE_LW, stopping_distance_m
from sightline.simulation.traffic.driving import turning_line
from sightline.simulation.traffic.motion import AlongRoad, Travel
from tests.simulation.visible_boxes import SizesOnly, labelled

# Labels per frame and their mean distance [m] in KITTI's 7,481 training label files.
KITTI_COUNTS = {
    "Car": (3.842, 29.3),
    "Van": (0.390, 36.2),
    "Pedestrian": (0.600, 18.4),
    "Cyclist": (0.217, 25.9),
}


@cache  # several tests look at the same streets
def _traffic(seed, duration_s=0.0, *, hard=False):
    rng = np.random.default_rng([8, seed])
    layout = draw_layout(rng, extra_length_m=14.0 * duration_s, hard=hard)
    lots = draw_lots(rng, layout)
    bays = bays_of(rng, lots)
    traffic = place_traffic(rng, layout, lots, bays, SizesOnly(), duration_s, hard=hard)
    return layout, lots, traffic


def _corners(pose, length, width):
    along = np.array([np.cos(pose.yaw), np.sin(pose.yaw)]) * length / 2
    aside = np.array([-np.sin(pose.yaw), np.cos(pose.yaw)]) * width / 2
    middle = np.array([pose.x, pose.y])
    return np.array(
        [middle + a * along + b * aside for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
    )


def _separated(first, second):
    """Test two convex polygons for a separating edge: the plain separating axis test."""
    for polygon in (first, second):
        for row in range(len(polygon)):
            edge = polygon[(row + 1) % len(polygon)] - polygon[row]
            axis = np.array([-edge[1], edge[0]])
            a, b = first @ axis, second @ axis
            if a.max() <= b.min() or b.max() <= a.min():
                return True
    return False


@pytest.mark.parametrize("seed", range(24))
def test_nobody_ever_stands_in_anybody_or_in_a_wall(seed):
    duration_s = 6.0
    _, lots, traffic = _traffic(seed, duration_s)
    walls = [footprint_corners(found) for lot in lots if (found := footprint_of(lot)) is not None]
    for time_s in np.arange(0.0, duration_s + 0.01, 0.5):
        outlines = [
            _corners(actor.motion.at(time_s), *actor.size_lwh[:2]) for actor in traffic.actors
        ]
        outlines.append(_corners(traffic.ego.at(time_s), *EGO_SIZE_LW))
        middles = np.array([outline.mean(axis=0) for outline in outlines])
        for row, outline in enumerate(outlines):
            near = np.hypot(*(middles[:row] - middles[row]).T) < 25.0
            for other in np.flatnonzero(near):
                assert _separated(outline, outlines[other])
            for wall in walls:
                if np.hypot(*(wall.mean(axis=0) - middles[row])) < 40.0:
                    assert _separated(outline, wall)


def test_the_lane_ahead_of_the_ego_is_free_for_its_stopping_distance():
    for seed in range(60):
        layout, _, traffic = _traffic(seed)
        room = stopping_distance_m(traffic.ego_travel.speed_mps) if _is_moving(traffic) else 2.0
        for actor in traffic.actors:
            track = actor.motion
            if actor.class_name not in ("Car", "Van", "Truck") or not isinstance(track, AlongRoad):
                continue
            in_lane = track.road is layout.main and abs(track.offset - layout.ego_lane.offset) < 0.8
            if in_lane and track.station > 0:
                bumper = track.station - actor.size_lwh[0] / 2 - EGO_SIZE_LW[0] / 2
                assert bumper > room


def _is_moving(traffic):
    return traffic.ego_travel.speed_mps > 0


def test_vehicles_drive_to_the_right_of_the_middle_along_their_lane():
    for seed in range(30):
        _, _, traffic = _traffic(seed)
        for actor in traffic.actors:
            track = actor.motion
            if isinstance(track, AlongRoad) and track.travel.speed_mps > 5 and track.turn == 0.0:
                both = {lane.direction for lane in track.road.lanes} == {1, -1}
                if both and actor.class_name in ("Car", "Van", "Truck"):
                    assert track.offset * track.direction < 0


def test_motion_is_smooth_and_its_speed_is_that_of_the_travel():
    layout, _, _ = _traffic(3)
    travel = Travel(speed_mps=10.0, sway_mps=1.0, phase=0.4)
    track = AlongRoad(
        terrain=layout.terrain, road=layout.main, station=0.0, offset=layout.ego_lane.offset,
        direction=1, travel=travel,
    )  # fmt: skip
    times = np.arange(0.0, 5.0, 0.05)
    rows = track.poses(times)
    speeds = np.hypot(*np.diff(rows[:, :2], axis=0).T) / 0.05
    assert np.abs(np.diff(speeds)).max() < 0.1
    expected = np.diff(travel.distance(times)) / 0.05
    factor = speeds / expected  # an offset lane of a bend is longer or shorter than its middle
    assert factor == pytest.approx(1.0, abs=0.12)
    pose = track.at(1.35)
    np.testing.assert_allclose(astuple(pose), track.poses(np.array([1.35]))[0], rtol=0, atol=0)


def test_turning_lines_begin_in_the_middle_of_one_lane_and_end_in_that_of_another():
    num_lines = 0
    for seed in range(60):
        layout, _, _ = _traffic(seed)
        if layout.junction is None:
            continue
        for main_lane, cross_lane in product(layout.main.lanes, layout.junction.cross.lanes):
            for is_from_main in (True, False):
                line = turning_line(layout, main_lane, cross_lane, 7.0, is_from_main=is_from_main)
                ends = [_in_junction(layout, line, station) for station in (-12.0, 12.0)]
                on_main, on_cross = ends if is_from_main else ends[::-1]
                np.testing.assert_allclose(on_main[1], main_lane.offset, atol=0.02)
                np.testing.assert_allclose(-on_cross[0], cross_lane.offset, atol=0.02)
                headings = (
                    (0.0 if main_lane.direction > 0 else np.pi),
                    cross_lane.direction * np.pi / 2,
                )
                for (_, _, yaw), heading in zip((on_main, on_cross), headings, strict=True):
                    assert np.cos(yaw - heading) == pytest.approx(1.0, abs=1e-4)
                num_lines += 1
    assert num_lines > 100


def _in_junction(layout, line, station):
    """Station from the crossing on, offset and heading of a place on a line."""
    middle = np.array(layout.junction.station)
    yaw = float(layout.main.line.yaw(middle))
    x, y = line.place(np.array(station), np.array(0.0)) - layout.main.line.place(
        middle, np.zeros(())
    )
    along, aside = x * np.cos(yaw) + y * np.sin(yaw), y * np.cos(yaw) - x * np.sin(yaw)
    return along, aside, float(line.yaw(np.array(station))) - yaw


def test_hard_streets_have_more_cars_and_more_far_away():
    def cars(hard):
        tracks = [_traffic(seed, hard=hard)[2].actors for seed in range(40)]
        places = [actor.motion.at(0.0) for actors in tracks for actor in actors
                  if actor.class_name == "Car"]  # fmt: skip
        return np.array([np.hypot(pose.x, pose.y) for pose in places])

    usual, hard = cars(hard=False), cars(hard=True)
    assert len(hard) > 1.4 * len(usual)
    assert np.mean(hard > 45) > np.mean(usual > 45)


def test_many_pedestrians_walk_or_wait_in_groups():
    near = []
    for seed in range(120):
        _, _, traffic = _traffic(1000 + seed)
        people = [actor.motion.at(0.0) for actor in traffic.actors
                  if actor.class_name == "Pedestrian"]  # fmt: skip
        places = np.array([[pose.x, pose.y] for pose in people]).reshape(-1, 2)
        apart = np.linalg.norm(places[:, None] - places, axis=-1)
        near += (np.sort(apart, axis=1)[:, 1:2] < 1.5).any(axis=1).tolist()
    assert np.mean(near) == pytest.approx(0.40, abs=0.15)  # of KITTI's labelled pedestrians


def test_occupancy_that_is_asked_only_takes_nothing():
    occupancy = Occupancy(2)
    assert occupancy.num_moments == 2
    assert occupancy.is_free(np.zeros((2, 4)), 4.0, 2.0)
    assert occupancy.try_add(np.zeros((2, 4)), 4.0, 2.0)
    assert not occupancy.is_free(np.zeros((2, 4)), 4.0, 2.0)


def test_occupancy_refuses_what_overlaps_and_keeps_the_margin():
    occupancy = Occupancy(1)
    assert occupancy.try_add(np.zeros((1, 6)), 4.0, 2.0)
    beside = np.array([[0.0, 2.05, 0.0, 0.0, 0.0, 0.0]])
    assert not occupancy.try_add(beside, 4.0, 2.0, margin=0.2)
    assert occupancy.try_add(beside, 4.0, 2.0, margin=0.01)
    assert not occupancy.try_add(np.array([[3.2, 0.0, 0.0, np.pi / 2, 0.0, 0.0]]), 4.0, 2.5)


def test_occupancy_takes_the_ground_of_buildings_even_where_they_overlap():
    occupancy = Occupancy(1)
    occupancy.take(np.zeros((1, 6)), 4.0, 2.0)
    occupancy.take(np.array([[3.0, 0.0, 0.0, 0.0, 0.0, 0.0]]), 4.0, 2.0)
    assert not occupancy.try_add(np.array([[4.5, 0.0, 0.0, 0.0, 0.0, 0.0]]), 0.4, 0.4)
    assert occupancy.try_add(np.array([[5.5, 0.0, 0.0, 0.0, 0.0, 0.0]]), 0.4, 0.4)


def test_overlap_of_turned_rectangles_agrees_with_the_separating_axis_test():
    rng = np.random.default_rng(0)
    boxes = rng.uniform([-3, -3, -4, 0.5, 0.5], [3, 3, 4, 5, 3], (2, 400, 5))
    found = rectangles_overlap(boxes[0], boxes[1])
    assert 0.1 < found.mean() < 0.9
    for first, second, overlap in zip(*boxes, found, strict=True):
        outlines = []
        for x, y, yaw, length, width in (first, second):
            along = np.array([np.cos(yaw), np.sin(yaw)]) * length / 2
            aside = np.array([-np.sin(yaw), np.cos(yaw)]) * width / 2
            signs = ((1, 1), (1, -1), (-1, -1), (-1, 1))
            outlines.append(np.array([[x, y] + a * along + b * aside for a, b in signs]))
        assert overlap == (not _separated(*outlines))


@pytest.fixture(scope="module")
def seen_in_frames():
    frames = []
    for seed in range(200):
        _, lots, traffic = _traffic(1000 + seed)
        frames.append(labelled(traffic.actors, lots, traffic.ego.at(0.0)))
    return frames


@pytest.mark.parametrize(
    ("class_name", "tolerance"),
    [("Car", 0.35), ("Van", 0.5), ("Pedestrian", 0.6), ("Cyclist", 0.6)],
)
def test_counts_and_distances_are_near_kittis(seen_in_frames, class_name, tolerance):
    """Tolerances allow for the spread of 200 frames, and for the low recall of a coarse camera."""
    labels_per_frame, mean_distance_m = KITTI_COUNTS[class_name]
    found = [item for frame in seen_in_frames for item in frame if item.class_name == class_name]
    per_frame = len(found) / len(seen_in_frames)
    assert per_frame == pytest.approx(labels_per_frame, rel=tolerance)
    mean = np.mean([item.distance for item in found])
    assert mean == pytest.approx(mean_distance_m, rel=0.25)


def test_near_far_truncated_and_occluded_cars_occur_as_in_kitti(seen_in_frames):
    cars = [item for frame in seen_in_frames for item in frame if item.class_name == "Car"]
    distances = np.array([item.distance for item in cars])
    real = np.array([9.8, 16.4, 26.7, 39.8, 52.6])  # of the 28,742 labelled cars
    quantiles = np.quantile(distances, [0.1, 0.25, 0.5, 0.75, 0.9])
    assert quantiles == pytest.approx(real, rel=0.3)
    truncated = np.mean([item.truncation > 0.02 for item in cars])
    assert truncated == pytest.approx(0.138, abs=0.07)
    hidden = np.mean([item.visible_share < 0.8 for item in cars])
    assert 0.3 < hidden < 0.65


def test_cars_head_the_ways_they_do_in_kitti(seen_in_frames):
    cars = [item for frame in seen_in_frames for item in frame if item.class_name == "Car"]
    headings = np.array([item.heading for item in cars])
    same = np.mean(np.abs(headings) < np.radians(20))
    back = np.mean(np.abs(np.abs(headings) - np.pi) < np.radians(20))
    assert same == pytest.approx(0.39, abs=0.12)
    assert back == pytest.approx(0.34, abs=0.12)
    assert 0.05 < 1 - same - back < 0.45


def test_some_frames_are_empty_and_some_are_crowded(seen_in_frames):
    counts = Counter(sum(item.class_name == "Car" for item in frame) for frame in seen_in_frames)
    assert 0.03 < counts[0] / len(seen_in_frames) < 0.25
    many = sum(number for count, number in counts.items() if count > 8)
    assert 0.03 < many / len(seen_in_frames) < 0.25
