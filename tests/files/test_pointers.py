"""Pointers of Git LFS and git-annex in the place of files of any kind."""

import pytest

from sightline.cli.main import main
from sightline.data.check import check_tree
from sightline.data.importing.import_recording import import_recording
from sightline.files.plain_text import read_text
from sightline.files.problem import FileError
from tests.data.recordings import write_nuscenes, write_recording
from tests.inference.trees import write_object_tree

LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a214614ab\nsize 12\n"
ANNEX = b"/annex/objects/MD5E-s12--4d7a214614ab.bin\n"
NAMED = "is a pointer of Git LFS, not the file itself; fetch it: git lfs pull"


@pytest.mark.parametrize(
    "name",
    ["calib/000000.txt", "image_2/000000.png", "velodyne/000000.bin", "label_2/000000.txt"],
)
def test_a_pointer_among_a_trees_files_is_named(tmp_path, name):
    write_object_tree(tmp_path, 2)
    path = tmp_path / "training" / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(LFS)
    assert any(f"{path}: {NAMED}" in str(each) for each in check_tree(tmp_path))


@pytest.mark.parametrize("suffix", [".npy", ".pcd", ".ply"])
def test_a_pointer_in_the_place_of_a_cloud_is_named(tmp_path, suffix):
    recording = write_recording(tmp_path / "rec", ("a", "b"), cloud=".npy", picture=".png")
    cloud = next(recording.rglob("a.npy"))
    cloud.unlink()
    cloud.with_suffix(suffix).write_bytes(LFS)
    assert any(NAMED in str(each) for each in check_tree(recording))


def test_a_link_whose_file_is_not_there_is_named(tmp_path):
    (tmp_path / "calib.txt").symlink_to("../.git/annex/objects/MD5E-s12--4d7a")
    with pytest.raises(FileError, match=r"is a link to '\.\./\.git/annex.*, which cannot be"):
        read_text(tmp_path / "calib.txt")


def test_pointers_of_git_annex_are_named(tmp_path):
    (tmp_path / "calib.txt").write_bytes(ANNEX)
    with pytest.raises(FileError, match=r"calib\.txt: is a pointer of git-annex.*git annex get"):
        read_text(tmp_path / "calib.txt")


@pytest.mark.parametrize("name", ["drive.mcap", "drive.db3", "drive.bag"])
def test_a_pointer_in_the_place_of_a_bag_is_named(tmp_path, name):
    (tmp_path / name).write_bytes(LFS)
    with pytest.raises(FileError, match=f"{name}: {NAMED}"):
        import_recording(tmp_path / name, tmp_path / "out")


def test_a_pointer_in_the_place_of_a_table_is_named(tmp_path):
    source = write_nuscenes(tmp_path / "nuscenes")
    table = next(source.rglob("sample_data.json"))
    table.write_bytes(LFS)
    with pytest.raises(FileError, match=rf"sample_data\.json: {NAMED}"):
        import_recording(source, tmp_path / "out")


def test_a_pointer_is_not_packed(tmp_path, capsys):
    tree = write_object_tree(tmp_path / "tree", 1)
    (tree / "training/velodyne/000000.bin").write_bytes(LFS)
    assert main(["shard", str(tree), str(tmp_path / "out")]) == 1
    assert NAMED in capsys.readouterr().err
