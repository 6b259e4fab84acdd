from pathlib import Path

import pytest
import torch

from sightline.cli import main as cli
from sightline.simulation.packaged import PACKAGED_FRAMES


@pytest.fixture
def two_threads():
    """As many as PyTorch takes by itself on two cores."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


@pytest.mark.usefixtures("two_threads")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_depth_maps_are_the_same_bytes_for_any_number_of_workers(tmp_path: Path):
    # Of the shipped weights at the full size: small networks are the same on several threads, too.
    for workers in ("1", "2"):
        words = ["predict", "depth-completion", str(PACKAGED_FRAMES), str(tmp_path / workers)]
        assert cli.main([*words, "--workers", workers]) == 0
    for one in sorted((tmp_path / "1").glob("*.png")):
        assert one.read_bytes() == (tmp_path / "2" / one.name).read_bytes(), one.name
    assert len(list((tmp_path / "1").glob("*.png"))) == 2
