import fcntl
import json
import os
import shutil

import numpy as np
import pytest

from sightline.app.site import chosen_states, export_page
from sightline.cli.main import main
from sightline.data.formats.rings import ring_numbers
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.app.makers import QuickMaker

FEW = {"frames": ("000000",), "kinds": ("lidar_rain",), "severities": (2, 4)}
BUTTONS = 6


class FailingMaker(QuickMaker):
    """Refuses one state."""

    def make(self, task):
        if "lidar_rain.4" in task.state.to_query() and task.part == "joined":
            raise ValueError("this state is damaged")
        return super().make(task)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr("sightline.app.site.PartMaker", QuickMaker)


def export(site, data=None, **changes):
    heard = []
    settings = FEW | {"workers": 2, "velodyne": None, "engine": "torch"} | changes
    content = export_page(data, site, announce=heard.append, **settings)
    return content, heard[0]


def files_of(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_a_frame_has_the_buttons_states_and_each_kind_at_each_severity_once():
    states = chosen_states(["a", "b"], ["lidar_blank", "lidar_rain"], [5, 2])
    queries = [state.to_query() for state in states if state.broken.frame == "a"]
    assert len(states) == 2 * len(queries)
    assert queries[0] == "frame=a"
    assert queries.count("frame=a&fault=lidar_blank.5.0") == 1  # a button, too
    assert queries[-3:] == [
        "frame=a&fault=lidar_blank.2.0", "frame=a&fault=lidar_rain.2.0",
        "frame=a&fault=lidar_rain.5.0",
    ]  # fmt: skip


def test_the_same_export_has_the_same_bytes_and_tells_its_size_before_and_after(tmp_path):
    content, before = export(tmp_path / "one")
    export(tmp_path / "other", workers=1)
    one, other = files_of(tmp_path / "one"), files_of(tmp_path / "other")
    assert one == other
    assert content.num_bytes == sum(map(len, one.values()))
    assert str(content).startswith(f"{BUTTONS + 2} states of 1 frames, ")
    assert f"{BUTTONS + 2} states of 1 frames, about" in before
    setup = json.loads(one["setup.json"])
    for place in setup["states"].values():
        state = json.loads(one[place])
        assert {each["part"] for each in state["parts"]} == {
            "health", "detection2d", "detection3d", "depth-completion", "joined",
        }  # fmt: skip
        assert all(each in one for each in state["files"].values())
    text = b"".join(each for name, each in one.items() if name.endswith((".json", ".html")))
    assert str(PACKAGED_FRAMES.parent).encode() not in text  # no path of this machine
    assert {path.name for path in tmp_path.iterdir()} == {"one", "other"}


def test_an_interrupted_export_leaves_no_folder_and_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr("sightline.app.site.PartMaker", FailingMaker)
    with pytest.raises(
        ValueError, match=r"lidar_rain\.4\.0: this state is damaged\..*run the same"
    ):
        export(tmp_path / "site")
    assert [path.name for path in tmp_path.iterdir()] == [".site.part"]
    monkeypatch.setattr("sightline.app.site.PartMaker", QuickMaker)
    _, before = export(tmp_path / "site")
    missing = int(before.split("; ")[1].split()[0])
    assert 1 <= missing < BUTTONS
    export(tmp_path / "whole")
    assert files_of(tmp_path / "site") == files_of(tmp_path / "whole")


def test_an_older_export_is_replaced_and_what_it_has_is_not_computed_again(tmp_path):
    export(tmp_path / "site")
    _, before = export(tmp_path / "site", severities=(2, 5))
    assert "; 1 are to be computed" in before
    setup = json.loads((tmp_path / "site/setup.json").read_text())
    assert any("lidar_rain.5.0" in key for key in setup["states"])
    assert not any("lidar_rain.4.0" in key for key in setup["states"])
    assert len(list((tmp_path / "site/states").iterdir())) == len(setup["states"])
    assert [path.name for path in tmp_path.iterdir()] == ["site"]


@pytest.mark.parametrize("content", ["{}", "[]", '{"files": 3}', '{"fil', '{"files": {"a": {}}}'])
def test_a_damaged_file_of_an_older_export_is_made_anew(tmp_path, content):
    export(tmp_path / "site")
    whole = files_of(tmp_path / "site")
    damaged = min((tmp_path / "site/states").iterdir())
    damaged.unlink()
    damaged.write_text(content)
    _, before = export(tmp_path / "site")
    assert "; 1 are to be computed" in before
    assert files_of(tmp_path / "site") == whole


def lose_a_point(tree):
    sweep = tree / "training/velodyne/000000.bin"
    sweep.write_bytes(sweep.read_bytes()[:-16])


def correct_a_digit(tree):
    calibration = tree / "training/calib/000000.txt"
    before = calibration.read_text()
    calibration.write_text(before.replace("P2: 7", "P2: 8", 1))  # as long as before
    assert calibration.read_text() != before


@pytest.mark.parametrize("change", [lose_a_point, correct_a_digit])
def test_a_frame_that_has_changed_is_computed_again(tmp_path, change):
    tree = tmp_path / "tree"
    shutil.copytree(PACKAGED_FRAMES, tree)
    export(tmp_path / "site", tree)
    change(tree)
    _, before = export(tmp_path / "site", tree)
    assert f"; {BUTTONS + 2} are to be computed" in before


@pytest.mark.parametrize("name", ["notes.txt", "sightline.json", ".sightline-notes"])
def test_a_folder_that_no_export_wrote_is_left_alone(tmp_path, name):
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / name).write_text('{"made_by": "somebody"}')
    with pytest.raises(ValueError, match=f"holds {name}, which no export wrote; name a new"):
        export(tmp_path / "site")
    assert files_of(tmp_path) == {f"site/{name}": b'{"made_by": "somebody"}'}


