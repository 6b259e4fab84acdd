"""Benchmark of growth: records that are replaced by command, and what is computed from them."""

import json
from itertools import count

from benchmarks import growth, table_scale
from benchmarks.job_figures import Figures


def row(work, **figures):
    start = {"start_processor_s": 5.0, "mib": 900, "open_files": 5, "bytes": 50_000}
    return {"work": work, "frames": 20, "processor_ms": 500.0, **start, **figures}


def test_rows_that_are_measured_anew_replace_the_earlier_ones(tmp_path):
    into = tmp_path / "growth.json"
    growth.merge([row("shard"), row("corrupt")], into, seed=0)
    growth.merge([row("shard", frames=7)], into, seed=1)
    first, second = json.loads(into.read_text())
    assert (first["results"], first["seed"]) == ([row("corrupt")], 0)
    assert (second["results"], second["seed"]) == ([row("shard", frames=7)], 1)
    growth.merge([row("corrupt", mib=1)], into, seed=2)
    assert [record["seed"] for record in json.loads(into.read_text())] == [1, 2]
    growth.merge([row("predict")], into, seed=2)
    _, both = json.loads(into.read_text())
    assert both["results"] == [row("corrupt", mib=1), row("predict")]
    assert both["command"].endswith("--works [corrupt,predict]")


def test_a_frame_costs_the_difference_between_two_moments(capsys):
    seconds = count(1.0)
    noted = [
        Figures(frames, 2 * next(seconds), processor_s, 0.0, 10.4, 5, num_bytes)
        for frames, processor_s, num_bytes in ((1, 3.0, 10), (101, 4.0, 2010), (301, 8.0, 8010))
    ]
    first, second = growth.rows("shard", noted)
    assert (first["frames"], first["processor_ms"], first["bytes"]) == (101, 10.0, 20)
    assert (second["frames"], second["processor_ms"], second["bytes"]) == (301, 20.0, 30)
    assert first["start_processor_s"] == second["start_processor_s"] == 3.0
    assert capsys.readouterr().out.count("\n") == 2


def test_ten_million_frames_need_what_the_figures_of_one_say():
    record = {"results": [row("perceive"), row("perceive-full-size", frame_bytes=2_000_000)]}
    needs = dict(table_scale.ten_million(record)[1:])
    assert needs["processor time of all"] == "1,389 hours of a core"
    assert needs["machines of 16 cores for 24 hours"] == "3.6"
    assert needs["frames in shards"] == "20.0 TB"
    assert needs["results in shards"] == "0.50 TB"
    assert needs["read by all cores"] == "0.23 GB/s"
    assert needs["bottleneck, beside storage of 1.25 GB/s"] == "processors"
    assert needs["lost with a killed worker, on average"] == "255 s of a core: half a shard"
