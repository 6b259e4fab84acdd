import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sightline.health.alignment_checks import MIN_SPREADS, AlignmentChecks
from sightline.health.limits import (
    MIN_SCORE,
    SHIPPED,
    CheckRange,
    SensorLimits,
    fit_limits,
    read_limits,
    write_limits,
)
from sightline.structures.health import ALARM_SCORE


def rows(seed, count):
    drawn = np.random.default_rng(seed).gamma(2, 0.5, (count, 2))
    return [AlignmentChecks(*map(float, row), tilted=0.0) for row in drawn]


@pytest.mark.parametrize("seed", range(3))
def test_one_sound_frame_in_a_hundred_is_an_alarm(seed):
    limits = fit_limits(rows(seed, 400), MIN_SPREADS)
    alarms = sum(limits.judge(row).score < ALARM_SCORE for row in rows(seed, 400))
    assert alarms <= 4
    fresh = sum(limits.judge(row).score < ALARM_SCORE for row in rows(seed + 100, 4000))
    assert 4 <= fresh <= 120


@given(values=st.lists(st.floats(-50, 50), min_size=2, max_size=2), step=st.floats(0, 20))
def test_the_score_falls_as_any_check_grows(values, step):
    limits = SensorLimits(
        checks={
            "turned": CheckRange(median=0.0, spread=1.0),
            "mismatched": CheckRange(median=1.0, spread=2.0),
            "tilted": CheckRange(median=0.0, spread=1.0),
        },
        limit=2.0,
    )
    before = limits.judge(AlignmentChecks(*values, tilted=0.0))
    after = limits.judge(AlignmentChecks(values[0], values[1] + step, tilted=0.0))
    assert 0 <= after.score <= before.score <= 1
    excess = max(values[0], (values[1] - 1) / 2, 0.0)
    assert before.score == pytest.approx(max(2 ** -(excess / 2), MIN_SCORE))


def test_what_cannot_be_looked_at_says_nothing_and_nothing_at_all_is_the_worst():
    limits = fit_limits(rows(0, 100), MIN_SPREADS)
    sound = AlignmentChecks(turned=0.0, mismatched=0.0, tilted=0.0)
    assert limits.judge(sound._replace(turned=math.nan)).score == 1
    health = limits.judge(sound._replace(mismatched=math.inf))
    assert (health.score, health.worst_check) == (0.0, "mismatched")


def test_checks_that_never_changed_may_differ_a_little():
    same = [AlignmentChecks(turned=0.0, mismatched=0.0, tilted=0.0)] * 100
    rows = [*same, AlignmentChecks(turned=0.01, mismatched=0.3, tilted=0.0)]
    widest = fit_limits(rows, MIN_SPREADS, transfer=True)
    assert widest.checks["turned"].spread == MIN_SPREADS.turned
    assert 0 < fit_limits(rows, MIN_SPREADS).checks["turned"].spread < MIN_SPREADS.turned


def test_too_few_frames_are_refused():
    with pytest.raises(ValueError, match="at least 100 clean frames, got 99"):
        fit_limits(rows(0, 99), MIN_SPREADS)


def test_checks_that_tell_nothing_of_a_frame_are_left_out_and_such_of_all_frames_refused():
    complete = rows(0, 100)
    some = [row._replace(turned=math.nan) for row in complete[:30]] + complete
    limits = fit_limits(some, MIN_SPREADS)
    assert limits.checks["turned"] == fit_limits(complete, MIN_SPREADS).checks["turned"]
    for value in (math.nan, math.inf):
        with pytest.raises(ValueError, match="check 'turned' has no value"):
            fit_limits([row._replace(turned=value) for row in complete], MIN_SPREADS)


def test_limits_are_read_as_they_were_written(tmp_path):
    limits = read_limits()
    assert limits.provenance["frames"] == 400
    write_limits(tmp_path / "limits.json", limits)
    assert read_limits(tmp_path / "limits.json") == limits


@pytest.mark.parametrize(
    "change",
    [
        lambda content: content.pop("camera"),
        lambda content: content["lidar"]["checks"].pop("rough"),
        lambda content: content["lidar"].update(limit=0),
        lambda content: content["lidar"].update(limit=math.inf),
        lambda content: content["lidar"]["checks"]["rough"].update(spread="much"),
        lambda content: content["lidar"]["checks"]["rough"].update(spread=10**400),
        lambda content: content["lidar"]["checks"].update(new={"median": 0, "spread": 1}),
        lambda content: content.update(camera=[]),
        lambda content: content.update(provenance=3),
        lambda content: content.update(alignment=None),
        lambda content: content["camera"].update(checks=[[1], {}]),
        lambda content: content["camera"].update(checks={"\x1b" * 9999: 1}),
        lambda content: content["lidar"].update(limit={"deep": [[[]]]}),
        lambda content: content["lidar"].update(limit=-(10**400)),
        lambda content: content["lidar"].update(limit=True),
    ],
)
def test_files_that_hold_no_limits_are_refused(tmp_path, change):
    content = json.loads(SHIPPED.read_text())
    change(content)
    path = tmp_path / "limits.json"
    path.write_text(json.dumps(content))
    with pytest.raises(
        ValueError, match=r"limits\.json: holds no limits.*`sightline health-limits`"
    ) as caught:
        read_limits(path)
    assert len(str(caught.value)) < 1_000
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("content", [b"", b"[" * 200_000, b"null", bytes(range(256))])
def test_files_of_something_else_are_refused(tmp_path, content):
    path = tmp_path / "limits.json"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"limits\.json: holds no limits"):
        read_limits(path)
