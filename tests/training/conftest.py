import logging

import pytest

from sightline.training.command import LIGHTNING_NOISE
from tests.training import toy


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
    """A folder of nine small frames."""
    return toy.write_frames(tmp_path_factory.mktemp("frames"))
