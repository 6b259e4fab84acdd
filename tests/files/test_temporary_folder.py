import subprocess
import sys
from pathlib import Path
from tempfile import mkdtemp

from sightline.files.atomic import atomic_write_text, scratch_folder
from sightline.files.temporary_folder import _remove_leftovers, temporary_folder
from tests.files.test_atomic import names

_HANG = """
import sys, time
from pathlib import Path
from sightline.files.atomic import atomic_path
with atomic_path(Path(sys.argv[1])) as temporary:
    temporary.write_text("half")
    print("ready", flush=True)
    time.sleep(600)
"""

_CONVERSION = """
import time
from sightline.files.atomic import scratch_folder
with scratch_folder() as folder:
    (folder / "model.onnx").write_text("half")
    print("ready", flush=True)
    time.sleep(600)
"""


def test_what_a_killed_process_left_goes_and_what_a_living_one_writes_stays(tmp_path):
    command = [sys.executable, "-c", _HANG, str(tmp_path / "other.txt")]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as writer:
        assert writer.stdout.readline() == b"ready\n"
        (tmp_path / ".sightline-a1_old23").mkdir()
        (tmp_path / ".sightline-a1_old23" / "0.png").write_text("half")
        (tmp_path / ".sightline-backups-of-mine").mkdir()
        (tmp_path / ".sightline-note").write_text("a file of somebody's")
        (tmp_path / "elsewhere").mkdir()
        (tmp_path / ".sightline-link").symlink_to(tmp_path / "elsewhere")
        (alive,) = tmp_path.glob(".sightline-*/other.txt")
        atomic_write_text(tmp_path / "0.txt", "whole")
        assert names(tmp_path) == sorted(
            [
                ".sightline-backups-of-mine",
                ".sightline-link",
                ".sightline-note",
                alive.parent.name,
                "0.txt",
                "elsewhere",
            ]
        )
        writer.kill()
    _remove_leftovers.cache_clear()
    atomic_write_text(tmp_path / "1.txt", "whole")
    assert not alive.parent.exists()


def test_intermediate_files_of_a_killed_process_go_with_the_next_that_needs_some(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    (tmp_path / "sightline-runs").mkdir()  # somebody's, whatever its name
    with subprocess.Popen([sys.executable, "-c", _CONVERSION], stdout=subprocess.PIPE) as worker:
        assert worker.stdout.readline() == b"ready\n"
        (left,) = tmp_path.glob(".sightline-*")
        with scratch_folder():
            assert left.exists()
        worker.kill()
    _remove_leftovers.cache_clear()
    with scratch_folder() as folder:
        assert names(tmp_path) == sorted([folder.name, "sightline-runs"])
    assert names(tmp_path) == ["sightline-runs"]


def test_a_folder_that_another_process_has_locked_to_remove_it_is_left_to_it(tmp_path, monkeypatch):
    locked = iter([False, True])
    monkeypatch.setattr("sightline.files.temporary_folder._try_lock", lambda _: next(locked))
    with temporary_folder(tmp_path / "0.txt") as folder:
        others = [path for path in tmp_path.iterdir() if path != folder]
        assert len(others) == 1


def test_a_folder_taken_for_a_leftover_before_it_was_locked_is_made_again(tmp_path, monkeypatch):
    made = []

    def make(**arguments: object) -> str:
        path = mkdtemp(**arguments)
        made.append(path)
        if len(made) == 1:
            Path(path).rmdir()
        return path

    monkeypatch.setattr("tempfile.mkdtemp", make)
    atomic_write_text(tmp_path / "0.txt", "whole")
    assert len(made) == 2
    assert names(tmp_path) == ["0.txt"]
