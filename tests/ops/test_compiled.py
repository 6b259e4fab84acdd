import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import sightline
from sightline.ops import compiled as subject

_KERNEL = """
import numpy as np
from sightline.ops.compiled import compiled

@compiled
def add(a, b):
    return a + b
"""


def load(folder):
    """A module of its own with a kernel."""
    folder.mkdir(exist_ok=True)
    path = folder / "kernels.py"
    path.write_text(_KERNEL)
    spec = importlib.util.spec_from_file_location("kernels", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def kept(folder):
    return sorted(path.suffix for path in folder.rglob("*.nb?"))


def forbid(monkeypatch, folder):
    """Make a folder read-only, for root as well."""
    allowed = os.access
    monkeypatch.setattr(
        subject.os, "access", lambda path, mode: Path(path) != folder and allowed(path, mode)
    )


def test_kernels_are_kept_beside_their_source(tmp_path):
    assert load(tmp_path / "package").add(2, 3) == 5
    assert kept(tmp_path / "package" / "__pycache__") == [".nbc", ".nbi"]


def test_kernels_of_a_package_that_is_read_only_are_kept_in_the_users_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "package" / "__pycache__").mkdir(parents=True)
    forbid(monkeypatch, tmp_path / "package" / "__pycache__")
    before = subject._numba_settings.CACHE_DIR
    assert load(tmp_path / "package").add(2, 3) == 5
    assert kept(tmp_path / "cache" / "sightline" / "kernels") == [".nbc", ".nbi"]
    assert kept(tmp_path / "package") == []
    assert before == subject._numba_settings.CACHE_DIR


def test_where_no_place_can_be_written_to_kernels_run_without_being_kept(tmp_path, monkeypatch):
    (tmp_path / "package" / "__pycache__").mkdir(parents=True)
    forbid(monkeypatch, tmp_path / "package" / "__pycache__")
    monkeypatch.setattr(subject, "cache_folder", lambda: None)
    assert load(tmp_path / "package").add(2, 3) == 5
    assert kept(tmp_path) == []


@pytest.mark.parametrize("ending", [".nbi", ".nbc"])
def test_a_kept_kernel_that_is_damaged_is_compiled_anew(tmp_path, ending):
    assert load(tmp_path / "package").add(2, 3) == 5
    (path,) = (tmp_path / "package").rglob(f"*{ending}")
    path.write_bytes(path.read_bytes()[:100])
    assert load(tmp_path / "package").add(2, 3) == 5


def test_a_full_disk_does_not_stop_a_kernel(tmp_path, monkeypatch):
    module = load(tmp_path / "package")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module.add._cache._cache_file, "save", full)
    assert module.add(2, 3) == 5


def test_a_user_without_a_home_runs_a_package_that_is_read_only(tmp_path):
    source = Path(sightline.__file__).parents[1]
    mounting = ["unshare", "--mount", "sh", "-c",
                f"mount --bind {source} {source} && mount -o remount,bind,ro {source} && \"$@\"",
                "sh"]  # fmt: skip
    if not shutil.which("unshare") or subprocess.run([*mounting, "true"], check=False).returncode:
        pytest.skip("a read-only mount needs root")
    script = (
        "import torch\n"
        "from sightline.ops.nms import nms2d\n"
        "print(nms2d(torch.tensor([[0.0, 0, 2, 2]]), torch.tensor([1.0]), 0.5).tolist())"
    )
    environment = {"PATH": os.environ["PATH"], "PYTHONPATH": str(source), "HOME": "/proc/none",
                   "TMPDIR": str(tmp_path)}  # fmt: skip
    done = subprocess.run(
        [*mounting, sys.executable, "-c", script], env=environment, cwd=tmp_path,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.stdout, done.stderr, done.returncode) == ("[0]\n", "", 0)
    assert ".nbc" in kept(tmp_path / f"sightline-{os.getuid()}")
