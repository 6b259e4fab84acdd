"""Forged, damaged or removed lines and times."""

import json

import pytest

from sightline.perception.kept_lines import read_lines, read_timings
from sightline.perception.perceive import perceive
from tests.perception.predictors import perceiver
from tests.perception.test_perceive import contents_of, lines_of, results_of


@pytest.fixture
def done(data, out):
    """Results of a finished run."""
    perceive(data, out, perceiver=perceiver())
    return results_of(out)


def forge(path, **changes):
    line = json.loads(path.read_text()) | changes
    path.write_text(json.dumps(line) + "\n")


LACKING = {
    "depth-completion": {"by": "sparse", "lacks": ["points"]},
    "detection2d": {"by": "one-box"},
}


@pytest.mark.parametrize(
    "changes",
    [
        {"tasks": LACKING, "depth": None},
        {"tasks": LACKING, "depth": None, "sensors": {"camera": True, "lidar": False}},
        {"tasks": {"depth-completion": {"by": "other"}, "detection2d": {"by": "one-box"}}},
        {"tasks": {"depth-completion": {"by": "sparse"}}},
        {"sensors": {"camera": 1, "lidar": "yes"}},
        {"image_size_px": [10**400, -1]},
        {"timestamp_s": float("nan")},
        {"num_points": 1e300},
        {"detections2d": [{"class": "Car", "score": None, "box_px": [1, 2, 3, 4]}]},
        {"detections2d": [{"class": "Car", "score": 1.0, "box_px": [1, 2, 3]}]},
        {"detections2d": {}},
        {"depth": [[[[]]]]},
        {"more": "<script>"},
    ],
    ids=str,
)  # fmt: skip
def test_a_forged_line_is_made_anew(data, out, done, changes):
    forge(out / "lines" / "000001.json", **changes)
    again = perceive(data, out, perceiver=perceiver())
    assert (again.written, again.skipped) == (1, 3)
    assert again.predicted == {"depth-completion": 4, "detection2d": 4}
    assert results_of(out) == done


@pytest.mark.parametrize(
    "text", ['{"frame": "\x1b[31m"}', '{"frame":"000001"}', "[" * 10_000, '{"a": 1}\n{"a": 2}', ""]
)
def test_invalid_lines_are_left_out(tmp_path, text):
    folder = tmp_path / "lines"
    folder.mkdir()
    (folder / "000001.json").write_text(text)
    assert read_lines(folder) == read_timings(folder) == {}


@pytest.mark.filterwarnings("ignore:.*there are no .* of 4 frames")
def test_a_frame_is_predicted_again_once_its_sensor_has_data(data, out):
    sweep = data / "training" / "velodyne" / "000002.bin"
    content = sweep.read_bytes()
    sweep.unlink()
    first = perceive(data, out, perceiver=perceiver())
    assert first.predicted == {"depth-completion": 3, "detection2d": 4}
    assert perceive(data, out, perceiver=perceiver()).written == 0
    sweep.write_bytes(content)
    again = perceive(data, out, perceiver=perceiver())
    assert (again.written, again.predicted["depth-completion"]) == (1, 4)
    assert "lacks" not in str(lines_of(out)["000002"])


@pytest.mark.parametrize(
    "forged",
    [
        None,
        "",
        '{"frame": "000001"}\n',
        '{"frame": "000001", "milliseconds": {"detection2d": "\\u001b[31m"}}\n',
        '{"frame": "000001", "milliseconds": {"detection2d": NaN}}\n',
        '{"frame": "000002", "milliseconds": {}}\n',
        '{"frame": "000001", "milliseconds": {}}\n{"frame": "x", "milliseconds": {}}\n',
    ],
)
def test_times_that_are_lost_or_forged_are_left_out_with_a_warning(data, out, done, forged):
    path = out / "timings" / "000001.json"
    path.unlink() if forged is None else path.write_text(forged)
    with pytest.warns(UserWarning, match=r"timings\.jsonl lacks the time of 1 of 4 frames, 000001"):
        perceive(data, out, perceiver=perceiver())
    times = [json.loads(each) for each in (out / "timings.jsonl").read_text().splitlines()]
    assert [each["frame"] for each in times] == ["000000", "000002", "000003"]
    assert results_of(out) == done


@pytest.mark.usefixtures("done")
def test_damaged_lines_of_frames_outside_the_list_cause_a_warning(data, out):
    (out / "lines" / "000001.json").write_text("{}")
    with pytest.warns(UserWarning, match=r"perception\.jsonl lacks the line of 1 of 4 .*000001"):
        perceive(data, out, perceiver=perceiver(), sample_list=["000000"])
    assert list(lines_of(out)) == ["000000", "000002", "000003"]
    assert "000001.json" in contents_of(out / "lines")
