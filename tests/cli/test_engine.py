import pytest

from sightline.cli import engine
from sightline.cli.engine import tell_engine


@pytest.fixture
def said(monkeypatch, capsys):
    """What is told of a choice and the engine that was taken."""
    monkeypatch.delenv("SIGHTLINE_ENGINE")

    def tell(choice, taken, device="cpu", *, has_openvino=True):
        monkeypatch.setattr(engine, "has_openvino", lambda: has_openvino)
        tell_engine(choice, taken, device)
        told = capsys.readouterr()
        assert not told.out
        return told.err

    return tell


def test_the_engine_that_was_taken_is_told_in_one_line(said):
    assert said("auto", "openvino") == "sightline: engine openvino (--engine torch for PyTorch)\n"
    assert said("auto", "torch") == "sightline: engine torch\n"  # it could not be exported


def test_where_openvino_is_missing_it_says_how_to_get_it(said):
    told = said("auto", "torch", has_openvino=False)
    assert "pip install '.[export]'" in told
    assert len(told.splitlines()) == 1


def test_nothing_is_told_that_was_asked_for_or_that_runs_no_network(said, monkeypatch):
    assert not said("torch", "torch")
    assert not said("auto", None)
    assert not said("auto", "torch", "cuda")
    monkeypatch.setenv("SIGHTLINE_ENGINE", "torch")
    assert not said("auto", "torch")
