"""A whole task that the package knows by one line of the registry, of a new kind of prediction."""

import json
import logging
import os
import re
import shutil
import signal
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from lightning.pytorch.callbacks import Callback

from sightline import tasks
from sightline.cli.main import main
from sightline.data.formats.image_file import read_rgb
from sightline.data.open import open_dataset
from sightline.export.engines import open_engine
from sightline.files.weights import read_weights
from sightline.perception.perceive import perceive
from sightline.perception.perceiver import MultiTaskPredictor
from sightline.structures.batch import concatenate
from sightline.training.data import CameraLidarData, SourceConfig
from sightline.training.quiet import LIGHTNING_NOISE
from sightline.visualization.frame_row import RowLayout
from tests import toy_task
from tests.data.trees import LABELS, write_object_tree
from tests.toy_task.cells import read_cells
from tests.toy_task.examples import FinderExamples

pytestmark = [
    *(pytest.mark.filterwarnings(f"ignore:{beginning}") for beginning in LIGHTNING_NOISE),
    pytest.mark.filterwarnings("ignore:This process:DeprecationWarning"),  # forks, threads around
]
RECIPE = Path(toy_task.__file__).parent / "recipe.yaml"
NAMES = tuple(f"{number:06}" for number in range(5))
CARS = (2, 0, 1, 3, 1)  # of each frame


class PressCtrlC(Callback):
    """Does so in the third step."""

    def on_train_batch_start(self, trainer, *_):
        if trainer.global_step == 2:
            os.kill(os.getpid(), signal.SIGINT)


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    root = write_object_tree(tmp_path_factory.mktemp("frames"), *NAMES)
    car, other = LABELS.splitlines()
    # Where its 3D box is seen, and hidden from the cloud, which has no point there.
    car = car.replace("5.00 3.00 20.00 9.00", "18.87 5.64 22.06 8.69").replace("0.10 0", "0.10 2")
    for name, cars in zip(NAMES, CARS, strict=True):
        # Not two equal lines.
        shown = [car.replace("18.87", f"{18.87 - number / 100:.2f}") for number in range(cars)]
        lines = "\n".join([*shown, other])
        (root / "training" / "label_2" / f"{name}.txt").write_text(lines)
    return root


@pytest.fixture(scope="module", autouse=True)
def _registered():
    """The one line."""
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(tasks.REGISTRY, "toy-finder", "tests.toy_task.registration:TASK")
        yield


@pytest.fixture(scope="module")
def trained(frames, tmp_path_factory):
    """The folder of a run."""
    run = tmp_path_factory.mktemp("runs") / "run"
    assert fit(frames, run) == 0
    return run


def fit(frames, run, *flags):
    given = ["--data.init_args.root", str(frames), "--run_folder", str(run)]
    previous = signal.getsignal(signal.SIGINT)
    try:
        return main(["fit", "--config", str(RECIPE), *given, *flags])
    finally:
        signal.signal(signal.SIGINT, previous)


def test_its_batches_hold_truth_of_as_many_objects_as_each_frame_has(frames):
    examples = FinderExamples(crop_size=(12, 40))
    sources = (SourceConfig(path=Path()),)
    data = CameraLidarData(examples, root=frames, validation=sources, validation_batch_size=5,
                           workers=0)  # fmt: skip
    (batch,) = data.val_dataloader()
    assert batch.sample_ids == NAMES
    assert tuple(map(len, batch.boxes)) == CARS
    assert batch.image.shape == (5, 3, 12, 40)
    assert tuple(map(len, concatenate([batch, batch]).boxes)) == CARS * 2


def test_it_trains_validates_and_leaves_weights_of_its_own(frames, trained, capsys):
    weights = read_weights(trained / "weights.safetensors")
    assert (weights.task, weights.config) == ("toy-finder", {"channels": 3, "cell_px": 4})
    assert float(weights.provenance["validation/wrong_share"]) <= 1
    assert main(["validate", "--config", str(RECIPE), "--data.init_args.root", str(frames),
                 "--run_folder", str(trained)]) == 0  # fmt: skip
    report = json.loads((trained / "validate.json").read_text())
    assert report["metrics"].keys() == {"validation/wrong_share"}
    assert "validation/wrong_share" in capsys.readouterr().out


def test_it_resumes_exactly(frames, trained, tmp_path):
    run = tmp_path / "run"
    press = "--trainer.callbacks+=tests.test_toy_task.PressCtrlC"
    assert fit(frames, run, press) == 130
    assert fit(frames, run, "--ckpt_path", "last") == 0
    parts, whole = (read_weights(folder / "last.ckpt").tensors for folder in (run, trained))
    assert all(torch.equal(parts[name], whole[name]) for name in whole)


@pytest.mark.parametrize("engine", ["torch", "onnxruntime", "openvino"])
def test_it_answers_into_files_and_a_further_output(frames, trained, tmp_path, engine):
    out, further = tmp_path / "results", tmp_path / "highest"
    command = ["predict", "toy-finder", str(frames), str(out), "--highest", str(further)]
    command += ["--weights", str(trained / "weights.safetensors"), "--engine", engine]
    assert main([*command, "--workers", "2" if engine == "torch" else "1"]) == 0
    assert sorted(path.stem for path in out.glob("*.npy")) == list(NAMES)
    assert sorted(path.stem for path in further.glob("*.json") if path.stem in NAMES) == list(NAMES)
    cells = read_cells(out / "000000.npy")
    assert ((cells.likelihood > 0) & (cells.likelihood < 1)).all()
    assert json.loads((further / "000000.json").read_text()) == cells.to_json()
    assert json.loads((further / "sightline.json").read_text())["output"] == "highest"


