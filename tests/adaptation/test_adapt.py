"""Adaptation to a small rig, from the sweep to the weights."""

import json
import shutil
from dataclasses import replace

import pytest
import yaml

from sightline.adaptation import adapt as adaptation
from sightline.adaptation.adapt import (
    FINE_TUNINGS,
    AdaptReport,
    AdaptSettings,
    _arguments,
    adapt,
)
from sightline.cli.main import main
from sightline.files.weights import read_weights
from sightline.joining.models import read_models
from sightline.simulation.generate import simulate
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.simulation.rigs import LidarRig, Rig, Rosette, named_rig
from sightline.simulation.settings import SimulationConfig
from sightline.tasks import PACKAGE_RECIPES
from sightline.training.command import run_training
from sightline.training.interruption import Interruption
from sightline.training.loader import NO_WORKERS_REMEDY
from tests.data.trees import write_depth_drive
from tests.joining.scenes import own_score_models

pytestmark = pytest.mark.filterwarnings("ignore:the rig is that of")

FIT_JOINED = adaptation._fit_joined
SMALL_CAMERA = replace(
    named_rig("robot-vlp16").camera, image_size=(240, 448), focal_px=280.0, principal_px=None
)
SMALL = AdaptSettings(tasks=("detection3d",), frames=4, validation_frames=1, steps=1, workers=1)


@pytest.fixture(scope="module", autouse=True)
def _nothing_joined():
    """Skip the fit of joined scores, which needs more boxes than the few frames here have."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(adaptation, "_fit_joined", lambda *_: None)
        yield


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A sweep of a rig with 16 rings and a small image."""
    lidar = replace(named_rig("robot-vlp16").lidar, azimuth_step_deg=0.4)
    rig = Rig(name="small", camera=SMALL_CAMERA, lidar=lidar)
    folder = tmp_path_factory.mktemp("recording") / "data"
    simulate(folder, frames=1, config=SimulationConfig(seed=7, rig=rig, camera=False), workers=1)
    return folder


@pytest.fixture(scope="module")
def adapted(recording, tmp_path_factory):
    out = tmp_path_factory.mktemp("adapted") / "out"
    return out, adapt(recording, out, SMALL)


def test_the_rig_is_simulated_and_the_shipped_weights_are_trained_on(adapted):
    out, report = adapted
    assert len(report.rig.lidar.elevations_deg) == 16
    assert len(list((out / "frames/training/image_2").iterdir())) == 5
    weights = read_weights(report.weights["detection3d"])
    shipped = read_weights("detection3d-best")
    assert weights.task == "detection3d"
    assert weights.tensors.keys() == shipped.tensors.keys()
    assert any(
        (weights.tensors[name] != shipped.tensors[name].float()).any() for name in shipped.tensors
    )


def test_scores_before_and_after_are_in_the_report(adapted):
    out, report = adapted
    content = json.loads((out / "adapt.json").read_text())
    for task in SMALL.tasks:
        scores = content["tasks"][task]
        assert scores["before"].keys() == scores["after"].keys()
        assert scores["is_better"] == report.is_better(task)
    assert report.table().row_count == 4


@pytest.mark.parametrize("task", FINE_TUNINGS)
def test_the_recipe_of_each_task_takes_the_settings_of_its_fine_tuning(task, tmp_path, capsys):
    rig = named_rig("livox-horizon")
    arguments = _arguments(task, tmp_path / "frames", tmp_path / "out", SMALL, rig)
    with pytest.raises(SystemExit) as end:
        run_training("fit", [*arguments, "--print_config"], PACKAGE_RECIPES)
    assert end.value.code in (None, 0)
    printed = yaml.safe_load(capsys.readouterr().out)
    optimizer = printed["model"]["init_args"]["optimizer"]
    assert optimizer["learning_rate"] == FINE_TUNINGS[task].learning_rate
    assert printed["data"]["init_args"]["root"] == str(tmp_path / "frames")
    assert printed["trainer"]["max_steps"] == SMALL.steps
    with_rings = _arguments(task, tmp_path, tmp_path / "out", SMALL, named_rig("robot-vlp16"))
    assert not any("faults" in each for each in with_rings)


def test_a_lidar_without_rings_is_adapted_to_without_faults_and_scores_of_rings(tmp_path):
    lidar = LidarRig(rosette=Rosette(width_deg=80.0, height_deg=25.0, points=20_000))
    rig = Rig(name="solid", camera=SMALL_CAMERA, lidar=lidar)
    config = SimulationConfig(seed=7, rig=rig, camera=False)
    simulate(tmp_path / "data", frames=1, config=config, workers=1)
    settings = replace(SMALL, tasks=("detection2d", "depth-completion"))
    out = tmp_path / "out"
    with pytest.warns(UserWarning, match="no rings are found"):
        report = adapt(tmp_path / "data", out, settings)
    assert report.weights.keys() == set(settings.tasks)
    trained = yaml.safe_load((out / "detection2d" / "config.yaml").read_text())
    assert trained["data"]["init_args"]["preparation"]["init_args"]["faults"] == []
    notes = json.loads((out / "adapt.json").read_text())["notes"]
    assert notes[1:] == [
        "detection2d is trained without lost rings: the LiDAR has none",
        "depth-completion is scored on simulated depth, not on held-out rings",
    ]
    assert report.table().caption == "\n".join(notes[1:])


