import pytest

from tests.inference.trees import write_object_tree


@pytest.fixture
def data(tmp_path):
    """Small object tree of four frames."""
    return write_object_tree(tmp_path / "data", 4)


@pytest.fixture
def out(tmp_path):
    """Output folder, not yet created."""
    return tmp_path / "out"
