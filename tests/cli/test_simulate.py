from dataclasses import fields
from pathlib import Path

import pytest

from sightline.cli import main as cli
from sightline.data.formats.image_header import read_image_size
from sightline.jobs.run import JobResult
from sightline.simulation import generate
from sightline.simulation.rigs import named_rig
from sightline.simulation.settings import PRESETS, SimulatedSet, SimulationConfig


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[dict]:
    """Arguments of the calls of `generate.simulate`."""
    calls: list[dict] = []

    def note(out: Path, **arguments: object) -> JobResult:
        calls.append({"out": out, **arguments})
        return JobResult(written=3, skipped=1)

    monkeypatch.setattr(generate, "simulate", note)
    return calls


def run(*arguments: str) -> int:
    try:
        return cli.main(["simulate", "street", *arguments])
    except SystemExit as exit_:
        return int(exit_.code or 0)


def test_a_small_set_is_made_by_one_command(tmp_path: Path, capsys):
    size = ["--image-size", "310", "94", "--focal-px", "180"]
    status = cli.main(["simulate", str(tmp_path), "--frames", "1", "--workers", "1", *size])
    assert status == 0
    assert "frames: 1 written, 0 there already" in capsys.readouterr().out
    assert read_image_size(tmp_path / "training/image_2/000000.png") == (94, 310)


def test_what_is_not_given_is_as_the_settings_have_it(calls: list[dict], capsys):
    assert run() == 0
    assert capsys.readouterr().out == "street: frames: 3 written, 1 there already\n"
    chosen = SimulatedSet()
    assert calls == [
        {
            "out": Path("street"),
            "frames": chosen.frames,
            "config": SimulationConfig(),
            "workers": 2,
            "driver": "local",
            "velodyne": chosen.velodyne,
            "validation_frames": chosen.validation_frames,
            "shard_index": 0,
            "num_shards": 1,
        }
    ]


def test_every_setting_is_an_option_with_its_text_and_default(capsys):
    run("--help")
    text = " ".join(capsys.readouterr().out.split())
    for settings in (SimulatedSet, SimulationConfig):
        for setting in fields(settings):
            if setting.name != "config":
                assert f"--{setting.name.replace('_', '-')}" in text, setting.name
    assert "It scales the image before cropping: half of KITTI's shows" in text
    assert "Default: 1242 375." in text
    assert "default: null" not in text


def test_options_reach_the_settings_of_their_names(calls: list[dict]):
    options = "--frames 7 --validation-frames 2 --velodyne velodyne_reduced --seed 5"
    options += " --image-size 1920,1200 --focal-px 600 --samples-per-pixel 4 --lidar vlp-16"
    options += " --rolling-shutter --hard --workers 3 --driver ray"
    options += " --shard-index 1 --num-shards 2"
    assert run(*options.split()) == 0
    assert calls[0] == {
        "out": Path("street"),
        "frames": 7,
        "workers": 3,
        "driver": "ray",
        "velodyne": "velodyne_reduced",
        "validation_frames": 2,
        "shard_index": 1,
        "num_shards": 2,
        "config": SimulationConfig(
            seed=5,
            image_size=(1200, 1920),
            focal_px=600.0,
            samples_per_pixel=4,
            lidar="vlp-16",
            rolling_shutter=True,
            hard=True,
        ),
    }
    run("--sequence-length", "3", "--image-size", "1920", "1200", "--no-camera")
    assert calls[1]["config"] == SimulationConfig(
        sequence_length=3, image_size=(1200, 1920), camera=False
    )


def test_a_preset_gives_unspecified_settings_wherever_it_stands(calls: list[dict]):
    run("--seed", "0", "--preset", "street-2k")
    run("--preset", "street-2k", "--seed", "0")
    assert calls[0] == calls[1]
    preset = PRESETS["street-2k"]
    assert calls[0]["frames"] == preset.frames
    assert calls[0]["velodyne"] == "velodyne_reduced"
    assert calls[0]["config"] == SimulationConfig(seed=0, image_size=preset.config.image_size)


def test_a_rig_is_given_by_its_name_or_file_or_drawn(calls: list[dict], tmp_path: Path):
    mine = tmp_path / "mine.yaml"
    camera, lidar = "{image_size: {width: 64, height: 48}, focal_px: 60}", "{model: vlp-16}"
    mine.write_text(f"camera: {camera}\nlidar: {lidar}\n")
    for rig in ("waymo", "random", str(mine)):
        assert run("--rig", rig) == 0
    named, drawn, read = (call["config"].rig for call in calls)
    assert named == named_rig("waymo")
    assert drawn == "random"
    assert read.camera.image_size == (48, 64)


def test_hard_streets_of_a_preset_can_be_refused(calls: list[dict]):
    run("--preset", "street-hard-500")
    run("--preset", "street-hard-500", "--no-hard")
    assert [call["config"].hard for call in calls] == [True, False]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--seed", "-1"], "seed must not be negative, got -1"),
        (["--seed", "1.5"], "--seed: expected a whole number, got 1.5"),
        (["--focal-px", "1e30"], "focal_px must be between 1 and 100000, got 1e+30"),
        (["--focal-px", "-721"], "focal_px must be between 1 and 100000, got -721"),
        (["--image-size", "100000", "9"], "got 100000 x 9 (width x height)"),
        (["--image-size", "32", "32"], "the camera has its principal point at (4.5593, -170.146)"),
        (["--focal-px", "2"], "focal lengths of 2 and 2 px, which do not fit an image of 375x1242"),
        (["--samples-per-pixel", "3"], "--samples-per-pixel: expected one of 1, 4, got 3"),
        (["--sequence-length", "0"], "sequence_length must be between 1 and 10000, got 0"),
        (["--sequence-length", "1000000"], "sequence_length must be between 1 and 10000"),
        (["--frames", "0"], "frames must be at least 1"),
        (["--frames", "1000001"], "at most 1000000 frames"),
        (["--workers", "0"], "workers must be at least 1"),
        (["--num-shards", "0"], "num_shards must be at least 1, got 0"),
        (["--shard-index", "2", "--num-shards", "2"], "got 2 of 2"),
        (["--lidar", "sonar"], "sonar"),
        (["--preset", "street-9k"], "street-9k"),
        (["--rig", "kity"], "rig must be random, named, a YAML file, or one of kitti, nuscenes"),
        (["--rig", "absent.yaml"], "absent.yaml: cannot be read: no such file"),
        (["--rig", "waymo", "--lidar", "vlp-16"], "a rig has its own lidar; leave out lidar or"),
        (["--rig", "random", "--sequence-length", "3"], "a drive has one rig for all frames"),
    ],
)
def test_senseless_settings_are_refused_in_one_line_before_the_folder_is_claimed(
    tmp_path: Path, monkeypatch, capsys, options: list[str], message: str
):
    monkeypatch.chdir(tmp_path)
    assert run(*options) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
