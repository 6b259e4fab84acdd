"""Options that would be ignored are refused before the work."""

import pytest

from sightline.cli.main import main
from sightline.simulation.packaged import PACKAGED_FRAMES

DATA = str(PACKAGED_FRAMES)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["predict", "depth-completion", DATA, "OUT", "--method", "linear", "--engine", "torch"],
            "--engine has no effect without a network; leave it out",
        ),
        (
            ["evaluate", "held-out", DATA, "--method", "linear", "--device", "cuda"],
            "--device has no effect without a network",
        ),
        (
            ["robustness", "OUT", "--data", DATA, "--task", "depth-completion", "--method",
             "linear", "--engine", "torch", "--device", "cuda"],
            "--engine and --device have no effect without a network; leave them out",
        ),
        (
            ["robustness", "OUT", "--data", DATA, "--task", "detection2d", "--results", "found",
             "--device", "cuda"],
            "--device has no effect without a network",
        ),
        (
            ["perceive", DATA, "OUT", "--detection2d", "none", "--detection3d", "none",
             "--depth-completion", "linear", "--engine", "torch"],
            "--engine has no effect without a network",
        ),
        (
            ["perceive", DATA, "OUT", "--detection2d", "none", "--detection3d", "none",
             "--depth-completion", "linear", "--fps", "5"],
            "--fps has no effect without --video; leave it out",
        ),
        (
            ["perceive", DATA, "OUT", "--detection2d", "none", "--detection3d", "none",
             "--depth-completion", "linear", "--min-score", "0.5"],
            "--min-score has no effect without --video or --rerun",
        ),
        (
            ["evaluate", "calibration", DATA, DATA, "--target", "overlap"],
            "--target has no effect without --fit-results",
        ),
    ],
)  # fmt: skip
def test_options_without_an_effect_are_refused(tmp_path, capsys, arguments, said):
    out = tmp_path / "out"
    assert main([str(out) if each == "OUT" else each for each in arguments]) == 2
    assert said in capsys.readouterr().err
    assert not out.exists()
