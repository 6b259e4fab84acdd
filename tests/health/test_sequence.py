import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sightline.augmentation.faults import NoCamera, TurnedLidar
from sightline.health.sequence import Alarm, DriveMonitor, HysteresisConfig
from sightline.structures.health import Health
from tests.health.frames import sound
from tests.reference import health as reference

RNG = np.random.default_rng(0)


@given(
    scores=st.lists(
        st.sampled_from([None, 0.0, 0.01, 0.2, 0.49, 0.5, 0.54, 0.55, 1.0]), max_size=40
    ),
    raise_after=st.integers(1, 3),
    clear_after=st.integers(1, 4),
    at_once_score=st.sampled_from([0.0, 0.01, 0.5]),
)
def test_alarms_are_raised_and_cleared_as_by_looking_back(
    scores, raise_after, clear_after, at_once_score
):
    config = HysteresisConfig(
        raise_after=raise_after, clear_after=clear_after, at_once_score=at_once_score
    )
    alarm = Alarm(config)
    states = []
    for score in scores:
        alarm.update(None if score is None else Health(score=score, worst_check="dark"))
        states.append(alarm.is_on)
    assert states == reference.alarms(
        scores, raise_after, clear_after, config.clear_score, at_once_score
    )


def test_an_absent_camera_is_an_alarm_at_once_and_until_it_has_been_back_for_a_while():
    monitor = DriveMonitor()
    faulty = NoCamera()(sound(), RNG)
    frames = [sound()] * 2 + [faulty] * 2 + [sound()] * 6
    states = [monitor(frame).alarms.camera for frame in frames]
    assert states == [False] * 2 + [True] * 6 + [False] * 2
    assert not monitor.alarms.lidar


def test_a_turned_lidar_is_an_alarm_of_the_alignment():
    monitor = DriveMonitor()
    turned = TurnedLidar(yaw_deg=1.0)(sound(), RNG)
    states = [monitor(frame) for frame in [sound()] * 3 + [turned] * 8]
    assert not any(state.alarms.alignment for state in states[:3])
    assert states[-1].alarms.alignment
    assert states[-1].health.yaw_deg == pytest.approx(1.0, abs=0.1)
    assert not states[-1].alarms.camera
    assert not states[-1].alarms.lidar


@pytest.mark.parametrize(
    "bad",
    [
        {"raise_after": 0},
        {"clear_after": 0},
        {"clear_score": 0.4},
        {"clear_score": 1.1},
        {"memory": 1.0},
    ],
)
def test_settings_out_of_range_are_refused(bad):
    with pytest.raises(ValueError, match="got"):
        HysteresisConfig(**bad)
