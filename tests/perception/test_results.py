import json

import pytest

from sightline.jobs.output_dirs import MANIFEST_NAME
from sightline.perception.results import open_results

RESULTS = {"task": "detection2d", "output": "boxes", "method": "a", "data": "b"}


@pytest.mark.parametrize(
    ("claim", "message"),
    [
        ({"job": "perceive", "folders": ["", ""]}, "is empty"),
        ({"job": "perceive", "folders": [".."]}, "begins with a dot"),
        ({"job": "perceive", "folders": ["a/../.."]}, "separator"),
        ({"job": "perceive", "folders": [3]}, "is no text"),
        ({"task": []}, "no results that can be drawn"),
        ({"task": {}, "output": 1}, "no results that can be drawn"),
    ],
)
def test_a_forged_manifest_is_refused_in_one_line(tmp_path, claim, message):
    (tmp_path / MANIFEST_NAME).write_text(json.dumps(claim))
    with pytest.raises(ValueError, match=message) as refused:
        open_results([tmp_path])
    assert "\n" not in str(refused.value)


def test_folders_that_hold_several_tasks_are_not_looked_into_any_deeper(tmp_path):
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / MANIFEST_NAME).write_text(json.dumps({"job": "perceive", "folders": ["inner"]}))
    (inner / MANIFEST_NAME).write_text(json.dumps({"job": "perceive", "folders": ["inner"]}))
    with pytest.raises(ValueError, match="no results that can be drawn"):
        open_results([tmp_path])


def test_a_listed_folder_that_is_gone_is_named_and_the_others_are_drawn(tmp_path):
    folders = ["detection2d", "detection3d", "depth-completion"]
    (tmp_path / MANIFEST_NAME).write_text(json.dumps({"job": "perceive", "folders": folders}))
    for name in folders[:2]:
        (tmp_path / name).mkdir()
    written = {"task": "detection2d", "output": "results", "method": "a", "data": "b"}
    (tmp_path / "detection2d" / MANIFEST_NAME).write_text(json.dumps(written))
    with pytest.warns(UserWarning, match="lists detection3d, depth-completion, without a readable"):
        assert [each.made_by for each in open_results([tmp_path])] == ["a"]


def test_a_manifest_that_is_cut_short_is_named(tmp_path):
    (tmp_path / MANIFEST_NAME).write_text('{"job": "perc')
    with pytest.raises(ValueError, match=r"sightline\.json: is damaged"):
        open_results([tmp_path])
