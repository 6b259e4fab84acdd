"""Arguments of wrong types, as users give them, who have no type checker running: one line each."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

_CASES = {
    'sample(image_size=(370.0, 1220.0))': "image_size is (370.0, 1220.0), expected (height, width)",
    'sample(image_size=(1, 2, 3))': "image_size is (1, 2, 3), expected (height, width)",
    'sample(lidar_height_m="2")': "lidar_height_m is '2', expected a number",
    'sample(lidar_height_m=np.zeros(2))': "lidar_height_m is array([0., 0.]), expected a number",
    'sample(max_intensity="255")': "max_intensity is '255', expected a number",
    'sightline.write_rgb("a.png", given.image)': "is torch.uint8 of shape (3, 375, 1242), expected",
    'sightline.write_rgb("a.png", np.zeros((4, 4), np.uint8))': "is uint8 of shape (4, 4), expec",
    'sightline.write_rgb("a.png", [[[1, 2, 3]]])': "the picture is list, expected a uint8 array",
    'sightline.frame_sheet(given, detections2d=[1])': "is a list, expected Detections2D; of",
    'perceiver("depth-best")': "weights is of type str, expected a dictionary",
    'perceiver({"detection2d": "detection2d-fast-cpu"}, threads="2")': "at least 1, got '2'",
    'perceiver({"detection2d": "detection2d-fast-cpu"}, threads=0)': "at least 1, got 0",
    'given.calibration.crop("1", 2)': "Calibration.crop: x_min is of type str, expected int",
    'given == None': "False",
    'sightline.project_points(torch.tensor([[10, 1, -1]]), given.calibration).pixels.tolist()':
        "[[539.8611",
    'unproject_pixels(torch.tensor([[600, 200]]), torch.tensor([5.0]), given.calibration).tolist()':
        "[[5.2672",
    'given == sightline.open_dataset(PACKAGED_FRAMES)[0]': "True",
    'given == sightline.open_dataset(PACKAGED_FRAMES)[1]': "False",
    'len({given, sightline.open_dataset(PACKAGED_FRAMES)[0]})': "1",
    'list(sightline.check_tree(5))': "check_tree: root is of type int, expected Path or str",
    'sightline.open_dataset(PACKAGED_FRAMES, sample_list=[1])': "holds 1, expected text such as",
    'sightline.open_dataset(PACKAGED_FRAMES, velodyne="velodyne_reducd")':
        "open_dataset: velodyne must be one of velodyne, velodyne_reduced, None, got "
        "'velodyne_reducd'; perhaps velodyne_reduced",
    'sample(all_around="no")': "from_arrays: all_around is of type str, expected True or False",
    'sample(points=[np.array(given.points)] * 2)':
        "(2, 18472, 4) are 2 clouds, expected one; give one cloud at a time",
    'repr(sample(all_around=np.True_).all_around) + "!"': "True!",
    'sightline.perceive(PACKAGED_FRAMES, "")': "perceive: out is an empty text, expected a path",
    'sightline.perceive(PACKAGED_FRAMES, "~/out")':
        "perceive: out is '~/out', where ~ is a folder of that name, not the home folder; write",
    'sightline.open_dataset(Path("~"))': "open_dataset: path is '~', where ~ is a folder of that",
    'sightline.write_rgb("~/a.png", np.array(picture))': "write_rgb: path is '~/a.png', where ~ is",
    'write_image("~/a.png", given.image)': "write_image: path is '~/a.png', where ~ is a folder of",
    'kitti_files.write_points("~/a.bin", given.points)': "write_points: path is '~/a.bin', where ~",
    'map_png.write_mask_png("~/a.png", np.eye(3) > 0)': "write_mask_png: path is '~/a.png', where",
    'sightline.open_dataset("~a")': "~a: does not exist",
    'sightline.perceive(PACKAGED_FRAMES, "out", workers=1.5)':
        "perceive: workers must be a whole number, got 1.5",
    'sightline.perceive(PACKAGED_FRAMES, "out", workers=float("nan"))':
        "perceive: workers must be a whole number, got nan",
    'sightline.perceive(PACKAGED_FRAMES, "out", fps=-1)': "--fps has no effect without --video",
    'sightline.perceive(PACKAGED_FRAMES, "out", perceiver=predictor("detection2d"), around=True)':
        "--around has no effect without 3D detection",
    'sightline.MultiTaskPredictor({"detection3d": sightline.load("detection2d-fast-cpu")})':
        "detection2d-fast-cpu is of task detection2d, not detection3d",
    'sightline.load("joined").aligned("data")':
        "JoinedPredictor.aligned: samples is of type str, expected Sequence[CameraLidarSample]",
    'perceiver(one).aligned(given for _ in range(2))':
        "MultiTaskPredictor.aligned: samples is of type generator, expected Sequence[CameraLidarSa",
    'perceiver(one).aligned("drive")':
        "MultiTaskPredictor.aligned: samples is of type str, expected Sequence[CameraLidarSample]",
    'perceiver(one).predict([given])':
        "MultiTaskPredictor.predict: sample is of type list, expected CameraLidarSample",
    'perceiver(one).predict_by_task([given])':
        "predict_by_task: sample is of type list, expected CameraLidarSample",
    'sightline.load("joined").predict([given])':
        "JoinedPredictor.predict: sample is of type list, expected CameraLidarSample",
    'sightline.load("detection3d-fast-cpu").refine_boxes(given, np.zeros((1, 7)))':
        "refine_boxes: boxes is of type numpy.ndarray, expected Detections3D",
    'sightline.load("detection3d-fast-cpu").propose([given])':
        "propose: sample is of type list, expected CameraLidarSample",
    'sightline.load("detection3d-fast-cpu").both_stages([given])':
        "both_stages: sample is of type list, expected CameraLidarSample",
    'sightline.load("detection2d-fast-cpu", engine=5)': "load: engine is of type int, expected",
    'sightline.evaluate_realism(PACKAGED_FRAMES, None, real_labels="labels")':
        "--real-labels has no effect without real data",
    'predict("detection2d", sightline.load("detection2d-fast-cpu"), PACKAGED_FRAMES, Path("out"))':
        "predict: task is of type str, expected PredictingTask",
    'predict(DETECTION2D, sightline.load("detection2d-fast-cpu"), PACKAGED_FRAMES, "out")':
        "predict: out is of type str, expected Path",
    'predict(DETECTION2D, sightline.load("detection2d-fast-cpu"), 5, Path("out"))':
        "predict: data is of type int, expected Path",
    'predict_shards("detection2d", sightline.load("detection2d-fast-cpu"), Path("a"), Path("b"))':
        "predict_shards: task is of type str, expected PredictingTask",
    'sightline.MultiTaskPredictor({"detection2d": lambda _: 0})':
        "the predictor is the function <lambda>, expected an object of sightline.inference",
    'sightline.evaluate_realism(PACKAGED_FRAMES, None, max_frames=0)': "must be at least 1, got",
    "sightline.evaluate_held_out([given], lambda _: 0)":
        "the method's prediction is of type int, expected DepthMap",
    'sightline.load("detection2d-fast-cpu").predict([given])':
        ".predict: sample is of type list, expected CameraLidarSample",
    'sightline.evaluate_held_out(sightline.open_dataset(PACKAGED_FRAMES), predictor, beams=16)':
        "evaluate_held_out: beams is of type int, expected Sequence[int] or None",
    'sightline.evaluate_held_out([given], predictor, truth="depth")':
        "no depth map to be scored on; open the data set with its depth maps (parts)",
    'sightline.evaluate_held_out([given], predictor, crop_size=(1216, 352))':
        "crop_size is (1216, 352), taller than wide: give height, width, such as (352, 1216)",
    'sightline.evaluate_held_out([given], predictor, crop_size=(0, 352))':
        "crop_size is (0, 352), expected (height, width)",
    'sample(image=picture.convert("P"))': "a Pillow image of mode P, expected RGB; give image.con",
    'sample(image=picture.convert("HSV"))': "a Pillow image of mode HSV, expected RGB; give image",
    'sample(image=picture).image_size': "(375, 1242)",
    'sightline.evaluate_objects(*scored(), by_distance=np.array([9.0, 30.0])).bands[1].from_m':
        "9.0",
    'sightline.evaluate_proposals(*scored(), ious=np.array([0.5, 0.7])).frames': "2",
    'HealthMonitor("limits.json")': "limits is of type str, expected HealthLimits; read a file",
    'corrupt_arrays("lidar_blank", 3, image=np.array(picture))':
        "lidar_blank breaks the lidar, which has no points here; give points",
    'corrupt_arrays("camera_blank+lidar_blank", 1, points=given.points)':
        "camera_blank+lidar_blank breaks the camera, which has no image here; give image",
    'sightline.write_rgb("a.png", np.zeros((4, 4, 3)))': "(255 * image).round().clip(0, 255)",
    'write_image("a.png", given.image.permute(1, 2, 0))': "give image.permute(2, 0, 1)",
    'sightline.undistort(given.image, np.eye(3), [0] * 5)':
        "give np.asarray(image).transpose(1, 2, 0)",
    'sightline.perceive(PACKAGED_FRAMES, "out", align="no")': "align is of type str, expected True",
    'sightline.perceive(PACKAGED_FRAMES, "out", around="auto")':
        "perceive: around is of type str, expected True or False or None",
    'sightline.project_points(given.points[:, :3].T, given.calibration)':
        "expected num_points, 3; give one row per point: points.mT",
    'sightline.project_points(given.points, given.calibration)': "per point: points[..., :3]",
    'sightline.sparse_depth_map(given.points[None], given.calibration, given.image_size)':
        "expected num_points, 3 or more; give one sweep after another",
    'HealthMonitor()([given])':
        "judge: sample is of type list, expected CameraLidarSample",
    'DriveMonitor()(given.image)': "sample is of type torch.Tensor, expected CameraLidarSample",
    'DriveMonitor(HealthMonitor().limits)': "HealthLimits, expected HealthMonitor; make one by Hea",
    'DriveMonitor(None, 3)': "config is of type int, expected HysteresisConfig",
    'draw_birds_eye(given.points.numpy())': "num_points fields'] or None; give torch.from_numpy(ar",
    'draw_birds_eye(torch.from_numpy(given.points.numpy())).shape': "(1120, 616, 3)",
    'colorize_depth(np.zeros((4, 4)))':
        "colorize_depth: depth_m is of type numpy.ndarray, expected Float[Tensor, 'height width']; "
        "give torch.from_numpy(array)",
    'draw_boxes2d(given.image, given.objects.boxes2d, given.objects.class_names)':
        "expected UInt8[ndarray, 'height width 3']; give tensor.numpy(force=True)",
    'write_image("a.png", np.array(picture))':
        "expected UInt8[Tensor, '3 height width']; give torch.from_numpy(array)",
    'draw_depth(given.points)': "draw_depth: depth is of type torch.Tensor, expected DepthMap",
    'colorize_error(torch.ones(5, 5), torch.ones(4, 5))':
        "predicted_m is of shape (5, 5), truth_m of (4, 5); give maps of one image",
    'draw_boxes2d(np.array(picture) / 255, given.objects.boxes2d, given.objects.class_names)':
        "picture is float64 of shape (375, 1242, 3), expected uint8 of height, width, 3; round it",
    'draw_boxes3d(given.image.numpy(), *objects, given.calibration)':
        "picture is uint8 of shape (3, 375, 1242), expected uint8 of height, width, 3; it has chan",
    'draw_points(np.array(picture)[..., 0], given.points, given.calibration)':
        "picture is uint8 of shape (375, 1242), expected uint8 of height, width, 3; convert it to",
    'draw_boxes3d(np.array(picture), *objects, given.calibration, scores=torch.ones(3))':
        "boxes cannot be drawn with 3 scores; give one for each box",
    'find_kind(None)': "find_kind: name is of type NoneType, expected str",
    'faults.TurnedLidar(yaw_deg="1")': "TurnedLidar: yaw_deg is of type str, expected float",
    'faults.TurnedLidar(yaw_deg=np.float32(1)).yaw_deg == 1': "True",
    'faults.FewerRings(keep_every=2.5)': "FewerRings: keep_every must be a whole number, got 2.5",
    'faults.FalseEchoes(share="1")': "FalseEchoes: share is of type str, expected float",
    'faults.NoCamera()(0, None)': "drop_camera: sample is of type int, expected CameraLidarSample",
    'faults.fault_rng("000008")': "fault_rng: sample is of type str, expected CameraLidarSample",
    'suites.CameraBlank().corrupt("000008", None)': "corrupt: sample is of type str, expected Came",
    'CameraFramesLost(chance="1")': "chance is of type str, expected a number or a tuple of n",
    'complete_depth(np.zeros((9, 9)), "linear")':
        "the sparse depth map is float64 of shape (9, 9), expected float32 of height, width; give",
    'complete_depth(torch.zeros(9, 9, dtype=torch.double), "adaptive")': "map is float64 of shape",
    'suites.Case(name="a", title="", corruption="camera_blank")':
        "corruption is of type str, expected a Corruption; take find_kind",
    'suites.Case(name=None, title="", corruption=suites.CameraBlank())':
        "the name of case None is no text, expected a plain file name; name the case otherwise",
    'calibrated("isotonic")':
        "calibrators is of type str, expected several names, such as ('temperature',); give a tup",
    'calibrated(["isotonik"])': "calibrators contains 'isotonik'; perhaps isotonic is meant; choo",
    'fit_calibrator("linear", np.ones(1), np.ones(1))':
        "fit_calibrator: name must be one of temperature, platt, isotonic, got 'linear'",
    'NamedSubset(dataset, iter(["000001"])).sample_ids': "('000001',)",
    'NamedSubset(dataset, "000001")': "sample_ids is the text '000001', expected a tuple; give (",
    'NamedSubset(dataset, ["000001"] * 2)': "the list of frames names frame '000001' twice; rem",
    'compare_objects(*scored(), scored()[0], sample_list=iter(["000001"])).frames': "1",
    'frames(sample_list=iter(["000001"])).sample_list': "('000001',)",
    'BenchSettings(sample_list=(name for name in ["000001"])).sample_list': "('000001',)",
    'held_out(beams=np.array([64, 32])).scores[1].beams': "32",
    'held_out(beams=iter([torch.tensor(64)])).scores[0].beams': "64",
    'held_out(beams=[16.0])': "beams contains 16.0, expected whole numbers; give them as int",
    'held_out(beams=[True])': "beams contains True, expected whole numbers; give them as int",
    'held_out(beams=[64], crop_size=np.array([352, 1216])).image_sizes': "((352, 1216),)",
    'crop(given, 0, 0, np.int64(100), np.int64(200)).image_size': "(100, 200)",
    'resize(given, np.int64(100), np.int64(200)).image_size': "(100, 200)",
    'evaluate_depth(*depths(), band_ends_m=np.array([20.0, 40.0])).bands[2].name': "40 m on",
    'evaluate_depth(*depths(), band_ends_m=iter([20, 40])).bands[1].name': "20-40 m",
    'BenchSettings(cases=iter(["camera_blank"])).cases': "('camera_blank',)",
    'BenchSettings(cases="camera_blank")': "cases is the text 'camera_blank', expected a tuple; gi",
    'CorruptionSampler(without=iter(["camera_blank"])).without': "('camera_blank',)",
    'CorruptionSampler(without="camera_blank")': "without is the text 'camera_blank', expected a",
    'suites.find_suite("dgfn7").select("camera_blank")': "names is the text 'camera_blank', expec",
    'suites.find_suite("dgfn7").without("camera_blank")': "kinds is the text 'camera_blank', expe",
    'SourceConfig(path=PACKAGED_FRAMES, with_classes=iter(["Car"])).with_classes': "('Car',)",
    'SourceConfig(path=PACKAGED_FRAMES, with_classes="Car")': "with_classes is the text 'Car', exp",
    'corrupt_dataset(PACKAGED_FRAMES, "a", suite="dgfn7")':
        "corrupt_dataset: out is of type str, expected Path",
    'write_shards(PACKAGED_FRAMES, "a", frames_per_shard=2)':
        "write_shards: out is of type str, expected Path",
    'adapt(PACKAGED_FRAMES, "a", AdaptSettings())': "adapt: out is of type str, expected Path",
    'AdaptSettings(frames="4")': "AdaptSettings: frames is of type str, expected int",
    'SimulationConfig(seed="1")': "SimulationConfig: seed is of type str, expected int",
    'SimulationConfig(lidar="vlp16")': "must be one of hdl-64e, hdl-32e, vlp-16, got 'vlp16'",
    'SimulationConfig(camera="no")': "camera is of type str, expected True or False",
    'BenchSettings(seed=1.5)': "BenchSettings: seed must be a whole number, got 1.5",
    'AdaptSettings(tasks=iter(["depth-completion"])).tasks': "('depth-completion',)",
    'suites.Suite(name="a", cases=iter(suites.SUITES["dgfn7"].cases)).case_names[:2]':
        "('clean', 'camera_blank')",
}  # fmt: skip
_PROGRAM = """
import json, sys, tempfile
from pathlib import Path
import numpy as np
import torch
from PIL import Image
import sightline
from sightline.corruptions.arrays import corrupt_arrays
from sightline.data.formats import kitti_files, map_png
from sightline.data.formats.kitti_files import write_image
from sightline.data.datasets.sample_dataset import NamedSubset
from sightline.adaptation.adapt import AdaptSettings, adapt
from sightline.corruptions.generate import corrupt_dataset
from sightline.data.sharding import write_shards
from sightline.simulation.settings import SimulationConfig
from sightline.augmentation import faults
from sightline.augmentation.sample_changes import crop
from sightline.augmentation.scene_changes import resize
from sightline.corruptions.kinds import find_kind
from sightline.corruptions.drawing import CorruptionSampler
from sightline.training.sources import SourceConfig
from sightline.corruptions.blank import CameraFramesLost
from sightline.depth_completion.methods import complete_depth
from sightline.evaluation.calibration import ScoredFrames, evaluate_calibration
from sightline.evaluation.calibrators import fit_calibrator
from sightline.evaluation.kitti_object import compare_objects
from sightline.robustness.bench import BenchSettings
from sightline.evaluation.depth import evaluate_depth
from sightline.depth_completion.predictor import DepthCompleter
from sightline.detection2d.registration import TASK as DETECTION2D
from sightline.inference.predict import predict, predict_shards
from sightline.geometry.projection import unproject_pixels
from sightline.health.monitor import HealthMonitor
from sightline.health.sequence import DriveMonitor
from sightline.visualization.birds_eye import draw_birds_eye
from sightline.visualization.depth import colorize_depth, colorize_error, draw_depth
from sightline.visualization.image import draw_boxes2d, draw_boxes3d, draw_points
from sightline.corruptions import suites
from sightline.simulation.packaged import PACKAGED_FRAMES
dataset = sightline.open_dataset(PACKAGED_FRAMES)
given = dataset[0]
objects = given.objects.boxes3d, given.objects.class_names
perceiver = sightline.MultiTaskPredictor.load
def predictor(task):
    return perceiver(dict.fromkeys(tasks, "none") | {task: task + "-fast-cpu"})
