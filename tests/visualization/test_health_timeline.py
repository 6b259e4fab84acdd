import numpy as np

from sightline.structures.health import Alarms, FrameHealth, Health, SampleHealth
from sightline.visualization.health_timeline import draw_health

GOOD, BAD = Health(score=0.9, worst_check="dark"), Health(score=0.1, worst_check="dark")


def frame(number, *, bad=False, camera_cells=(15, 50)):
    health = SampleHealth(
        sample_id=f"{number:06d}",
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
