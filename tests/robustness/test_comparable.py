"""Refusals of runs that do not compare name the difference."""

from dataclasses import replace

import pytest

from sightline.robustness.comparable import check_baseline, check_healthy, notes_on_files
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


def test_a_run_of_the_same_files_under_another_name_is_compared_with_a_note():
    here = record_of(RMSE, 1.0, {"fog": {1: 2.0}}, files_digest="ab12")
    there = record_of(RMSE, 1.5, {"fog": {1: 2.0}}, files_digest="ab12", data="m/copy")
    check_baseline(there, here.setting, here.cases)
    check_healthy("camera", there, here.setting)
    (note,) = notes_on_files({"this run": here, "the baseline": there})
    assert note.startswith(
        "WARNING: the baseline is of data m/copy, this run of kitti/toy: they are taken"
    )
    for digest in (None, "cd34"):
        other = record_of(RMSE, 1.5, {"fog": {1: 2.0}}, files_digest=digest, data="m/copy")
        for one, two in ((here, other), (other, here)):
            with pytest.raises(ValueError, match=r"is of data .* instead of .*, so scores cannot"):
                check_baseline(two, one.setting, one.cases)
    unknown = record_of(RMSE, 1.0, {"fog": {1: 2.0}}, data="m/copy")
    with pytest.raises(ValueError, match="is of data"):
        check_baseline(unknown, record_of(RMSE, 1.0, {}).setting, unknown.cases)
    names = replace(here.setting, frames_sha256="cd")
    with pytest.raises(ValueError, match="another list of frames"):
        check_baseline(there, names, here.cases)