tasks = ("detection2d", "detection3d", "depth-completion")
one = dict.fromkeys(tasks, "none") | {"detection2d": "detection2d-fast-cpu"}
picture = Image.fromarray(given.image.permute(1, 2, 0).numpy())
def scored():
    labels, results = PACKAGED_FRAMES / "training/label_2", Path(tempfile.mkdtemp())
    for each in labels.glob("*.txt"):
        lines = [line for line in each.read_text().splitlines() if "DontCare" not in line]
        (results / each.name).write_text("".join(f"{line} 0.5\\n" for line in lines))
    return results, labels
def frames(**chosen):
    return ScoredFrames(**dict(zip(("results_dir", "labels_dir"), scored())), **chosen)
def calibrated(names):
    return evaluate_calibration(frames(), fit_on=frames(), calibrators=names)
def held_out(**settings):
    return sightline.evaluate_held_out([given], DepthCompleter("linear"), **settings)
def depths():
    truth, results = PACKAGED_FRAMES / "training/depth", Path(tempfile.mkdtemp())
    for each in truth.glob("*.png"):
        map_png.write_depth_png(results / each.name, map_png.read_depth_png(each))
    return results, truth
def sample(**changed):
    settings = {"points": given.points, "image_size": given.image_size} | changed
    return sightline.CameraLidarSample.from_arrays(given.calibration, **settings)
