import errno
import json
import multiprocessing
import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from sightline.files.atomic import DiskError, atomic_create_text
from sightline.files.problem import SetupError
from sightline.jobs.output_dirs import (
    MANIFEST_NAME,
    Claim,
    acquire_output_dir,
    claim_folders,
    read_claim,
)
from sightline.jobs.run import LEAVE_OUT, run_job, shard

SETTINGS = {"task": "toy", "seed": 3, "size": (2, 4)}


@dataclass(frozen=True)
class Note:
    """Work item that writes its number, except for 3."""

    folder: Path
    number: int

    def __str__(self):
        return f"note {self.number}"

    def run(self):
        if self.number == 3:
            raise ValueError("is at fault; leave it out")
        (self.folder / f"{self.number}.txt").write_text(str(self.number))


def claim(folder, settings=SETTINGS, results=("*.txt",)):
    acquire_output_dir(folder, settings, results=results)


def claim_at_start(folder, settings, start, errors):
    start.wait()
    try:
        claim(folder, settings)
        errors.put("")
    except ValueError as error:
        errors.put(str(error))


def claims_at_once(folder, settings):
    """Errors of several processes that claim a folder at the same moment; empty: none."""
    context = multiprocessing.get_context("spawn")
    start, errors = context.Barrier(len(settings)), context.Queue()
    jobs = [
        context.Process(target=claim_at_start, args=(folder, each, start, errors))
        for each in settings
    ]
    for job in jobs:
        job.start()
    messages = [errors.get(timeout=60) for _ in jobs]
    for job in jobs:
        job.join()
    return messages


def test_a_claim_stands_in_the_folder_and_is_repeated_by_the_same_job(tmp_path):
    folder = tmp_path / "deep" / "out"
    claim(folder)
    (folder / "0.txt").touch()
    claim(folder)
    assert json.loads((folder / "sightline.json").read_text()) == SETTINGS | {"size": [2, 4]}
    assert sorted(path.name for path in folder.iterdir()) == ["0.txt", "sightline.json"]


def test_of_jobs_that_claim_a_folder_at_once_those_of_one_kind_get_it(tmp_path):
    folder = tmp_path / "out"
    messages = claims_at_once(folder, [{"method": name} for name in ("a", "b", "a", "b")])
    method = json.loads((folder / "sightline.json").read_text())["method"]
    other = {"a": "b", "b": "a"}[method]
    assert messages.count("") == 2
    refused = [message for message in messages if message]
    assert all(f"made with method {method} instead of {other}" in message for message in refused)
    assert [path.name for path in folder.iterdir()] == ["sightline.json"]


@pytest.mark.parametrize(
    ("there", "message"),
    [
        (SETTINGS | {"seed": 4}, "holds files made with seed 4 instead of 3, which would mix"),
        ({"task": "toy", "size": [2, 4]}, "seed none instead of 3"),
        (SETTINGS | {"more": "x" * 999}, r"more x{60}\.\.\. instead of none"),
        (dict(reversed(SETTINGS.items())), "the same settings, written otherwise"),
    ],
)
def test_a_job_of_other_settings_is_refused_by_name(tmp_path, there, message):
    claim(tmp_path, there)
    before = (tmp_path / "sightline.json").read_bytes()
    with pytest.raises(ValueError, match=message):
        claim(tmp_path)
    assert (tmp_path / "sightline.json").read_bytes() == before


def test_numbers_of_numpy_are_settings_like_those_of_python(tmp_path):
    claim(tmp_path, {"seed": np.int64(3), "size": (np.int32(80), 240)})
    claim(tmp_path, {"seed": 3, "size": (80, 240)})
    with pytest.raises(ValueError, match="files made with seed 3 instead of 4"):
        claim(tmp_path, {"seed": np.int64(4), "size": (80, 240)})


def test_long_settings_are_shown_where_they_differ(tmp_path):
    claim(tmp_path, {"rig": "x" * 99 + "1\n" + "y" * 99})
    shown = r"rig \.\.\.x{30}1\\ny{28}\.\.\. instead of \.\.\.x{30}2, which would"
    with pytest.raises(ValueError, match=shown):
        claim(tmp_path, {"rig": "x" * 99 + "2"})


