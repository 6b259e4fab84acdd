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
            ["perceive", DATA, "OUT", "--detection2d", "none", "--detection3d", "none",
             "--depth-completion", "linear", "--around", "yes"],
            "--around has no effect without 3D detection",
        ),
        (
            ["perceive", DATA, "OUT", "--detection2d", "none", "--detection3d", "none",
             "--depth-completion", "linear", "--all-outputs"],
            "--all-outputs has no effect on these tasks and predictors, which have no further outp",
        ),
        (
            ["robustness", "--compare", "a", "b", "--cases", "clean", "--engine", "torch"],
            "--cases and --engine have no effect with --compare, which reads finished runs",
        ),
        (
            ["robustness", "--compare", "a", "b", "--seed", "4", "--sample-list", "none.txt"],
            "--seed and --sample-list have no effect with --compare",
        ),
        (
            ["reproduce", "gated-fusion", "--iou", "0.3", "--class-name", "Pedestrian"],
            "--class-name and --iou have no effect without --data; leave them out",
        ),
        (
            ["reproduce", "two-stage", "--out", "OUT", "--figure-frame", "000002"],
            "--out and --figure-frame have no effect without --data",
        ),
        (
            ["reproduce", "shift-conv", "--device", "cuda", "--sample-list", "nope.txt"],
            "--device and --sample-list have no effect without --data",
        ),
        (
            ["serve", DATA, "--export", "OUT", "--host", "0.0.0.0", "--port", "9999"],
            "--host and --port have no effect with --export, which opens no page",
        ),
        (
            ["simulate", "OUT", "--no-camera", "--samples-per-pixel", "4"],
            "samples_per_pixel has no effect without the camera; leave it out",
        ),
        (
            ["show", DATA, "000000", "--method", "linear", "--min-score", "0.9"],
            "--min-score has no effect on depth maps; leave it out",
        ),
        (
            ["evaluate", "objects", DATA, DATA, "--seed", "5"],
            "--seed has no effect without --bootstrap or --against",
        ),
        (
            ["evaluate", "depth", DATA, DATA, "--seed", "5"],
            "--seed has no effect without --against",
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


def test_health_tells_a_list_that_is_not_sorted(tmp_path):
    names = tmp_path / "list.txt"
    names.write_text("000001\n000000\n")
    with pytest.warns(UserWarning, match=r"list.txt is not sorted: alarms and alignment follow"):
        assert main(["health", DATA, "--sample-list", str(names)]) == 0
    names.write_text("000000\n000001\n")
    assert main(["health", DATA, "--sample-list", str(names)]) == 0


def test_a_network_as_the_baseline_of_a_method_has_an_engine(tmp_path, capsys, monkeypatch):
    def reached(*_, **options):
        raise ValueError(f"run by {options['engine']}")

    monkeypatch.setattr("sightline.robustness.bench.run_bench", reached)
    arguments = ["robustness", str(tmp_path / "out"), "--data", DATA, "--method", "linear"]
    assert main([*arguments, "--baseline", "depth-best", "--engine", "torch"]) == 2
    assert capsys.readouterr().err == "sightline: run by torch\n"
    assert main([*arguments, "--engine", "torch"]) == 2
    assert "--engine has no effect" in capsys.readouterr().err
