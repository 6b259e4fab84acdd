"""What works, and what is said, where the extras `train` and `simulate` are not installed."""

import subprocess
import sys

import pytest

from sightline.simulation.packaged import PACKAGED_FRAMES

EXTRAS = ("lightning", "pytorch_lightning", "torchmetrics", "tensorboard", "embreex", "torchvision",
          "openvino", "onnx", "onnxruntime", "rosbags", "av", "rerun")  # fmt: skip
# What Python does for a library that is not there: no spec, and ModuleNotFoundError by its name.
PROGRAM = """
import sys
from importlib.machinery import PathFinder

class Absent(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] in EXTRAS else super().find_spec(name, path, target)

sys.meta_path[:] = [Absent if each is PathFinder else each for each in sys.meta_path]
from sightline.cli.main import main
for arguments in COMMANDS:
    status = main(arguments)
    assert status == 0, (arguments, status)
"""


def run_without_extras(folder, *commands):
    program = f"EXTRAS = {EXTRAS!r}\nCOMMANDS = {[list(map(str, each)) for each in commands]!r}\n"
    return subprocess.run(
        [sys.executable, "-c", program + PROGRAM],
        check=False,
        capture_output=True,
        text=True,
        cwd=folder,
    )


def test_a_worker_predicts_scores_and_checks_without_any_extra(tmp_path):
    frames, labels = PACKAGED_FRAMES, PACKAGED_FRAMES / "training" / "label_2"
    done = run_without_extras(
        tmp_path,
        ["check", frames, "--workers", 1],
        ["perceive", frames, "all", "--depth-completion", "depth-fast-cpu", "--detection2d",
         "detection2d-fast-cpu", "--detection3d", "detection3d-fast-cpu", "--workers", 1],
        ["predict", "depth-completion", frames, "depth", "--method", "nearest", "--workers", 1],
        ["evaluate", "objects", "all/detection3d", labels, "--json", "objects.json"],
        ["evaluate", "depth", "depth", PACKAGED_FRAMES / "training" / "depth"],
        ["evaluate", "held-out", frames, "--method", "linear", "--beams", 16],
        ["corrupt", frames, "corrupted", "--cases", "lidar_blank", "--workers", 1],
        ["tasks"],
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len((tmp_path / "all" / "perception.jsonl").read_text().splitlines()) == 2


@pytest.mark.parametrize(
    ("arguments", "package", "extra"),
    [
        (["fit", "--config", "detection3d-rpn-street"], "lightning", "train"),
        (["simulate", "frames", "--frames", 1], "embreex", "simulate"),
        (["adapt", PACKAGED_FRAMES, "adapted"], "lightning", "train"),
    ],
)
def test_what_needs_an_extra_names_the_command_that_installs_it(
    arguments, package, extra, tmp_path
):
    done = run_without_extras(tmp_path, arguments)
    assert "AssertionError" in done.stderr  # of the status, which is not 0
    message = next(line for line in done.stderr.splitlines() if "not installed" in line)
    assert message == (
        f"sightline: {package} is not installed; install it with: pip install '.[{extra}]', in the "
        "folder of Sightline's source"
    )
    assert list(tmp_path.iterdir()) == []