@pytest.mark.parametrize(
    ("there", "message"),
    [
        ({"engine": "openvino"}, r"files made with depth engine openvino instead of torch, which"),
        ({}, "files made with depth engine none instead of torch, which"),
        (None, "files made with depth none instead of method best, weights_sha256 ab"),
    ],
)
def test_differing_nested_settings_are_named(tmp_path, there, message):
    task = {"method": "best", "weights_sha256": "ab" * 32, "engine": "torch"}
    same = {name: task[name] for name in ("method", "weights_sha256")}
    claim(tmp_path, {"depth": None if there is None else same | there})
    with pytest.raises(ValueError, match=message):
        claim(tmp_path, {"depth": task})


@pytest.mark.parametrize("text", ["", "{", "[3]", "[" * 20_000, "\0"])
def test_a_manifest_that_is_none_is_refused(tmp_path, text):
    (tmp_path / "sightline.json").write_text(text)
    with pytest.raises(ValueError, match="holds a damaged manifest, which would mix"):
        claim(tmp_path)


def test_of_several_folders_all_are_claimed_or_none(tmp_path):
    acquire_output_dir(tmp_path / "second", {"by": "another"}, results=())
    claims = [
        Claim(folder=tmp_path / name, settings={"by": "me"}, results=())
        for name in ("first", "second")
    ]
    with pytest.raises(ValueError, match="by another instead of me"):
        claim_folders(claims)
    assert not (tmp_path / "first").exists()
    claim_folders(claims[:1])
    assert (tmp_path / "first" / "sightline.json").is_file()


def test_results_without_a_manifest_are_not_mixed_with(tmp_path):
    (tmp_path / "other.md").touch()
    claim(tmp_path)
    (tmp_path / "sightline.json").unlink()
    (tmp_path / "0.txt").touch()
    with pytest.raises(ValueError, match=r"holds data without a sightline\.json, which would mix"):
        claim(tmp_path)
    assert not (tmp_path / "sightline.json").exists()


@pytest.mark.parametrize("parts", [("training/calib",), ("images", "calibration")])
def test_a_data_set_is_no_output_folder(tmp_path, parts):
    for part in parts:
        (tmp_path / part).mkdir(parents=True)
    with pytest.raises(
        ValueError, match="holds a data set, with which the files of this job would"
    ):
        acquire_output_dir(tmp_path, SETTINGS, results=("*.png",))
    assert not (tmp_path / MANIFEST_NAME).exists()


@pytest.mark.parametrize("part", ["training/velodyne", "rec/points"])
def test_a_part_of_another_data_set_is_no_output_folder(tmp_path, part):
    for each in ("training/calib", "training/velodyne", "rec/points", "rec/calibration"):
        (tmp_path / each).mkdir(parents=True)
    with pytest.raises(
        ValueError, match=f"{part} would be a part of the data set {tmp_path}.*, by"
    ):
        acquire_output_dir(tmp_path / part, SETTINGS, results=("*.png",))
    acquire_output_dir(tmp_path / "rec" / "mine", SETTINGS, results=("*.png",))


@pytest.mark.parametrize("reason", [None, errno.EPERM, errno.EXDEV, errno.EACCES, errno.ENOLCK])
def test_a_file_is_created_once(tmp_path, monkeypatch, reason):
    def refuse(*_):
        raise OSError(reason, "no hard links here")

    if reason is not None:
        monkeypatch.setattr(os, "link", refuse)
    assert atomic_create_text(tmp_path / "a" / "note", "grün\n")
    assert not atomic_create_text(tmp_path / "a" / "note", "blue\n")
    assert (tmp_path / "a" / "note").read_bytes() == "grün\n".encode()
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["note"]


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # forks with threads around
@pytest.mark.parametrize("workers", [1, 2])
def test_a_job_ends_at_the_first_piece_that_fails_by_its_name(tmp_path, workers):
    done = "3 of 6 are done and stay, 3 are left" if workers == 1 else "At least 3 of 6 are done .*"
    message = (
        rf"^note 3: is at fault; leave it out\. {done}: correct this "
        r"one and run the same again, or leave it out by a sample_list of the others$"
    )
    with pytest.raises(ValueError, match=message):
        run_job(
            [Note(tmp_path, number) for number in range(6)],
            workers,
            description="noting",
            leave_out=LEAVE_OUT,
        )
    assert {"0.txt", "1.txt", "2.txt"} <= {path.name for path in tmp_path.iterdir()}


