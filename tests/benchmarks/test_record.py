"""Record of a benchmark run: command and versions, without the machine's folders."""

import hashlib
import json
import sys

import pytest

from benchmarks.record import command, print_record


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (
            ["/me/yaw_error.py", "/data/kitti/"],
            "python -m benchmarks.yaw_error kitti",
        ),
        (["valid_depth.py", "--data=/data/kitti"], "python -m benchmarks.valid_depth --data=kitti"),
        (["a.py", "[x/y.safetensors,/z/w]"], "python -m benchmarks.a [y.safetensors,w]"),
        (["a.py", "--repeats", "7"], "python -m benchmarks.a --repeats 7"),
    ],
)
def test_a_command_names_the_benchmark_and_no_folder(arguments, expected):
    assert command(arguments) == expected


def test_a_record_holds_command_commit_date_seed_weights_and_machine(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "argv", ["/somewhere/toy.py", str(tmp_path)])
    file = tmp_path / "own.safetensors"
    file.write_bytes(b"weights")
    print_record({"results": [1]}, seed=3, weights=[file, "depth-best"])
    record = json.loads(capsys.readouterr().out)
    assert record["command"] == f"python -m benchmarks.toy {tmp_path.name}"
    assert {"commit", "dirty", "date", "machine"} <= record.keys()
    assert record["seed"] == 3
    assert record["results"] == [1]
    assert record["weights"]["own"] == hashlib.sha256(b"weights").hexdigest()
    assert len(record["weights"]["depth-best"]) == 64
    assert str(tmp_path.parent) not in json.dumps(record)
