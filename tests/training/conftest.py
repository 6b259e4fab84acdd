import json
import logging

import pytest
import yaml

from sightline.training.quiet import LIGHTNING_NOISE
from tests.training import toy

RECIPE = {
    "model": {
        "class_path": "tests.training.toy.ToyModule",
        "init_args": {"optimizer": {"schedule": "cosine"}},
    },
    "data": {
        "class_path": "sightline.training.data.CameraLidarData",
        "init_args": {
            "preparation": {"class_path": "tests.training.toy.ToyPreparation"},
            "training": [{"path": "."}],
            "validation": [{"path": "."}],
            "test": [{"path": "."}],
            "batch_size": 2,
            "workers": 0,
        },
    },
    "trainer": {
        "max_epochs": 2,
        "accelerator": "cpu",
        "enable_progress_bar": False,
        "enable_model_summary": False,
    },
}


def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.is_relative_to(__file__.rpartition("/")[0]):
            for beginning in LIGHTNING_NOISE:
                item.add_marker(pytest.mark.filterwarnings(f"ignore:{beginning}"))


@pytest.fixture(autouse=True, scope="session")
def _quiet():
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)


@pytest.fixture(scope="session")
def frames(tmp_path_factory):
    """Folder of nine small frames."""
    return toy.write_frames(tmp_path_factory.mktemp("frames"))


@pytest.fixture
def recipes(tmp_path, frames, monkeypatch):
    """Folder with a recipe named toy; the current folder is empty."""
    recipe = json.loads(json.dumps(RECIPE))
    recipe["data"]["init_args"]["root"] = str(frames)
    folder = tmp_path / "recipes"
    folder.mkdir()
    (folder / "toy.yaml").write_text(yaml.safe_dump(recipe))
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return folder