def test_an_own_folder_with_another_s_file_is_left_alone(tmp_path):
    export(tmp_path / "site")
    (tmp_path / "site/CNAME").write_text("mine")
    before = files_of(tmp_path)
    with pytest.raises(ValueError, match="holds CNAME, which no export wrote"):
        export(tmp_path / "site", severities=(1,))
    assert files_of(tmp_path) == before


def test_nothing_is_written_into_the_data(tmp_path):
    shutil.copytree(PACKAGED_FRAMES, tmp_path / "tree")
    before = files_of(tmp_path)
    for place in ("tree", "tree/site", "tree/training/site"):
        with pytest.raises(ValueError, match="as that would change the data set"):
            export(tmp_path / place, tmp_path / "tree")
    assert files_of(tmp_path) == before


def test_a_folder_that_another_process_exports_is_refused(tmp_path):
    (tmp_path / ".site.part").mkdir()
    lock = os.open(tmp_path / ".site.part", os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(ValueError, match="is being exported by another process"):
            export(tmp_path / "site")
    finally:
        os.close(lock)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--export", "site", "--frames", "000009"], "000009"),
        (["--export", "site", "--kinds", "lidar_fgo"], "no kind of corruption 'lidar_fgo'"),
        (["--export", "site", "--kinds", "lidar_fog", "--severities", "6"], "from 1 to 5, got 6"),
        (["--kinds", "lidar_fog"], "--kinds is for --export; give --export FOLDER"),
        (["--export", "/dev/null"], "is no folder"),
        (["--export", "/"], "is no place for an export"),
        (["--export", "."], ". is the current folder, which an export cannot replace"),
        (["--export", "/proc"], "/proc is a mount point, which an export cannot replace"),
        (["--export", "/proc/site"], "cannot be written"),
    ],
)
def test_what_cannot_be_exported_is_refused_in_one_line(
    words, message, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(["serve", *words]) == 2
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1
    assert not list(tmp_path.glob("site"))


def lose_a_calibration(tree):
    (tree / "training/calib/000001.txt").unlink()


def take_millimetres(tree):
    sweep = tree / "training/velodyne/000001.bin"
    points = np.fromfile(sweep, np.float32).reshape(-1, 4)
    (points * np.float32([1000, 1000, 1000, 1])).tofile(sweep)


@pytest.mark.parametrize("spoil", [lose_a_calibration, take_millimetres])
def test_faults_of_other_frames_than_the_named_ones_matter_only_where_none_are_named(
    tmp_path, spoil
):
    tree = tmp_path / "tree"
    shutil.copytree(PACKAGED_FRAMES, tree)
    spoil(tree)
    content, _ = export(tmp_path / "site", tree)
    assert content.frames == 1
    with pytest.raises(ValueError, match="000001"):
        export(tmp_path / "other", tree, frames=None)


@pytest.mark.filterwarnings("ignore:.* is the same picture")
@pytest.mark.filterwarnings("ignore:.* is the same cloud")
def test_limits_of_health_are_those_of_all_frames_whatever_is_exported(tmp_path):
    tree = tmp_path / "tree"
    shutil.copytree(PACKAGED_FRAMES, tree)
    sweep = tree / "training/velodyne/000000.bin"
    points = np.fromfile(sweep, np.float32).reshape(-1, 4)
    points[ring_numbers(points) % 4 == 0].tofile(sweep)  # lost 3 of 4 rings
    for name in ("000002", "000003"):
        for path in sorted(tree.rglob("*000001.*")):
            shutil.copy(path, path.with_stem(name))
    export(tmp_path / "site", tree, frames=["000000"])
    states = [json.loads(path.read_text()) for path in (tmp_path / "site/states").iterdir()]
    health = [each for state in states for each in state["parts"] if each["part"] == "health"]
    assert {each["limits"]["lidar"] for each in health} == {"shipped, 64 beams (recognised)"}