def test_a_rig_is_measured_by_the_frames_that_have_sweeps(tmp_path):
    tree = shutil.copytree(PACKAGED_FRAMES, tmp_path / "tree")
    whole, _ = adaptation._rig(tree, tmp_path / "out", None)
    max((tree / "training" / "velodyne").iterdir()).unlink()
    rig, _ = adaptation._rig(tree, tmp_path / "out", None)
    assert rig.camera == whole.camera
    assert len(rig.lidar.elevations_deg) > 40
    write_depth_drive(tmp_path / "depth", tmp_path / "depth")
    with pytest.raises(ValueError, match=r"is a depth completion tree, .*: give sweeps"):
        adaptation._rig(tmp_path / "depth", tmp_path / "out", None)


def test_depth_is_scored_on_held_out_rings_where_they_are_in_view(adapted, tmp_path):
    out, report = adapted
    scoring = adaptation._depth_scoring(out / "frames", report.rig)
    assert scoring.name == "held-out rings"
    four = replace(report.rig.lidar, model=None, elevations_deg=(0.0, -2.0, -4.0, -6.0))
    rig = replace(report.rig, lidar=four)
    config = SimulationConfig(seed=7, rig=rig, camera=False)
    simulate(tmp_path, frames=2, validation_frames=1, config=config, workers=1)
    assert adaptation._depth_scoring(tmp_path, rig).name == "simulated depth in reach"


def test_finished_steps_are_not_repeated_and_other_settings_are_refused(
    adapted, recording, monkeypatch
):
    out, report = adapted
    monkeypatch.setattr("sightline.adaptation.adapt.run_training", None)
    monkeypatch.setattr("sightline.adaptation.adapt.run_bench", None)
    with pytest.warns(UserWarning, match=r"rig is that of .*rig.yaml \(measured from a recording"):
        again = adapt(recording, out, SMALL)
    assert again.to_json() == report.to_json()
    other = replace(SMALL, tasks=("depth-completion",))
    with pytest.raises(TypeError), pytest.warns(UserWarning, match="rig is that of"):
        adapt(recording, out, other)  # as nothing of this task is done
    copy = out.parent / "mine.yaml"
    copy.write_text((out / "rig.yaml").read_text())
    assert adapt(recording, out, SMALL, rig_file=copy).rig == report.rig
    with pytest.raises(ValueError, match="steps"):
        adapt(recording, out, replace(SMALL, steps=2))


def test_tasks_of_an_earlier_run_stay_in_the_report(adapted, recording, tmp_path, monkeypatch):
    out = tmp_path / "out"
    shutil.copytree(adapted[0], out)
    for name in ("before/detection3d", "after/detection3d", "detection3d"):
        shutil.copytree(out / name, out / name.replace("3d", "2d"))
    record = adapted[1].before["detection3d"]
    monkeypatch.setattr("sightline.adaptation.adapt._score", lambda *_: record)
    monkeypatch.setattr(AdaptReport, "to_json", lambda report: sorted(report.before))
    adapt(recording, out, replace(SMALL, tasks=("detection2d",)))
    assert json.loads((out / "adapt.json").read_text()) == ["detection2d", "detection3d"]
    (out / "detection3d" / "finished").unlink()
    adapt(recording, out, replace(SMALL, tasks=("detection2d",)))
    assert json.loads((out / "adapt.json").read_text()) == ["detection2d"]


def test_without_room_for_workers_the_advice_is_the_command_s_own(
    adapted, recording, tmp_path, monkeypatch
):
    def fail(_, arguments, __):
        workers = [each for each in arguments if each.startswith("--data.init_args.workers")]
        raise ChildProcessError(f"{workers[0]}: make /dev/shm larger or {NO_WORKERS_REMEDY}")

    shutil.copytree(adapted[0], tmp_path / "out")
    (tmp_path / "out" / "detection3d" / "finished").unlink()
    monkeypatch.setattr("sightline.adaptation.adapt.run_training", fail)
    for workers, loading in ((1, 0), (2, 1), (8, 1)):
        expected = rf"workers={loading}: make /dev/shm larger or give --workers 1$"
        with pytest.raises(ChildProcessError, match=expected):
            adapt(recording, tmp_path / "out", replace(SMALL, workers=workers))


