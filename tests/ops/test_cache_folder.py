import tempfile
from pathlib import Path

import pytest

from sightline.ops import cache_folder as subject
from sightline.ops.cache_folder import cache_folder


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """No cache and no home of the user: only a folder for temporary files."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", homeless)
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(folder))
    monkeypatch.setattr(subject.os, "getuid", lambda: tmp_path.stat().st_uid)
    return folder


def homeless():
    raise RuntimeError("Could not determine home directory.")


def test_the_users_cache_is_taken_before_the_home(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert cache_folder() == tmp_path / "cache" / "sightline"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "sightline"


def test_without_a_home_it_is_a_folder_for_temporary_files_that_is_closed_to_others(temporary):
    folder = cache_folder()
    assert folder is not None
    assert folder.parent == temporary
    assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("home", ["", "~", "here"])
def test_a_home_that_is_no_absolute_path_makes_no_folder_here(temporary, monkeypatch, home):
    monkeypatch.chdir(temporary)
    monkeypatch.setattr(Path, "home", lambda: Path(home))
    monkeypatch.setenv("XDG_CACHE_HOME", home)
    assert cache_folder().parent == temporary
    assert [each.name for each in temporary.iterdir()] == [cache_folder().name]


@pytest.mark.parametrize("trap", ["link", "open to all", "file", "another user's"])
def test_a_place_that_somebody_else_may_have_prepared_is_not_taken(temporary, monkeypatch, trap):
    place = cache_folder()
    if trap == "another user's":
        uid = place.stat().st_uid
        place.rename(place.with_name(f"sightline-{uid + 1}"))
        monkeypatch.setattr(subject.os, "getuid", lambda: uid + 1)
    elif trap == "open to all":
        place.chmod(0o777)
    else:
        place.rmdir()
        place.symlink_to(temporary) if trap == "link" else place.write_text("")
    assert cache_folder() is None


@pytest.mark.usefixtures("temporary")
def test_without_any_folder_there_is_none(monkeypatch):
    def none():
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr(tempfile, "gettempdir", none)
    assert cache_folder() is None
