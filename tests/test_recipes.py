"""Every recipe trains: two steps on small frames, in the layout that the recipe expects."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from sightline.cli.main import main
from sightline.data.formats.image_file import read_rgb, write_rgb
from sightline.data.formats.map_png import write_depth_png
from sightline.data.open import open_dataset
from sightline.files.weights import read_weights
from sightline.files.weights_header import find_weights, shipped_names
from sightline.geometry.projection import sparse_depth_map
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.tasks import PACKAGE_RECIPES, find_task, recipes_of, task_names
from tests.small_frames import write_small_frames

RECIPES = sorted(path.stem for path in PACKAGE_RECIPES.glob("*.yaml"))
DRIVE = "2011_09_26_drive_0001_sync"
SMALL = (
    "--data.init_args.batch_size=2",
    "--data.init_args.workers=0",
    "--trainer.max_steps=2",
    "--trainer.limit_val_batches=1",
    "--trainer.enable_progress_bar=false",
    "--trainer.accelerator=cpu",
)
NARROW_TRUNK = tuple(
    f"--model.init_args.network.trunk.{setting}"
    for setting in ("modules=1", "channels=[8,8,16,16]")
)


def test_recipes_of_papers_keep_the_last_weights_as_their_validation_list_is_the_test_list():
    for name in RECIPES:
        settings = yaml.safe_load((PACKAGE_RECIPES / f"{name}.yaml").read_text())
        if name.endswith("-kitti"):
            data = settings["data"]["init_args"]
            assert data["validation"] == data["test"]
            assert settings["keep_last_weights"] is True


def as_street(root):
    """Completes an object tree as `sightline simulate --preset street-2k` lays it out.

    Recipes of several presets find it by their names, too.
    """
    shutil.copytree(root / "training" / "velodyne", root / "training" / "velodyne_reduced")
    (root / "ImageSets").mkdir(exist_ok=True)
    for name in ("train", "val"):
        (root / "ImageSets" / f"{name}.txt").write_text("000000\n000001\n")
    for name in ("street-8k", "street-rigs-8k"):
        (root / name).symlink_to(root, target_is_directory=True)
    return root


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """The small frames as a simulated street."""
    return as_street(write_small_frames(tmp_path_factory.mktemp("street")))


@pytest.fixture(scope="module")
def whole_street(tmp_path_factory):
    """The embedded frames as they are, for DGFN's maps and the recipes' own crops."""
    root = tmp_path_factory.mktemp("whole_street")
    return as_street(shutil.copytree(PACKAGED_FRAMES, root, dirs_exist_ok=True))


@pytest.fixture(scope="module")
def benchmark_tree(tmp_path_factory, street):
    """The small frames as KITTI's depth completion benchmark."""
    root = tmp_path_factory.mktemp("benchmark")
    dataset = open_dataset(street, parts={"image", "points", "depth"})
    selection = root / "depth_selection" / "val_selection_cropped"
    day = root / DRIVE[:10]
    for number in range(len(dataset)):
        sample = dataset[number]
        sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size).numpy()
        picture = street / "training" / "image_2" / f"{sample.sample_id}.png"
        frame = f"{number:010}.png"
        maps = root / "train" / DRIVE / "proj_depth"
        write_depth_png(maps / "velodyne_raw" / "image_02" / frame, sparse)
        write_depth_png(maps / "groundtruth" / "image_02" / frame, sample.depth.numpy())
        copy(picture, day / DRIVE / "image_02" / "data" / frame)
        kind = f"{DRIVE}_%s_{number:010}_image_02"
        write_depth_png(selection / "velodyne_raw" / f"{kind % 'velodyne_raw'}.png", sparse)
        truth = selection / "groundtruth_depth" / f"{kind % 'groundtruth_depth'}.png"
        write_depth_png(truth, sample.depth.numpy())
        copy(picture, selection / "image" / f"{kind % 'image'}.png")
        intrinsics = " ".join(
            str(value) for value in sample.calibration.image_from_camera[:, :3].flatten().tolist()
        )
        (selection / "intrinsics").mkdir(exist_ok=True)
        (selection / "intrinsics" / f"{kind % 'image'}.txt").write_text(intrinsics)
    numbers = " ".join(
        str(value) for value in sample.calibration.image_from_camera.flatten().tolist()
    )
    (day / "calib_cam_to_cam.txt").write_text(f"P_rect_02: {numbers}\nP_rect_03: {numbers}\n")
    return root


def copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(source, target)


def test_every_recipe_is_of_one_task():
    recipes = [recipe for name in task_names() for recipe in recipes_of(find_task(name))]
    assert sorted(recipes) == RECIPES
    assert {"depth-shiftconv-kitti", "depth-best", "depth-fast-cpu"} <= set(RECIPES)


@pytest.mark.parametrize(
    ("name", "recipe"),
    [(name, recipe) for name in task_names() for recipe in recipes_of(find_task(name))],
)
def test_a_recipe_trains_and_its_weights_answer(
    name, recipe, street, whole_street, benchmark_tree, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    task = find_task(name)
    frames = whole_street if "dgfn" in recipe else street
    is_of_benchmark = name == "depth-completion" and recipe.endswith("-kitti")
    root = benchmark_tree if is_of_benchmark else frames
    small = (*SMALL, *(f"--{flag}={value}" for flag, value in task.trial_settings.items()))
    given = yaml.safe_load((PACKAGE_RECIPES / f"{recipe}.yaml").read_text())["model"]["init_args"]
    if "initial_weights" in given:  # of a first stage: the weights that come with Sightline
        begun = recipe.removesuffix("-finetune").removesuffix("-further")
        if given["initial_weights"] in shipped_names():
            begun = given["initial_weights"]
            small = tuple(flag for flag in small if ".network." not in flag)  # of these weights
        small = (*small, f"--model.init_args.initial_weights={begun}")
    if "shiftconv" in recipe:  # takes ten seconds at its width
        small = (*small, *NARROW_TRUNK)
    status = main(["fit", "--config", recipe, f"--data.init_args.root={root}", *small])
    assert status == 0, capfd.readouterr().err
    run = tmp_path / "runs" / recipe
    weights = read_weights(run / "weights.safetensors")
    assert weights.task == name
    assert all(tensor.isfinite().all() for tensor in weights.tensors.values())
    network = given["network"] if "network" in given else read_weights(begun).config
    changed = {flag.rsplit(".", 1)[1] for flag in task.trial_settings}
    assert (
        json.loads(json.dumps(weights.config)).items()
        >= {
            name: value
            for name, value in network.items()
            if not (isinstance(value, dict) or name in changed)
        }.items()
    )
    out = tmp_path / "out"
    command = ["predict", name, str(frames), str(out), "--workers", "1"]
    assert main([*command, "--weights", str(run / "weights.safetensors")]) == 0
    assert len(list(out.glob(f"*{task.outputs[0].suffix}"))) == 2


@pytest.mark.parametrize("name", shipped_names())
def test_shipped_weights_fit_the_recipe_of_their_name_and_the_tuned_ones_are_scored(
    name, whole_street, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    tuned = ["--config", name, f"--data.init_args.root={whole_street}", *SMALL]
    tuned += ["--model.init_args.initial_weights", name]
    for subcommand in ("fit", "test"):
        assert main([subcommand, *tuned]) == 0, capfd.readouterr().err
    report = json.loads(Path("runs", name, "test.json").read_text())
    assert Path(report["checkpoint"]).parent == Path("runs", name)
    assert report["initial_weights"] == name
    assert any(value is not None for value in report["metrics"].values())


def test_a_run_goes_on_without_the_streams_that_it_was_begun_from(
    whole_street, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    camera = tmp_path / "camera.safetensors"
    shutil.copy(find_weights("detection2d-fast-cpu"), camera)
    run = [
        "fit",
        "--config",
        "detection2d-fast-cpu",
        f"--data.init_args.root={whole_street}",
        *SMALL,
    ]
    run += ["--model.init_args.initial_streams", json.dumps({"camera": str(camera)})]
    assert main(run) == 0, capfd.readouterr().err
    camera.unlink()
    assert main([*run, "--ckpt_path", "last"]) == 0, capfd.readouterr().err
    assert main([*run, "--run_folder", "other"]) == 2
    assert f"there are no weights '{camera}'" in capfd.readouterr().err


def test_what_the_simulator_writes_trains_without_a_word_on_sweeps_and_lists(
    tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    street = tmp_path / "street"
    shutil.copytree(PACKAGED_FRAMES, street)  # whole sweeps, and a list of training frames alone
    names = [f"{number:06}" for number in range(4)]
    (street / "ImageSets" / "train.txt").write_text("\n".join(names))
    for path in (street / "training").glob("*/00000[01].*"):
        number = int(path.stem) + 2
        other = Path(shutil.copy(path, path.with_name(f"{number:06}{path.suffix}")))
        if other.suffix == ".bin":  # one point less: another cloud
            other.write_bytes(other.read_bytes()[:-16])
        if other.parent.name == "image_2":
            write_rgb(other, np.ascontiguousarray(read_rgb(other)[:, ::-1]))
    run = ["fit", "--config", "depth-fast-cpu", "--data.init_args.root", "street", *SMALL]
    assert main(run) == 0, capfd.readouterr().err
    assert (tmp_path / "runs" / "depth-fast-cpu" / "best.ckpt").is_file()


@pytest.mark.parametrize("data", ["street", "kitti"])
def test_the_ablation_differs_in_the_shift_convolution_only(data):
    whole, without = (recipe(f"depth-{name}-{data}") for name in ("shiftconv", "without-shiftconv"))
    assert without["model"]["init_args"].pop("network") == {"shift_conv": None}
    assert whole["model"]["init_args"].pop("network") == {}
    assert whole == without


def recipe(name):
    return yaml.safe_load((PACKAGE_RECIPES / f"{name}.yaml").read_text())


def test_the_small_depth_network_is_depth_best_with_fewer_channels():
    small, best = (recipe(name)["model"]["init_args"] for name in ("depth-fast-cpu", "depth-best"))
    changed = {name for name in best["network"] if small["network"][name] != best["network"][name]}
    sizes = {"stem_channels", "refinement_channels", "refinement_hidden_channels", "trunk"}
    assert changed == sizes
    assert small | {"network": None} == best | {"network": None}
    preparation = recipe("depth-fast-cpu")["data"]["init_args"]["preparation"]
    assert preparation == recipe("depth-best-further")["data"]["init_args"]["preparation"]


@pytest.mark.parametrize("name", ["depth-best", "depth-fast-cpu"])
def test_shipped_depth_weights_have_the_settings_of_their_recipe(name):
    network = recipe(name)["model"]["init_args"]["network"]
    config = read_weights(name).config
    trunk = network.pop("trunk")
    assert config["trunk"] | trunk == config["trunk"]
    assert config | network == config


def test_fine_tuning_starts_from_the_shipped_network():
    tuned = recipe("depth-best-finetune")["model"]["init_args"]
    assert tuned["initial_weights"] == "depth-best"
    assert "network" not in tuned


@pytest.mark.parametrize("name", ["depth-fast-cpu", "detection2d-fast-cpu", "detection3d-fast-cpu"])
def test_a_recipe_without_a_network_takes_that_of_its_weights(
    name, whole_street, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    tuned = ["--config", name, f"--data.init_args.root={whole_street}", *SMALL]
    tuned += ["--model.init_args.initial_weights", name, "--model.init_args.network", "null"]
    assert main(["fit", *tuned]) == 0
    written = read_weights(Path("runs", name, "weights.safetensors"))
    assert written.tensors.keys() == read_weights(name).tensors.keys()