said = {}
for case in json.loads(sys.argv[1]):
    try:
        said[case] = repr(eval(case))
    except (ValueError, TypeError) as error:
        said[case] = str(error)
print(json.dumps(said))
"""


@pytest.fixture(scope="module")
def said():
    """What each case says, in a process whose calls are not checked against their annotations."""
    command = [sys.executable, "-c", _PROGRAM, json.dumps(list(_CASES))]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(run.stdout)


@pytest.mark.parametrize("case", _CASES)
def test_a_wrong_argument_is_refused_in_one_line(said, case):
    assert _CASES[case] in said[case]
    assert "\n" not in said[case]


_DOCUMENTED = """
import inspect, json, pkgutil, re, sys, warnings
from pathlib import Path
from sightline.geometry.choices import choices_in

warnings.simplefilter("ignore")

def documented():
    for page in sorted(Path(sys.argv[1]).glob("*.md")):
        for name in re.findall(r"^::: (\\S+)", page.read_text("utf-8"), re.MULTILINE):
            named = pkgutil.resolve_name(name)
            for given in vars(named).values() if inspect.ismodule(named) else [named]:
                if not inspect.ismodule(named) or getattr(given, "__module__", "") == name:
                    yield from with_methods(given)

def with_methods(given):
    if inspect.isfunction(given):
        yield given.__qualname__, given
    for name, method in vars(given).items() if inspect.isclass(given) else ():
        if isinstance(method, classmethod) and not name.startswith("_"):
            yield method.__func__.__qualname__, getattr(given, name)

