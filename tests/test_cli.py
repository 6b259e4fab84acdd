import json
import subprocess
import sys

import pytest

from sightline.cli import main as cli
from sightline.files.problem import memory_fault
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.training import command
from tests.depth_completion.networks import write_tiny_weights
from tests.small_frames import write_small_frames


def run(capsys, *arguments):
    """Run a command; returns exit status, standard output and standard error."""
    try:
        status = cli.main(list(arguments))
    except SystemExit as exit_:
        status = exit_.code or 0
    printed = capsys.readouterr()
    return status, printed.out, printed.err


@pytest.mark.parametrize(
    "command",
    [
        [],
        ["demo"],
        ["check"],
        ["show"],
        ["simulate"],
        ["corrupt"],
        ["health"],
        ["health-limits"],
        ["tasks"],
        ["predict"],
        ["predict", "depth-completion"],
        ["perceive"],
        ["evaluate"],
        ["evaluate", "objects"],
        ["evaluate", "proposals"],
        ["evaluate", "calibration"],
        ["evaluate", "depth"],
        ["evaluate", "held-out"],
        ["robustness"],
        ["reproduce"],
        ["reproduce", "shift-conv"],
        ["reproduce", "two-stage"],
        ["reproduce", "gated-fusion"],
        ["reproduce", "dgfn"],
        ["export"],
        ["submission"],
    ],
)
def test_every_command_explains_itself(capsys, command):
    status, out, _ = run(capsys, *command, "--help")
    assert status == 0
    assert "usage: sightline" in out


def test_help_is_printed_without_the_heavy_libraries():
    script = (
        "import sys; from sightline.cli.main import main\n"
        "try: main(['evaluate', 'held-out', '--help'])\n"
        "except SystemExit: pass\n"
        "print(sorted({'torch', 'numba', 'scipy', 'cv2'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "[]"


def test_what_scores_does_not_wait_for_libraries_that_it_does_not_need():
    script = (
        "import sys, sightline.evaluation.kitti_object, sightline.evaluation.depth\n"
        "print('torch' in sys.modules)\n"
        "import sightline.evaluation.held_out\n"
        "print('torchmetrics' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["False", "False"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["chekc"], "there is no command chekc; name one of demo, "),
        (["check"], "check needs DATA; see sightline check --help"),
        (["check", "DATA", "--workers", "two"], "--workers: expected a whole number, got two"),
        (["evaluate", "held-out", "DATA", "--method", "magic"], "magic"),
        (["evaluate", "held-out", "DATA", "--beams", "many"], "beams"),
        (["evaluate", "held-out", "DATA", "--engine", "steam"], "steam"),
        (["reproduce", "shift-conv", "--weights", "a"], "name a data set with --data"),
        (["reproduce", "gated-fusion", "--gated", "a"], "name KITTI's object tree with --data"),
        (["reproduce", "two-stage", "--first", "a"], "name KITTI's object tree with --data"),
        (["reproduce", "gated-fusion", "--data", "DATA", "--class-name", "Tram"], "Tram"),
        (["check", "DATA", "--wrokers", "2"], "wrokers"),
        (["corrupt", "DATA", "out", "--suite", "dgnf7"], "perhaps dgfn7 is meant"),
        (["corrupt", "DATA", "out", "--cases", "lidr_blank"], "perhaps lidar_blank is meant"),
    ],
)
def test_wrong_arguments_are_refused_in_one_line(capsys, tmp_path, arguments, message):
    given = [str(tmp_path) if word == "DATA" else word for word in arguments]
    status, _, err = run(capsys, *given)
    assert status == 2
    assert message in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    "command",
    [
        ["objects", "DATA", "DATA"],
        ["proposals", "DATA", "DATA"],
        ["depth", "DATA", "DATA"],
        ["held-out", "DATA"],
        ["realism", "DATA", "DATA"],
    ],
)
def test_a_report_that_cannot_be_written_is_refused_before_anything_is_read(
    capsys, tmp_path, command
):
    given = [str(tmp_path) if word == "DATA" else word for word in command]
    status, out, err = run(capsys, "evaluate", *given, "--json", "/dev/full")
    assert (status, out) == (2, "")
    assert err.startswith("sightline: /dev/full cannot be written: it is no regular file")
    assert err.count("\n") == 1


