import pytest

from sightline.cli import network_options
from sightline.cli.network_options import announce_engine


@pytest.fixture
def message(monkeypatch, capsys):
    """Function that returns the message about a choice and the engine used."""
    monkeypatch.delenv("SIGHTLINE_ENGINE")

    def call(choice, taken, device="cpu", *, has_openvino=True):
        monkeypatch.setattr(network_options, "has_openvino", lambda: has_openvino)
        announce_engine(choice, taken, device)
        captured = capsys.readouterr()
        assert not captured.out
        return captured.err

    return call


def test_the_engine_used_is_printed_in_one_line(message):
    assert (
        message("auto", "openvino") == "sightline: engine openvino (--engine torch for PyTorch)\n"
    )
    assert message("auto", "torch") == "sightline: engine torch\n"  # it could not be exported


def test_where_openvino_is_missing_it_says_how_to_get_it(message):
    line = message("auto", "torch", has_openvino=False)
    assert "pip install '.[export]'" in line
    assert len(line.splitlines()) == 1


def test_nothing_is_printed_for_a_requested_engine_or_without_a_network(message, monkeypatch):
    assert not message("torch", "torch")
    assert not message("auto", None)
    assert not message("auto", "torch", "cuda")
    monkeypatch.setenv("SIGHTLINE_ENGINE", "torch")
    assert not message("auto", "torch")