said = {}
"""


_WALK = """
import sightline

# Tensor operations that run inside networks, and a page without its members.
INNER = ("sightline.geometry.transforms", "sightline.evaluation.centre_distance")

def public():
    for name in sightline.__all__:
        if inspect.isclass(getattr(sightline, name)):
            yield name, getattr(sightline, name)
    for name, function in documented():
        if not name.startswith("_") and function.__module__ not in INNER:
            yield name, function

for name, function in public():
    parameters = inspect.signature(function).parameters.values()
    names = [each.name for each in parameters if each.default is each.empty]
    for wrong in (None, 3.5, [1]) if names else ():
        try:
            made = function(**dict.fromkeys(names, wrong))
            next(made) if inspect.isgenerator(made) else None
        except Exception as error:
            said[f"{name}({wrong})"] = type(error).__name__, str(error), names
        else:  # None is a valid argument of some of the others
            if name.partition(".")[0] in sightline.__all__:
                said[f"{name}({wrong})"] = "nothing", "", names
print(json.dumps(said))
"""


@pytest.fixture(scope="module")
def documents():
    """Folder of the pages that list documented functions."""
    return str(Path(__file__).parents[1] / "docs/reference")


def test_every_documented_function_names_an_argument_of_a_wrong_type_in_one_line(documents):
    command = [sys.executable, "-c", _DOCUMENTED + _WALK, documents]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    said = json.loads(run.stdout)
    assert len(said) > 200
    for call, (kind, message, names) in said.items():
        assert kind in ("TypeError", "TypeCheckError", "ValueError", "FileError"), (call, message)
        assert "\n" not in message
        told = message.replace("_", " ")
        assert any(name.replace("_", " ").rstrip("s") in told for name in names) or (
            kind == "ValueError"  # which says what is expected in its own words
        ), (call, message)


_WALK_HINTS = """
import sightline
from sightline.geometry.choices import hints_of