@pytest.fixture
def perceiver(trained):
    """The toy task beside another one."""
    weights = {"toy-finder": str(trained / "weights.safetensors"), "depth-completion": "nearest",
               "detection2d": "none", "detection3d": "none"}  # fmt: skip
    return MultiTaskPredictor.load(weights, engine="torch")


@pytest.mark.filterwarnings("ignore:.*there are no point clouds for 1 of 5 frames")
def test_a_line_a_video_and_a_viewer_file_hold_its_prediction(frames, perceiver, tmp_path):
    frames = shutil.copytree(frames, tmp_path / "frames")
    (frames / "training" / "velodyne" / "000004.bin").unlink()
    out, video = tmp_path / "out", tmp_path / "drive.mp4"
    perceive(frames, out, perceiver=perceiver, video=video, rerun=tmp_path / "drive.rrd")
    lines = [json.loads(line) for line in (out / "perception.jsonl").read_text().splitlines()]
    sample = open_dataset(frames)[0]
    assert lines[0]["likely_cells"] == perceiver(sample).further["likely_cells"].to_json()
    assert (lines[0]["detections2d"], lines[4]["likely_cells"]) == (None, None)
    capture = cv2.VideoCapture(str(video))
    shown = (
        int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
    )
    assert shown == RowLayout.of(sample.image_size, ("likely_cells",)).size
    assert perceive(frames, out, perceiver=perceiver).skipped == len(NAMES)


def test_pages_of_one_frame_and_of_two_have_a_panel_for_it(frames, perceiver, tmp_path):
    out = tmp_path / "out"
    perceive(frames, out, perceiver=perceiver)
    for names in (NAMES[:1], NAMES[:2]):
        pages = []
        for results in (out, out / "depth-completion"):
            page = tmp_path / "page.png"
            assert (
                main(["show", str(frames), *names, "--results", str(results), "--out", str(page)])
                == 0
            )
            pages.append(read_rgb(page))
        assert pages[0].shape[0] > pages[1].shape[0]


def test_its_answers_do_not_depend_on_the_engine(frames, trained):
    task = tasks.find_task("toy-finder")
    weights = trained / "weights.safetensors"
    sample = open_dataset(frames)[0]
    likely = [
        task.predictor(weights=weights, engine=engine)(sample).likelihood
        for engine in ("torch", "onnxruntime", "openvino")
    ]
    for other in likely[1:]:
        torch.testing.assert_close(other, likely[0], rtol=0, atol=1e-5)


def test_the_bench_scores_it_with_broken_sensors(frames, trained, tmp_path):
    out = tmp_path / "run"
    command = ["robustness", "--task", "toy-finder", "--data", str(frames), str(out)]
    command += ["--weights", str(trained / "weights.safetensors"), "--workers", "1"]
    assert main([*command, "--cases", "camera_blank", "lidar_blank"]) == 0
    told = json.loads((out / "robustness.json").read_text())
    assert list(told["scores"]) == ["clean", "camera_blank", "lidar_blank"]
    assert told["scores"]["clean"].keys() == {each["name"] for each in told["figures"]}
    assert sorted(path.stem for path in (out / "answers" / "clean").iterdir()) == list(NAMES)


def test_it_is_exported_as_two_graphs(trained, tmp_path, capsys):
    out = tmp_path / "out" / "finder.onnx"
    weights = str(trained / "weights.safetensors")
    assert main(["export", str(out), "--weights", weights]) == 0
    files = [out.with_stem("finder-features"), out.with_stem("finder-likelihood")]
    assert sorted(out.parent.iterdir()) == files
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == f"toy-finder by {weights}"
    assert [line for line in printed if line.endswith(".onnx")] == [str(path) for path in files]
    first, second = map(open_engine, files)
    assert (first.metadata.task, first.metadata.stride) == ("toy-finder", 4)
    features = first({"image": torch.rand(1, 3, 8, 12), "sparse_depth_m": torch.rand(1, 1, 8, 12)})
    assert second({"features": features["output"]})["logits"].shape == (1, 1, 2, 3)


def test_it_draws_a_frame_by_its_weights_alone(frames, trained, tmp_path):
    out = tmp_path / "000000.png"
    weights = str(trained / "weights.safetensors")
    assert main(["show", str(frames), "000000", "--weights", weights, "--out", str(out)]) == 0
    with_answer = read_rgb(out)
    assert main(["show", str(frames), "000000", "--method", "nearest", "--out", str(out)]) == 0
    assert not np.array_equal(with_answer, read_rgb(out))


def test_it_is_listed_and_explains_itself(capsys):
    assert main(["tasks"]) == 0
    listed = capsys.readouterr().out
    assert "toy-finder: Finds image cells" in listed
    with pytest.raises(SystemExit):
        main(["predict", "toy-finder", "--help"])
    explained = capsys.readouterr().out
    assert "--highest HIGHEST" in explained
    assert "--method" not in explained


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "needs a network: give its weights"),
        (["--weights", "depth-best"], "holds weights for depth-completion, expected toy-finder"),
    ],
)
def test_what_it_cannot_answer_by_is_refused_in_one_line(frames, tmp_path, capsys, arguments, said):
    assert main(["predict", "toy-finder", str(frames), str(tmp_path / "out"), *arguments]) == 2
    err = capsys.readouterr().err
    assert re.search(said, err)
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()