def test_an_unknown_frame_is_refused_with_a_known_one(capsys, tmp_path):
    status, _, err = run(
        capsys, "show", str(PACKAGED_FRAMES), "1", "--out", str(tmp_path / "1.png")
    )
    assert status == 2
    assert "perhaps 000001 is meant" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "arguments",
    [
        ["check", "nowhere"],
        ["show", "nowhere", "000000"],
        ["predict", "depth-completion", "nowhere", "out"],
        ["corrupt", "nowhere", "out"],
        ["evaluate", "objects", "nowhere", "nowhere"],
        ["evaluate", "proposals", "nowhere", "nowhere"],
        ["evaluate", "depth", "nowhere", "nowhere"],
        ["evaluate", "held-out", "nowhere"],
        ["reproduce", "shift-conv", "--data", "nowhere"],
        ["reproduce", "gated-fusion", "--data", str(PACKAGED_FRAMES), "--gated", "nowhere"],
        ["reproduce", "two-stage", "--data", str(PACKAGED_FRAMES), "--first", "nowhere"],
        ["export", "out.onnx", "--weights", "nowhere"],
        ["submission", "nowhere", "out.zip"],
        ["show", str(PACKAGED_FRAMES), "000000", "--weights", "nowhere"],
        ["predict", "depth-completion", str(PACKAGED_FRAMES), "out", "--weights", "nowhere"],
        ["evaluate", "held-out", str(PACKAGED_FRAMES), "--weights", "nowhere"],
    ],
)
def test_data_or_weights_that_are_not_there_are_named_in_one_line(
    capsys, tmp_path, monkeypatch, arguments
):
    monkeypatch.chdir(tmp_path)
    status, _, err = run(capsys, *arguments)
    assert status == 2
    assert "nowhere" in err
    assert len(err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_check_reports_faults_by_its_exit_status(capsys, tmp_path):
    status, out, _ = run(capsys, "check", str(PACKAGED_FRAMES))
    assert (status, out.splitlines()[-1]) == (0, "no problems")
    (tmp_path / "training").mkdir()
    for part in ("calib", "label_2", "image_2", "velodyne"):
        (tmp_path / "training" / part).symlink_to(PACKAGED_FRAMES / "training" / part)
    (tmp_path / "training" / "velodyne").unlink()
    (tmp_path / "training" / "velodyne").mkdir()
    (tmp_path / "training" / "velodyne" / "000000.bin").write_bytes(b"123")
    status, out, _ = run(capsys, "check", str(tmp_path))
    assert status == 1
    assert "000000.bin" in out


def test_several_beams_can_be_written_side_by_side(capsys, tmp_path):
    report = tmp_path / "held_out.json"
    data = str(PACKAGED_FRAMES)
    command = ["evaluate", "held-out", data, "--method", "nearest", "--beams", "64", "16"]
    status, out, _ = run(capsys, *command, "--json", str(report))
    assert status == 0
    assert list(json.loads(report.read_text())["beams"]) == ["64", "16"]
    assert "RMSE" in out


def test_an_output_that_cannot_be_written_is_named_in_one_line(capsys, tmp_path):
    (tmp_path / "file").write_text("no folder")
    out = str(tmp_path / "file" / "out.png")
    status, _, err = run(capsys, "show", str(PACKAGED_FRAMES), "000000", "--out", out)
    assert status == 2
    assert str(tmp_path / "file") in err
    assert len(err.splitlines()) == 1


def test_the_demo_names_what_it_wrote(capsys, tmp_path, monkeypatch):
    frames = write_small_frames(tmp_path / "frames")  # `make demo` takes the whole ones
    monkeypatch.setattr("sightline.inference.demo.PACKAGED_FRAMES", frames)
    folder = tmp_path / "out"
    status, out, err = run(capsys, "demo", "--out", str(folder))
    assert status == 0
    assert err.startswith("sightline: demo: depth-completion, ")
    named = [line.split(maxsplit=1)[1] for line in out.splitlines()[1:]]
    assert str(folder / "report.html") in named
    for path in (folder / "report.html", folder / "000000.png", folder / "depth/000001.png"):
        assert path.stat().st_size > 0
    page = (folder / "report.html").read_text()
    assert "depth by depth-best" in out
    assert "depth-best" in page
    assert 'src="000001.png"' in page


def test_corrupted_data_can_be_given_to_the_other_commands(capsys, tmp_path):
    out = tmp_path / "cases"
    command_line = ["corrupt", str(PACKAGED_FRAMES), str(out), "--suite", "dgfn7", "--seed", "3"]
    command_line += ["--workers", "1", "--cases", "camera_blank", "lidar_blank"]
    status, printed, _ = run(capsys, *command_line)
    assert (status, printed) == (0, f"{out}: frames of suite dgfn7: 4 written, 0 there already\n")
    for case in ("camera_blank", "lidar_blank"):
        status, printed, _ = run(capsys, "check", str(out / case))
        assert (status, printed.splitlines()[-1]) == (0, "no problems")
        depth = str(tmp_path / case)
        command = ["predict", "depth-completion", str(out / case), depth, "--method", "adaptive"]
        assert run(capsys, *command)[0] == 0


def test_ctrl_c_before_the_command_line_is_imported_is_one_line():
    script = (
        "import sys; from sightline import __main__\n"
        "class Interrupting:\n"
        "    def find_spec(self, name, *rest):\n"
        "        if name == 'sightline.cli.main': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupting())\n"
        "sys.exit(__main__.run())"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (130, "sightline: interrupted\n")


@pytest.mark.parametrize("subcommand", ["fit", "validate", "test"])
def test_training_gets_its_arguments_as_they_are_given(capsys, monkeypatch, subcommand):
    calls = []

    def train(*arguments, **settings):
        calls.append((*arguments, settings))
        return 0

    monkeypatch.setattr(command, "run_training", train)
    given = ["--config", "depth-best", "--beams", "64", "32"]
    status, _, _ = run(capsys, subcommand, *given)
    assert status == 0
    recipes = cli.PACKAGE_RECIPES
    assert calls == [(subcommand, given, {"recipes": recipes})]
    assert recipes.parts[-2:] == ("sightline", "recipes")


def test_help_lists_the_training_commands(capsys):
    _, out, _ = run(capsys, "--help")
    assert {"fit", "validate", "test"} <= {line.split()[0] for line in out.splitlines() if line}


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (ValueError("no such\nrecipe"), 2, "sightline: no such recipe\n"),
        (RuntimeError("std::bad_alloc"), 2, f"sightline: {memory_fault(MemoryError())}\n"),
        (
            FileNotFoundError(2, "No usable temporary directory found in ['/tmp']"),
            2,
            "sightline: no temporary folder (TMPDIR, /tmp, ..) can be written to; make room, or "
            "name another one by the variable TMPDIR\n",
        ),
        (
            UserWarning("the data are odd; look at them"),
            2,
            "sightline: the data are odd; look at them (a warning, which PYTHONWARNINGS makes an "
            "error)\n",
        ),
        (KeyboardInterrupt("interrupted; add --x"), 130, "sightline: interrupted; add --x\n"),
        (
            KeyboardInterrupt(),
            130,
            "sightline: interrupted; run the same command again to finish\n",
        ),
    ],
)
def test_a_failed_training_says_why_in_one_line(capsys, monkeypatch, error, status, message):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(command, "run_training", fail)
    assert run(capsys, "fit", "--config", "none") == (status, "", message)


