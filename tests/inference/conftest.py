import pytest

from tests.inference.trees import write_object_tree


@pytest.fixture
def data(tmp_path):
    return write_object_tree(tmp_path / "data", 6)


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"