def test_an_interruption_says_how_to_go_on(adapted, recording, monkeypatch):
    out, _ = adapted

    def interrupted(*_):
        raise Interruption("add --ckpt_path last", 15)

    monkeypatch.setattr("sightline.adaptation.adapt.run_training", interrupted)
    finished = out / "detection3d/finished"
    checksum = finished.read_text()
    finished.unlink()
    with pytest.raises(Interruption, match="run the same command again"):
        adapt(recording, out, SMALL)
    finished.write_text(checksum)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--tasks", "[tracking]"], "tasks must be some of"),
        (["--steps", "0"], "steps must be at least 1"),
        (["--frames", "3"], "frames must be at least 4"),
        (["--seed", "-1"], "seed must not be negative, got -1"),
        (["--frames", "1000000"], "a simulation has at most 1000000 frames"),
        (["--rig", "{folder}/narrow.yaml"], "so no command would read the data; choose a larger"),
        (["--device", "cuda"], "device cuda cannot be used (no GPU found); choose cpu"),
        (["--rig", "no.yaml"], "there is no file no.yaml"),
        (["--rig", "/"], "/ is a folder; give the file of a rig in YAML, such as a copy of OUT"),
    ],
)
def test_wrong_arguments_are_refused_before_the_work(
    recording, tmp_path, capsys, monkeypatch, arguments, message
):
    monkeypatch.setattr("torch.cuda.device_count", lambda: 0)
    camera = "{image_size: {width: 32, height: 32}, focal_px: 20000}"
    (tmp_path / "narrow.yaml").write_text(f"camera: {camera}\nlidar: {{model: vlp-16}}\n")
    out = tmp_path / "out"
    given = [each.format(folder=tmp_path) for each in arguments]
    assert main(["adapt", str(recording), str(out), *given]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_the_command_is_run_again_in_its_own_folder(recording, tmp_path, monkeypatch, capsys):
    def goes_on(*_, **__):
        raise ValueError("it goes on")

    monkeypatch.setattr("sightline.adaptation.adapt.adapt", goes_on)
    (tmp_path / "out" / "frames").mkdir(parents=True)
    assert main(["adapt", str(recording), str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err == "sightline: it goes on\n"


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda path: path.unlink(), "is absent, though its training has finished"),
        (lambda path: path.write_bytes(path.read_bytes()[:100]), "is not as its training wrote it"),
    ],
)
def test_weights_lost_or_changed_after_their_training_are_told(
    damage, told, recording, adapted, tmp_path
):
    out = tmp_path / "out"
    shutil.copytree(adapted[0], out)
    damage(out / "detection3d" / "weights.safetensors")
    with pytest.raises(ValueError, match=told):
        adapt(recording, out, SMALL)


def test_a_damaged_checkpoint_is_told_with_what_to_remove(recording, adapted, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(adapted[0], out)
    (out / "detection3d" / "finished").unlink()
    (out / "detection3d" / "last.ckpt").write_bytes(b"PK")
    said = rf"last.ckpt: cannot be read as .*\); remove {out / 'detection3d'}, and run it again"
    with pytest.raises(ValueError, match=said):
        adapt(recording, out, SMALL)


@pytest.mark.parametrize(("copied", "over"), [("before", "after"), ("after", "before")])
def test_scores_of_other_weights_are_told(copied, over, recording, adapted, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(adapted[0], out)
    shutil.rmtree(out / over)
    shutil.copytree(out / copied, out / over)
    with pytest.raises(ValueError, match=rf"{over}.*holds the scores of other weights than"):
        adapt(recording, out, SMALL)


def test_joined_scores_are_fitted_once_to_the_fine_tuned_detector_and_the_shipped_other_one(
    adapted, tmp_path, monkeypatch
):
    out, report = adapted
    fitted = []

    def fit(dataset, in_image, in_sweep, *, data, frames):
        fitted.append((len(dataset), data, frames))
        digests = {"detection2d": in_image.sha256, "detection3d": in_sweep.sha256}
        return own_score_models(
            {"sha256": digests, "weights": [in_image.name, in_sweep.name], "data": data}
        )

    monkeypatch.setattr(adaptation, "fit_pair", fit)
    path = tmp_path / "joined.json"
    for _ in range(2):
        assert FIT_JOINED(report.weights, out / "frames", path) == path
    assert fitted == [(1, "out/frames", 40)]
    path.write_text("damaged")
    assert FIT_JOINED(report.weights, out / "frames", path) == path
    assert len(fitted) == 2
    models = read_models(path)
    assert models.provenance["weights"] == ["detection2d-best", "weights"]
    assert FIT_JOINED({"depth-completion": path}, out / "frames", path) is None


def test_too_few_boxes_for_joined_scores_are_told(adapted, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise ValueError("no box of class Car")

    monkeypatch.setattr(adaptation, "fit_pair", fail)
    out, report = adapted
    with pytest.warns(UserWarning, match="objects of these detectors cannot be joined: no box of"):
        assert FIT_JOINED(report.weights, out / "frames", tmp_path / "joined.json") is None
    assert not (tmp_path / "joined.json").exists()
