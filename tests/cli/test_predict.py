from pathlib import Path

import pytest
import torch

from sightline.cli import main as cli
from sightline.data.formats.map_png import read_depth_png
from sightline.simulation.packaged import PACKAGED_FRAMES


@pytest.fixture
def two_threads():
    """PyTorch's default number of threads on two cores."""
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


def test_valid_only_writes_depth_where_the_method_vouches_for_it(tmp_path: Path):
    words = ["predict", "depth-completion", str(PACKAGED_FRAMES)]
    options = ["--method", "adaptive", "--workers", "1"]
    assert cli.main([*words, str(tmp_path / "all"), *options]) == 0
    assert cli.main([*words, str(tmp_path / "valid"), *options, "--valid-only"]) == 0
    for path in (tmp_path / "all").glob("*.png"):
        everywhere, kept = (
            read_depth_png(tmp_path / name / path.name) for name in ("all", "valid")
        )
        assert (everywhere > 0).all()
        assert 0.5 < (kept > 0).mean() < 0.95
        assert (kept[kept > 0] == everywhere[kept > 0]).all()
        assert not kept[:20].any()  # the sky


@pytest.mark.parametrize(
    "words", [["predict", "detection3d"], ["perceive"], ["show", "--task", "detection2d"]]
)
def test_a_folder_that_is_not_there_is_told_before_networks_are_loaded(
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.setattr("sightline.tasks.Task.predictor", None)
    data, out = tmp_path / "boxes", tmp_path / "out"
    rest = [str(data), "0", "--out", str(out)] if words[0] == "show" else [str(data), str(out)]
    assert cli.main([*words, *rest]) == 2
    assert f"{data}: does not exist" in capsys.readouterr().err
    assert not out.exists()
