"""Refusals of runs that do not compare name the difference."""

from dataclasses import replace

import pytest

from sightline.robustness.comparable import check_baseline
from tests.robustness.runs import RMSE, record_of


@pytest.mark.parametrize(
    ("change", "held", "expected"),
    [
        ({"parameters": {"strength": 7}}, "{'strength': 7}", "{'strength': 1}"),
        ({"severity": 4}, "{'severity': 4}", "{'severity': 1}"),
        ({"sensors": ("lidar",)}, "{'sensors': ('lidar',)}", "{'sensors': ('camera',)}"),
    ],
)
def test_another_version_of_a_case_is_refused_by_what_differs(change, held, expected):
    record = record_of(RMSE, 1.0, {"fog": {1: 2.0}})
    other = replace(record.cases["fog-1"], **change)
    baseline = replace(record, cases={**record.cases, "fog-1": other})
    check_baseline(record, record.setting, record.cases)
    with pytest.raises(ValueError, match="another case fog-1") as caught:
        check_baseline(baseline, record.setting, record.cases)
    assert f"of {held} instead of {expected}; run it again" in str(caught.value)


def test_a_run_of_another_list_of_frames_is_refused_in_words():
    record = record_of(RMSE, 1.0, {"fog": {1: 2.0}})
    other = replace(record.setting, frames_sha256="cd")
    with pytest.raises(ValueError, match="toy is of another list of frames, so scores cannot"):
        check_baseline(record, other, record.cases)
