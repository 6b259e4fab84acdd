from pathlib import Path

import pytest

from sightline.data.image_header import read_image_size
from sightline.data.jobs import JobResult
from sightline.simulation import command
from sightline.simulation.command import run_simulation
from sightline.simulation.simulator import SimulationConfig


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[dict]:
    """What `simulate` was asked for."""
    calls: list[dict] = []

    def note(out: Path, **arguments: object) -> JobResult:
        calls.append({"out": out, **arguments})
        return JobResult(written=3, skipped=1)

    monkeypatch.setattr(command, "simulate", note)
    return calls


def test_a_small_set_is_made_by_one_call(tmp_path: Path):
    text = run_simulation(
        tmp_path,
        frames=1,
        image_size=(310, 94),
        focal_px=180.0,
        workers=1,
    )
    assert "1 frames simulated, 0 were there already" in text
    assert read_image_size(tmp_path / "training/image_2/000000.png") == (94, 310)


def test_defaults_are_those_of_the_configuration(asked: list[dict], tmp_path: Path):
    assert run_simulation(tmp_path).endswith("3 frames simulated, 1 were there already")
    assert asked[0]["config"] == SimulationConfig()
    assert asked[0]["frames"] == 100


def test_a_preset_gives_what_is_not_asked_for(asked: list[dict], tmp_path: Path):
    run_simulation(tmp_path, preset="street-2k", seed=5)
    assert asked[0]["frames"] == 2200
    assert asked[0]["velodyne"] == "velodyne_reduced"
    assert asked[0]["config"].seed == 5
    assert asked[0]["config"].image_size == (352, 1216)


def test_the_camera_is_left_out_and_hard_streets_are_asked_for_by_name(
    asked: list[dict], tmp_path: Path
):
    run_simulation(tmp_path, camera=False, hard=True)
    assert asked[0]["config"] == SimulationConfig(camera=False, hard=True)
    run_simulation(tmp_path, preset="street-hard-500")
    assert asked[1]["config"].hard
