"""From a first stage's weights to a trained second stage, by the commands that the recipe names."""

import pytest
import torch
import yaml

from sightline.cli.main import main
from sightline.detection3d.config import Detection3DConfig
from sightline.files.settings import parse_settings
from sightline.files.weights import read_weights
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.tasks import PACKAGE_RECIPES
from sightline.training.quiet import LIGHTNING_NOISE
from tests.detection3d.frames import without_refinement, write_network

pytestmark = [pytest.mark.filterwarnings(f"ignore:{beginning}") for beginning in LIGHTNING_NOISE]

RECIPE = "detection3d-points-street"
NUM_POINTS = 1024


def test_a_second_stage_is_trained_on_what_a_first_one_gave(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    plain = yaml.safe_load((PACKAGE_RECIPES / f"{RECIPE}.yaml").read_text())
    network = plain["model"]["init_args"]["network"]
    network["input"]["num_points"] = NUM_POINTS
    settings = parse_settings(Detection3DConfig, network)
    first = write_network(tmp_path / "first.safetensors", without_refinement(settings))
    command = ["proposals", str(PACKAGED_FRAMES), "cache", "--weights", "first.safetensors"]
    assert main([*command, "--workers", "1"]) == 0
    preparation = plain["data"]["init_args"]["preparation"]["init_args"]
    preparation["settings"] |= {"changes": None, "input": dict(network["input"])}
    plain["data"]["init_args"] |= {"training": [{"path": "."}], "validation": [{"path": "."}]}
    (tmp_path / "second.yaml").write_text(yaml.safe_dump(plain))
    flags = {
        "model.init_args.stages": "second",
        "model.init_args.initial_weights": "first.safetensors",
        "model.init_args.initial_part": "points",
        "data.init_args.preparation.init_args.cache": "cache",
        "data.init_args.root": PACKAGED_FRAMES,
        "data.init_args.batch_size": 2,
        "data.init_args.workers": 0,
        "trainer.max_steps": 2,
        "trainer.accelerator": "cpu",
        "trainer.enable_progress_bar": "false",
    }
    given = [f"--{name}={value}" for name, value in flags.items()]
    assert main(["fit", "--config", "second.yaml", *given]) == 0, capfd.readouterr().err
    trained = read_weights(tmp_path / "runs" / "second" / "weights.safetensors")
    for name, tensor in first.state_dict().items():
        assert torch.equal(trained.tensors[name], tensor)
    assert any(name.startswith("refinement.") for name in trained.tensors)
