import errno
import io
import os
import tempfile
from pathlib import Path

import pytest

from sightline.files.atomic import (
    DiskError,
    atomic_create_text,
    atomic_link,
    atomic_path,
    atomic_write_bytes,
    atomic_write_text,
    scratch_folder,
)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_file_appears_under_its_name_only_when_the_block_ends(tmp_path):
    target = tmp_path / "scores.json"
    with atomic_path(target) as temporary:
        temporary.write_text("half")
        assert not target.exists()
        assert temporary.parent.parent == tmp_path  # the same file system, so renaming is atomic
        temporary.write_text("whole")
    assert target.read_text() == "whole"
    assert names(tmp_path) == ["scores.json"]


def test_the_content_is_on_the_disk_before_the_file_has_its_name(tmp_path, monkeypatch):
    target, flushed = tmp_path / "scores.json", []

    def flush(file):
        assert not target.exists()
        flushed.append(os.fstat(file).st_size)

    monkeypatch.setattr(os, "fsync", flush)
    atomic_write_text(target, "whole")
    target.rename(tmp_path / "other.json")
    assert atomic_create_text(target, "claim..")
    assert flushed == [5, 7]
    monkeypatch.setattr(os, "fsync", lambda _: Path("none").stat())  # nothing can be flushed
    atomic_write_text(target, "other")
    assert target.read_text() == "other"


def test_the_temporary_file_has_the_same_name_so_that_suffixes_keep_their_meaning(tmp_path):
    with atomic_path(tmp_path / "view.png") as temporary:
        assert temporary.name == "view.png"
        temporary.touch()


@pytest.mark.parametrize("failure", [ValueError, KeyboardInterrupt, SystemExit, GeneratorExit])
def test_any_exception_leaves_the_old_file_and_nothing_else(tmp_path, failure):
    target = tmp_path / "scores.json"
    target.write_text("old")

    def write() -> None:
        with atomic_path(target) as temporary:
            temporary.write_text("new")
            (temporary.parent / "scratch").write_text("by the library that writes")
            raise failure

    with pytest.raises(failure):
        write()
    assert target.read_text() == "old"
    assert names(tmp_path) == ["scores.json"]


def test_a_hidden_folder_left_by_a_killed_process_is_in_no_listing_of_its_suffix(tmp_path):
    with atomic_path(tmp_path / "0.png") as temporary:
        temporary.touch()
        assert list(tmp_path.glob("*.png")) == []


def test_missing_parent_folders_are_made(tmp_path):
    atomic_write_text(tmp_path / "a" / "b" / "note.txt", "grün\n")
    assert (tmp_path / "a" / "b" / "note.txt").read_bytes() == "grün\n".encode()


def test_files_get_the_permissions_that_the_user_chose_for_new_files(tmp_path):
    atomic_write_bytes(tmp_path / "new", b"")
    (tmp_path / "plain").touch()
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize("is_there", [True, False])
def test_a_symbolic_link_is_replaced_and_nothing_is_written_where_it_leads(tmp_path, is_there):
    (tmp_path / "store").mkdir()
    if is_there:
        (tmp_path / "store" / "real.txt").write_text("mine")
    (tmp_path / "link.txt").symlink_to(tmp_path / "store" / "real.txt")
    atomic_write_text(tmp_path / "link.txt", "content")
    assert not (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "link.txt").read_text() == "content"
    assert [each.read_text() for each in (tmp_path / "store").iterdir()] == ["mine"] * is_there


def test_a_folder_that_is_a_link_is_followed(tmp_path):
    (tmp_path / "store").mkdir()
    (tmp_path / "folder").symlink_to(tmp_path / "store")
    atomic_write_text(tmp_path / "folder" / "a.txt", "content")
    assert (tmp_path / "store" / "a.txt").read_text() == "content"


def test_links_of_the_system_to_streams_stay():
    for path in ("/dev/stdout", "/proc/self/fd/0"):
        with pytest.raises(ValueError, match="is no regular file; choose another name"):
            atomic_write_text(path, "content")


def test_a_file_in_place_of_the_output_folder_is_named_with_the_remedy(tmp_path):
    (tmp_path / "out").touch()
    with pytest.raises(ValueError, match=r"folder .*out: .*; make it writable or choose another"):
        atomic_write_text(tmp_path / "out" / "0.txt", "")


@pytest.mark.skipif(os.geteuid() == 0, reason="the super-user may write everywhere")
def test_an_unwritable_folder_is_named_with_the_remedy(tmp_path):
    (tmp_path / "out").mkdir(mode=0o555)
    with pytest.raises(ValueError, match=r"folder .*out: permission denied; make it writable"):
        atomic_write_text(tmp_path / "out" / "0.txt", "")


