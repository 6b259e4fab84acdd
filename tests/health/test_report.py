import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from rich.console import Console

from sightline.health.alignment_checks import AlignmentChecks
from sightline.health.camera_checks import CameraChecks
from sightline.health.lidar_checks import LidarChecks
from sightline.health.report import CHECK_MEANINGS, HealthReport, doubts, doubts_of_origin
from sightline.structures.health import Alarms, FrameHealth, Health, SampleHealth
from tests.health.frames import sound

SOUND = Health(score=0.9, worst_check="dark")
FRAME = FrameHealth(
    health=SampleHealth(
        sample_id="drive [red] 7",
        camera=SOUND,
        lidar=Health(score=0.1, worst_check="holes"),
        alignment=None,
        yaw_deg=None,
        camera_regions=np.zeros((1, 2), dtype=np.bool_),
        lidar_regions=np.array([[False, True]]),
        blind_sectors=np.array([False, True, True]),
    ),
    alarms=Alarms(camera=False, lidar=True, alignment=False),
)


def printed(*frames):
    console = Console(width=200)
    with console.capture() as captured:
        console.print(HealthReport(frames=frames).table())
    return captured.get()


def test_a_frame_is_a_row_whatever_its_name():
    text = printed(FRAME)
    assert text.startswith("health of sensors, 1 frame ")
    row = next(line.split() for line in text.splitlines() if "drive [red] 7" in line)
    assert row[3:] == ["0.90", "0.10", "-", "-", "holes", "LiDAR"]


@pytest.mark.parametrize("count", [0, 2])
def test_drives_of_any_length_are_printed(count):
    assert f"{count} frames" in printed(*[FRAME] * count)


def test_what_is_written_is_json_that_says_where_sensors_are_bad():
    turned = replace(FRAME.health, alignment=SOUND, yaw_deg=-0.25)
    frames = (FRAME, replace(FRAME, health=turned))
    first, second = json.loads(json.dumps(HealthReport(frames=frames).to_json()))["frames"]
    assert first["lidar"] == {"score": 0.1, "worst_check": "holes"}
    assert first["alignment"] is None
    assert first["lidar_regions"] == {"shape": [1, 2], "bad": [[0, 1]]}
    assert first["blind_sectors"] == [1, 2]
    assert (second["alignment"], second["yaw_deg"]) == (
        {"score": 0.9, "worst_check": "dark"},
        -0.25,
    )


def test_a_sensor_that_most_frames_are_bad_by_makes_its_scores_doubtful():
    def camera(check, score):
        health = replace(FRAME.health, camera=Health(score=score, worst_check=check))
        return replace(FRAME, health=replace(health, lidar=SOUND))

    dirty, sound, gone = camera("muddy", 0.1), camera("muddy", 0.9), camera("absent", 0.0)
    assert "2 of 3 images are bad by 'muddy' (2)" in doubts((dirty, dirty, sound, gone))[0]
    own = doubts((dirty, dirty, sound, gone), are_own_limits=True)[0]
    assert own.endswith("the limits are of other sensors: fit them to clean data of this one by "
                        "sightline health-limits")  # fmt: skip
    for frames in ((dirty, sound), (gone,), (sound,), ()):
        assert doubts(frames) == ()


def test_sparse_depth_maps_in_place_of_sweeps_are_not_judged():
    bad = replace(FRAME.health, lidar=Health(score=0.1, worst_check="faded"))
    bad = replace(bad, camera=Health(score=0.1, worst_check="muddy"))
    frames = (replace(FRAME, health=bad),) * 3
    assert ["images" in each for each in doubts(frames)] == [True, False]
    assert ["images" in each for each in doubts(frames, has_sweeps=False)] == [True]


def test_points_in_a_vehicles_frame_are_told_with_what_is_assumed():
    points = sound().points + torch.tensor([0, 0, 1.71, 0])
    (doubt,) = doubts_of_origin(replace(sound(), points=points, lidar_height_m=0.02))
    assert "000000 have their origin 0.02 m above the road, as in a vehicle's frame" in doubt
    assert "KITTI's height of a LiDAR, 1.73 m" in doubt
    assert doubts_of_origin(sound()) == doubts_of_origin(replace(sound(), lidar_height_m=0.4)) == ()


def test_limits_and_warnings_are_in_the_file():
    report = HealthReport(frames=(FRAME,), limits={"camera": "of mine"}, warnings=("short",))
    content = report.to_json()
    assert (content["limits"], content["warnings"]) == ({"camera": "of mine"}, ["short"])
    assert report.notes == ("camera judged by limits: of mine", "short")


@pytest.mark.parametrize(
    ("size", "num_bad", "is_told"),
    [((1080, 1920), 3, True), ((352, 1216), 3, False), ((1080, 1920), 0, False), (None, 3, False)],
)
def test_bad_images_of_another_size_than_the_fitted_ones_make_the_limits_doubtful(
    size, num_bad, is_told
):
    sound = replace(FRAME.health, lidar=SOUND)
    bad = replace(sound, camera=Health(score=0.3, worst_check="lifted"))
    healths = [bad] * num_bad + [sound] * 7
    frames = [replace(FRAME, health=health) for health in healths]
    told = doubts(frames, size)
    assert bool(told) == is_told
    if is_told:
        assert "3 of 10 images are bad by 'lifted' (3)" in told[0]
        assert "fitted on simulated images of 375x1242" in told[0]
        assert "--fit-first 30" in told[0]


def test_each_check_has_a_meaning_in_few_words():
    fields = [*CameraChecks._fields, *LidarChecks._fields, *AlignmentChecks._fields]
    assert list(CHECK_MEANINGS) == ["absent", *fields]
    assert max(map(len, CHECK_MEANINGS.values())) < 70
