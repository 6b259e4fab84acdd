import pytest

from sightline.app.state import FAST, MAX_FAULTS, Breakage, FaultChoice, parse_state

FRAMES = ("000000", "000001")


def test_a_link_without_anything_is_the_first_frame_with_fast_weights_and_sound_sensors():
    state = parse_state("", FRAMES)
    assert state.broken == Breakage("000000", (), 0.0)
    assert dict(state.weights) == FAST
    assert state.to_query() == "frame=000000"


def test_a_state_is_the_same_after_its_link():
    query = (
        "frame=000001&fault=camera_fog.3.0&fault=lidar_beams.4.12&yaw=-2.5"
        "&detection2d=detection2d-best&depth-completion=adaptive&detection3d=none"
    )
    state = parse_state(query, FRAMES)
    assert state.broken.faults == (
        FaultChoice("camera_fog", 3, 0),
        FaultChoice("lidar_beams", 4, 12),
    )
    assert state.broken.yaw_deg == -2.5
    assert state.weights_for("depth-completion") == "adaptive"
    assert parse_state(state.to_query(), FRAMES) == state


def test_what_concerns_the_page_alone_is_ignored():
    assert parse_state("score=0.7&theme=light&selected=c3", FRAMES) == parse_state("", FRAMES)


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("frame=../../etc/passwd", "the data has no frame '../../etc/passwd'; choose one of"),
        (
            "fault=lidar_fgo.3.0",
            "no kind of corruption 'lidar_fgo'; perhaps lidar_fov or lidar_fog",
        ),
        ("fault=lidar_fog.6.0", "severities from 1 to 5, got 6"),
        ("fault=lidar_fog.3", "expected KIND.SEVERITY.SEED"),
        ("fault=lidar_fog.3.-1", "expected KIND.SEVERITY.SEED"),
        ("fault=lidar_fog.3.10000", "seed must be from 0 to 9999, got 10000"),
        ("fault=lidar_fog.3.0&fault=lidar_fog.4.0", "chosen twice"),
        ("yaw=nan", "yaw 'nan' is no number"),
        ("yaw=31", "from -30 to 30 degrees, got 31"),
        ("detection2d=/etc/passwd", "detection2d has no weights '/etc/passwd'"),
        ("yaw=" + "1" * 5000, "at most 4000"),
    ],
)
def test_a_link_that_cannot_be_shown_is_refused_in_one_line(query, message):
    with pytest.raises(ValueError, match=message) as refused:
        parse_state(query, FRAMES)
    assert "\n" not in str(refused.value)


def test_no_more_faults_at_once_than_the_page_offers():
    kinds = ("camera_fog", "camera_rain", "camera_snow", "lidar_fog", "lidar_rain", "lidar_snow")
    query = "&".join(f"fault={kind}.1.0" for kind in kinds)
    assert len(parse_state(query, FRAMES).broken.faults) == MAX_FAULTS
    with pytest.raises(ValueError, match="7 faults at once, at most 6"):
        parse_state(f"{query}&fault=sun_glare.1.0", FRAMES)