def test_shards_part_the_items_and_a_wrong_one_is_refused():
    shards = [list(shard(range(10), index, 3)) for index in range(3)]
    assert sorted(number for part in shards for number in part) == list(range(10))
    for index, count in ((-1, 2), (2, 2)):
        with pytest.raises(ValueError, match="shard_index must be between 0 and num_shards - 1"):
            shard((), index, count)
    for count in (0, -1):
        with pytest.raises(ValueError, match=f"num_shards must be at least 1, got {count}"):
            shard((), 0, count)


def test_a_job_without_a_worker_is_refused():
    with pytest.raises(ValueError, match="workers must be at least 1, got 0"):
        run_job([], 0, description="nothing")


def test_a_manifest_that_is_a_pipe_is_no_manifest_and_nobody_waits_for_it(tmp_path):
    os.mkfifo(tmp_path / MANIFEST_NAME)
    assert read_claim(tmp_path) is None
    with pytest.raises(ValueError, match="is no regular file"):
        acquire_output_dir(tmp_path, {"task": "a"}, results=("*.txt",))


@pytest.mark.parametrize(
    "forged",
    [
        "",
        "null",
        "[1]",
        "[" * 100_000,
        '{"task": NaN, "seed": Infinity, "size": [[[]]]}',
        '{"task": "\\u001b[31m\\n# forged\\u202e"}',
        json.dumps({"seed": 10**400, "task": "x" * 100_000}),
        json.dumps({f"{number}" * 100: number for number in range(1_000)}),
        json.dumps({"task": {"inner": {"deep": 1}}, "\x1b]0;title\x07" * 100: 1}),
        "\x1b[2J\x00",
    ],
    ids=lambda text: text[:24].encode("unicode_escape").decode(),
)
def test_a_forged_manifest_is_refused_in_one_short_line(tmp_path, capsys, forged):
    from sightline.cli.output import fail

    (tmp_path / MANIFEST_NAME).write_text(forged)
    with pytest.raises(ValueError, match="which would mix with this job; name another") as caught:
        claim(tmp_path)
    assert len(str(caught.value)) < 3_000
    fail(str(caught.value), 2)
    assert capsys.readouterr().err.removesuffix("\n").isprintable()
    content = read_claim(tmp_path)
    assert content is None or isinstance(content, dict)


@pytest.mark.parametrize("kind", ["folder", "large"])
def test_a_manifest_that_cannot_be_read_is_refused_in_one_line(tmp_path, kind):
    path = tmp_path / MANIFEST_NAME
    path.mkdir() if kind == "folder" else path.write_bytes(b" " * (2**22 + 1))
    with pytest.raises(ValueError, match=r"sightline\.json:? is .*; .*name another output folder"):
        claim(tmp_path)
    assert read_claim(tmp_path) is None


@dataclass(frozen=True)
class Failing:
    """A piece whose disk is full, or whose memory runs out."""

    error: BaseException

    def __str__(self) -> str:
        return "note 0"

    def run(self) -> None:
        raise self.error


@pytest.mark.parametrize("status", [None, 0, 3])
def test_a_piece_that_ends_python_fails_the_job(status):
    problem = re.escape(f"note 0: its code ends Python by sys.exit({status!r}), expected an ")
    with pytest.raises(ValueError, match=f"^{problem}exception. 0 of 2 are done and stay, 2 are"):
        run_job([Failing(SystemExit(status))] * 2, 1, description="noting")


def test_a_piece_that_ends_python_after_an_interruption_is_none_that_fails():
    end = SystemExit(130)
    end.__context__ = KeyboardInterrupt()
    with pytest.raises(SystemExit, match="130"):
        run_job([Failing(end)] * 2, 1, description="noting")


@pytest.mark.parametrize(
    "error", [DiskError("a.txt cannot be written"), SetupError("no engine"), MemoryError()]
)
def test_faults_of_the_machine_are_no_faults_of_the_piece(error):
    with pytest.raises(ValueError, match=r"done and stay, 2 are left: then run .*$") as caught:
        run_job([Failing(error)] * 2, 1, description="noting", leave_out=LEAVE_OUT)
    assert "correct this one" not in str(caught.value)
    assert "sample_list" not in str(caught.value)
