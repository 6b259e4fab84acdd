"""Nothing is written outside the folder that was named, whatever links it holds."""

import pytest

from sightline.cli.main import main
from sightline.files.atomic import check_links
from sightline.jobs.output_dirs import MANIFEST_NAME, Claim, acquire_output_dir, claim_folders
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.training.run_folder import claimed

DATA = str(PACKAGED_FRAMES)
NEAREST = ["--depth-completion", "nearest", "--detection2d", "none", "--detection3d", "none"]


@pytest.fixture
def elsewhere(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "mine.txt").write_text("mine")
    return tmp_path / "elsewhere"


@pytest.fixture
def out(tmp_path):
    (tmp_path / "out").mkdir()
    return tmp_path / "out"


def contents(folder):
    return {path.name: path.read_text() for path in folder.iterdir()}


@pytest.mark.parametrize("target", ["", "new", "not/there"])
def test_a_link_to_a_folder_outside_or_to_nothing_is_refused(out, elsewhere, target):
    (out / "deep").mkdir()
    (out / "deep" / "lines").symlink_to(elsewhere / target)
    with pytest.raises(ValueError, match=r"deep/lines is a link to .*remove the link, or name"):
        check_links(out)
    with pytest.raises(ValueError, match="deep/lines is a link"):
        claim_folders([Claim(folder=out, settings={}, results=())])
    assert not (out / MANIFEST_NAME).exists()


def test_other_links_are_none_of_its_business(out, elsewhere, tmp_path):
    (out / "a").mkdir()
    (out / "b").symlink_to(out / "a")
    (out / "c.txt").symlink_to(elsewhere / "mine.txt")
    (tmp_path / "alias").symlink_to(out)
    for folder in (out, tmp_path / "alias", tmp_path / "none"):
        check_links(folder)
    with pytest.raises(ValueError, match=r"c\.txt is a link"):
        check_links(out, files=True)
    with pytest.raises(ValueError, match=r"c\.txt is a link"), claimed(out):
        pass


@pytest.mark.parametrize("target", ["elsewhere/new.json", "out/other.json"])
def test_a_manifest_that_leads_nowhere_is_refused(out, elsewhere, tmp_path, target):
    (out / MANIFEST_NAME).symlink_to(tmp_path / target)
    with pytest.raises(ValueError, match="which does not exist"):
        acquire_output_dir(out, {"a": 1}, results=("*.txt",))
    assert contents(elsewhere) == {"mine.txt": "mine"}


@pytest.mark.parametrize(
    ("link", "command"),
    [
        ("lines", ["perceive", DATA, "out", *NEAREST, "--workers", "1"]),
        ("timings", ["perceive", DATA, "out", *NEAREST, "--workers", "1"]),
        ("depth-completion", ["perceive", DATA, "out", *NEAREST, "--workers", "1"]),
        ("sightline.json", ["predict", "depth-completion", DATA, "out", "--method", "nearest"]),
        ("camera_blank", ["corrupt", DATA, "out", "--suite", "camera_blank"]),
        ("training", ["simulate", "out", "--frames", "1"]),
        ("scores", ["robustness", "out", "--data", DATA, "--method", "nearest"]),
        ("pictures", ["robustness", "out", "--data", DATA, "--method", "nearest"]),
        ("images", ["demo", "--out", "out"]),
    ],
    ids=lambda value: value if isinstance(value, str) else value[0],
)
def test_every_command_that_fills_a_folder_refuses_links_out_of_it(
    out, elsewhere, tmp_path, monkeypatch, capsys, link, command
):
    monkeypatch.chdir(tmp_path)
    (out / link).symlink_to(elsewhere / "new" if "." in link else elsewhere)
    assert main(command) == 2
    errors = capsys.readouterr().err.splitlines()
    assert f"sightline: out/{link} is a link to" in errors[-1]
    assert contents(elsewhere) == {"mine.txt": "mine"}


def test_a_result_that_is_a_link_is_replaced(out, elsewhere, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = ["predict", "depth-completion", DATA, "out", "--method", "nearest", "--workers", "1"]
    assert main(command) == 0
    (out / "000000.png").unlink()
    (out / "000000.png").symlink_to(elsewhere / "mine.txt")
    assert main([*command, "--overwrite"]) == 0
    assert not (out / "000000.png").is_symlink()
    assert contents(elsewhere) == {"mine.txt": "mine"}