def test_a_network_can_stand_wherever_a_method_can(capsys, tmp_path):
    weights = str(write_tiny_weights(tmp_path / "tiny.safetensors", uncertainty=True))
    data, out, report = str(PACKAGED_FRAMES), tmp_path / "out", tmp_path / "report.json"
    for command_line in (
        ["predict", "depth-completion", data, str(out), "--uncertainty", str(tmp_path / "error")],
        ["evaluate", "held-out", data, "--beams", "8", "--json", str(report)],
        ["show", data, "000000", "--out", str(tmp_path / "000000.png")],
        ["reproduce", "shift-conv", "--data", data, "--json", str(tmp_path / "tables.json")],
    ):
        status, _, err = run(capsys, *command_line, "--weights", weights)
        assert (status, err) == (0, "")
    made_by = json.loads((out / "sightline.json").read_text())
    assert (made_by["method"], made_by["engine"]) == ("tiny", "torch")
    assert (tmp_path / "error" / "000001.png").stat().st_size > 0
    assert json.loads(report.read_text())["beams"]["8"]["coverage"] == 1
    tables = json.loads((tmp_path / "tables.json").read_text())
    assert tables["table_3"]["with"]["name"] == "tiny"
    assert tables["table_3"]["without"] is None


def test_old_names_of_papers_work_and_name_the_new_ones(capsys):
    for old, new, published in (
        ("dgfn", "gated-fusion", "98.69  90.31  82.16"),
        ("shiftconv", "shift-conv", "1,102.11"),
    ):
        status, out, err = run(capsys, "reproduce", old)
        assert (status, published in out) == (0, True)
        assert err == (
            f"sightline: warning: reproduce {old} is now reproduce {new}; the old name will be "
            "removed\n"
        )
        assert f"Old name of {new}" in run(capsys, "reproduce", "--help")[1]


def test_the_tasks_are_listed_with_all_that_belongs_to_them(capsys):
    status, out, _ = run(capsys, "tasks")
    assert status == 0
    listed = [line.strip() for line in out.splitlines()]
    assert listed[0].startswith("depth-completion: Complete the depth")
    assert "weights: depth-best (default), depth-fast-cpu, depth-image" in listed
    assert "outputs: depth, uncertainty" in listed
    assert listed[-1].startswith("engines: torch, onnxruntime")


def test_the_help_of_predict_names_the_tasks_own_methods_and_outputs(capsys):
    _, out, _ = run(capsys, "predict", "depth-completion", "--help")
    assert "--uncertainty UNCERTAINTY" in out
    assert "adaptive" in out


def test_a_frame_is_drawn_with_the_prediction_of_a_named_task(capsys, tmp_path):
    command_line = ["show", str(PACKAGED_FRAMES), "000000", "--task", "depth-completion"]
    out = tmp_path / "000000.png"
    status, _, _ = run(capsys, *command_line, "--method", "nearest", "--out", str(out))
    assert status == 0
    assert out.stat().st_size > 0
    status, _, err = run(capsys, *command_line[:-1], "tarot")
    assert (status, err.count("\n")) == (2, 1)
    assert "there is no task tarot; name one of depth-completion" in err


def test_a_method_and_weights_at_once_are_refused(capsys):
    command_line = ["evaluate", "held-out", str(PACKAGED_FRAMES), "--method", "linear"]
    status, _, err = run(capsys, *command_line, "--weights", "depth-best")
    assert status == 2
    assert "name one of them" in err