def named():
    yield from documented()
    for name in sightline.__all__:
        kind = getattr(sightline, name)
        for method in vars(kind).values() if inspect.isclass(kind) else ():
            if inspect.isfunction(method) and hasattr(method, "__wrapped__"):
                yield method.__qualname__, method

for name, function in named():
    hints = hints_of(inspect.unwrap(getattr(function, "__func__", function)))
    said[name] = [each for each, hint in hints.items() if isinstance(hint, str)]
print(json.dumps(said))
"""


def test_types_of_arguments_are_known_at_run_time_so_that_errors_can_name_them(documents):
    command = [sys.executable, "-c", _DOCUMENTED + _WALK_HINTS, documents]
    said = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert "MultiTaskPredictor.aligned" in said
    assert {name: hints for name, hints in said.items() if set(hints) - {"return"}} == {}


_WALK_CHOICES = """
for name, function in documented():
    if not name.startswith("_"):
        inner = inspect.unwrap(getattr(function, "__func__", function))
        for parameter in choices_in(inner):
            try:
                made = function(**{parameter: "misspelt"})
                next(made) if inspect.isgenerator(made) else None
            except Exception as error:
                said[f"{name}, {parameter}"] = str(error)
print(json.dumps(said))
"""


def test_every_documented_function_refuses_what_is_none_of_its_choices(documents):
    command = [sys.executable, "-c", _DOCUMENTED + _WALK_CHOICES, documents]
    said = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert len(said) > 30
    for call, message in said.items():
        parameter = call.rpartition(" ")[2]
        assert f": {parameter} must be one of " in message or (
            f": {parameter} is of type str, expected True or False" in message
        ), (call, message)