def test_a_folder_that_refuses_is_named_with_the_remedy(tmp_path, monkeypatch):
    def refuse(**_: object) -> str:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    with pytest.raises(ValueError, match="permission denied; make it writable or choose") as caught:
        atomic_write_text(tmp_path / "0.txt", "")
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_or_a_device_is_no_place_for_a_file(tmp_path):
    for place in (tmp_path, Path("/dev/null")):
        with pytest.raises(ValueError, match="no regular file; choose another name"):
            atomic_write_text(place, "")


def test_a_full_disk_is_told_with_the_file(tmp_path):
    def write() -> None:
        with atomic_path(tmp_path / "0.png") as temporary:
            temporary.touch()
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(
        ValueError, match=r"0\.png cannot be written: no space left on device; make"
    ):
        write()
    assert names(tmp_path) == []


def test_a_full_disk_is_told_with_the_final_place_of_a_file_within_another(tmp_path):
    with (
        pytest.raises(ValueError, match=f"^{tmp_path}/0.png cannot be written: no space left"),
        atomic_path(tmp_path / "0.png") as outer,
        atomic_path(outer),
    ):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert names(tmp_path) == []


class FullDisk(io.FileIO):
    def write(self, content):
        super().write(content[:2])
        raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("full", ["wb", "xb"])  # aside; in place, where there are no hard links
def test_a_file_that_is_created_on_a_full_disk_leaves_no_part(tmp_path, monkeypatch, full):
    def refuse(*_):
        raise OSError(errno.EPERM, "no hard links here")

    def open_full(path, mode):
        return FullDisk(path, mode) if mode == full else io.FileIO(path, mode)

    monkeypatch.setattr(os, "link", refuse)
    monkeypatch.setattr(Path, "open", open_full)
    with pytest.raises(ValueError, match=r"note cannot be written: no space left on device; make"):
        atomic_create_text(tmp_path / "note", "text")
    assert names(tmp_path) == []


def test_errors_of_other_files_in_the_block_stay_what_they_are(tmp_path):
    with pytest.raises(FileNotFoundError), atomic_path(tmp_path / "0.png"):
        (tmp_path / "absent").read_bytes()


def test_a_linked_file_is_the_same_file_until_one_of_its_names_is_written_anew(tmp_path):
    source, name = tmp_path / "a/source", tmp_path / "b/name"
    atomic_write_text(source, "whole")
    for _ in range(2):  # a link to itself stays one
        atomic_link(name, source)
        assert name.samefile(source)
    atomic_write_text(name, "another")
    assert source.read_text() == "whole"
    atomic_link(name, source)
    assert name.read_text() == "whole"
    assert names(tmp_path / "b") == ["name"]


def test_of_a_symbolic_link_what_it_leads_to_is_linked(tmp_path):
    (tmp_path / "source").write_text("whole")
    (tmp_path / "symbol").symlink_to("source")
    atomic_link(tmp_path / "deep/name", tmp_path / "symbol")
    assert (tmp_path / "deep/name").samefile(tmp_path / "source")
    assert not (tmp_path / "deep/name").is_symlink()


@pytest.mark.parametrize("reason", [errno.EXDEV, errno.EPERM, errno.EACCES])
def test_where_no_link_can_be_made_a_whole_copy_is(tmp_path, monkeypatch, reason):
    def refuse(*_):
        raise OSError(reason, "no hard links here")

    monkeypatch.setattr(os, "link", refuse)
    (tmp_path / "source").write_bytes(b"whole")
    atomic_link(tmp_path / "name", tmp_path / "source")
    assert (tmp_path / "name").read_bytes() == b"whole"
    assert not (tmp_path / "name").samefile(tmp_path / "source")


def test_a_file_that_is_not_there_cannot_be_linked(tmp_path):
    with pytest.raises(FileNotFoundError):
        atomic_link(tmp_path / "name", tmp_path / "source")
    assert names(tmp_path) == []


def test_a_full_temporary_folder_is_named_with_its_remedy_and_left_empty(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(DiskError) as caught, scratch_folder():
        raise OSError(errno.ENOSPC, "No space left on device")
    assert str(caught.value) == (
        f"temporary folder {tmp_path} is unusable: no space left on device; make room, or name "
        "another temporary folder by the variable TMPDIR"
    )
    assert names(tmp_path) == []
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with pytest.raises(DiskError, match="no temporary folder can be made: no such file"):
        scratch_folder().__enter__()


def test_other_errors_in_a_temporary_folder_pass_unchanged():
    with pytest.raises(FileNotFoundError), scratch_folder() as folder:
        (folder / "missing").read_bytes()
