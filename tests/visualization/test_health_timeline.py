import numpy as np
import pytest

from sightline.structures.health import Alarms, FrameHealth, Health, SampleHealth
from sightline.visualization.health_timeline import draw_health

GOOD, BAD = Health(score=0.9, worst_check="dark"), Health(score=0.1, worst_check="dark")


def frame(number, *, bad=False, camera_cells=(15, 50), name="{:06d}"):
    health = SampleHealth(
        sample_id=name.format(number),
        camera=BAD if bad else GOOD,
        lidar=GOOD,
        alignment=None if bad else GOOD,
        yaw_deg=None if bad else 0.3,
        camera_regions=np.full(camera_cells, bad),
        lidar_regions=np.zeros((14, 72), bool),
        blind_sectors=np.zeros(180, bool),
    )
    return FrameHealth(health=health, alarms=Alarms(camera=bad, lidar=False, alignment=False))


def red_rows(picture):
    pixels = picture[:600].astype(int)  # above the maps
    red = (pixels[..., 0] - pixels[..., 1] > 50) & (pixels[..., 1] < 80)  # the limit is orange
    return np.flatnonzero(red.sum(axis=1) > 200)


def test_alarms_are_red_in_the_chart_of_their_sensor_alone():
    drawn = draw_health([frame(n, bad=n >= 5) for n in range(10)])
    assert red_rows(draw_health([frame(n) for n in range(10)])).size == 0
    rows = red_rows(drawn)
    assert rows.size > 50
    assert rows.max() < 150


def test_one_frame_and_absent_sensors_are_drawn():
    assert draw_health([frame(0)]).shape[1] == 1000
    drawn = draw_health([frame(0), frame(1, bad=True, camera_cells=(1, 1))])
    assert drawn.shape == draw_health([frame(0)]).shape


def test_long_names_do_not_run_into_each_other():
    frames = [frame(n, name="2011_09_26_drive_0052_sync_{:010d}") for n in range(78)]
    short = [frame(n) for n in range(78)]
    assert np.array_equal(draw_health(frames), draw_health(short))
    alone = draw_health([frame(0, name="a_recording_with_a_name_that_is_long_{:04d}")])
    changed = np.flatnonzero((alone != draw_health([frame(0)])).any(axis=(0, 2)))
    assert changed.max() - changed.min() < 150


def test_the_number_of_a_frame_stays_whole_in_a_short_name():
    frames = [frame(n, name="2011_09_26_drive_0052_sync_{:010d}") for n in range(1200, 1278)]
    short = [frame(n) for n in range(1200, 1278)]
    assert np.array_equal(draw_health(frames), draw_health(short))


@pytest.mark.parametrize("name", ["frame-{:04d}_cam", "drive_of_may_{:03d}_cam2"])
def test_a_long_name_is_its_number_without_what_all_names_have(name):
    frames = [frame(n, name=name) for n in range(0, 60, 3)]
    short = [frame(n) for n in range(0, 60, 3)]
    assert np.array_equal(draw_health(frames), draw_health(short))


@pytest.mark.parametrize(("name", "shown"), [("{:04d}_left", "{}_left"), ("00{}.5", "{}.5")])
def test_zero_stays_before_what_is_no_digit(name, shown):
    frames = [frame(n, name=name) for n in (0, 3)]
    assert np.array_equal(draw_health(frames), draw_health([frame(n, name=shown) for n in (0, 3)]))


def test_names_of_which_one_begins_all_others_are_not_shortened_to_nothing():
    frames = [frame(0, name="drive_of_may"), frame(0, name="drive_of_may_2")]
    whole = [frame(0, name="drive_of_may"), frame(0, name="..ive_of_may_2")]
    assert np.array_equal(draw_health(frames[1:]), draw_health(whole[1:]))
    assert not np.array_equal(draw_health(frames), draw_health([frame(0), frames[1]]))


def test_a_drive_without_frames_is_refused():
    with pytest.raises(ValueError, match="at least one frame"):
        draw_health([])


def test_notes_stand_below_in_lines_that_fit():
    plain = draw_health([frame(0)])
    noted = draw_health([frame(0)], ["limits of mine", "a warning that is long " * 20])
    assert noted.shape[1] == plain.shape[1]
    assert np.array_equal(noted[: len(plain)], plain)
    below = noted[len(plain) :]
    assert (below != below[0, 0]).any()
    assert (below[:, -10:] == below[0, 0]).all()
