"""The scripts of docs/guides/export.md, which read only an exported file, against Sightline."""

import ast
import json
import os
import re
import sys
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from sightline.augmentation.scene_changes import resize
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.open import open_dataset
from sightline.depth_completion.adaptive import adaptive_depth
from sightline.depth_completion.config import PlaneSmoothing, SignedThreshold
from sightline.depth_completion.methods import filling_config
from sightline.depth_completion.predictor import DepthPredictor
from sightline.depth_completion.processing import processing as depth_processing
from sightline.depth_completion.registration import TASK as DEPTH
from sightline.detection2d.export_graph import processing as detection2d_processing
from sightline.detection2d.placement import lidar_image
from sightline.detection2d.predictor import DetectionPredictor
from sightline.detection2d.registration import TASK as DETECTION_2D
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.detection3d.registration import TASK as DETECTION_3D
from sightline.export.kept_files import onnx_file_of
from sightline.files.weights import write_weights
from sightline.geometry.mount import turn_ahead
from sightline.geometry.projection import sparse_depth_map
from sightline.inference.network import load_network
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.depth_completion.test_export import FILLED, random_network

SCRIPTS = Path(__file__).parents[2] / "docs" / "guides" / "scripts"
LARGEST_DIFFERENCE_M, LARGEST_SCORE_DIFFERENCE, LARGEST_DIFFERENCE_PX = 0.01, 1e-3, 0.05
DEPTH_SETTINGS = replace(
    FILLED,
    correction="log",
    flip_test=True,
    least_correction=0.05,
    least_correction_above=SignedThreshold(nearer=0.15, farther=0.3),
    least_correction_beside=SignedThreshold(nearer=0.15, farther=0.65),
    smoothing=PlaneSmoothing(),
)


@pytest.fixture(autouse=True, scope="module")
def _extra():
    for library in ("onnxscript", "onnxruntime"):
        pytest.importorskip(library, reason="the extra `export` is not installed")


@pytest.fixture(scope="module")
def depth_weights(tmp_path_factory):
    """A small network: exporting a shipped one takes long."""
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    tensors = random_network(DEPTH_SETTINGS).state_dict()
    config = asdict(DEPTH_SETTINGS)
    write_weights(path, tensors, task="depth-completion", config=config, provenance={})
    return path


def export(task, weights, folder):
    """Export a network's files without the parity check, which has its own tests."""
    paths = []
    for graph in task.graphs(load_network(task, weights)):
        paths.append(folder / f"{graph.name or 'whole'}.onnx")
        paths[-1].write_bytes(onnx_file_of(graph))
    return [str(path) for path in paths]


def files_of(root, name):
    folders = ("image_2", ".png"), ("velodyne", ".bin"), ("calib", ".txt")
    return [str(root / "training" / folder / f"{name}{suffix}") for folder, suffix in folders]


def frames():
    """Each packaged frame as the script reads it and as Sightline does; a real one if there is."""
    from kitti_frame import read_frame

    found = [(PACKAGED_FRAMES, sample) for sample in open_dataset(PACKAGED_FRAMES)]
    if os.environ.get("SIGHTLINE_KITTI"):
        root = Path(os.environ["SIGHTLINE_KITTI"])
        found.append((root, KittiObjectDataset(root, sample_list="sample_val")[5]))
    return [(read_frame(*files_of(root, sample.sample_id)), sample) for root, sample in found]


def frame_of(sample):
    from kitti_frame import Frame

    calibration = sample.calibration
    return Frame(
        sample.image.permute(1, 2, 0).numpy(),
        sample.points.numpy(),
        calibration.image_from_camera.numpy(),
        calibration.camera_from_lidar.numpy(),
    )


def check_detections(found, expected, largest_difference):
    """Assert the same boxes in the same order."""
    assert len(found) > 5
    assert tuple(name for name, _, _ in found) == expected.class_names
    scores = np.array([score for _, score, _ in found])
    assert np.abs(scores - expected.scores.numpy()).max() < LARGEST_SCORE_DIFFERENCE
    boxes = expected.boxes.tensor.numpy()
    assert np.abs(np.stack([box for _, _, box in found]) - boxes).max() < largest_difference


def check_2d(weights, folder, pairs):
    from onnx_detection2d import detect

    (path,) = export(DETECTION_2D, weights, folder)
    predictor = DetectionPredictor.load(weights)
    for frame, sample in pairs:
        expected = predictor(sample).detections
        check_detections(detect(path, frame), expected, LARGEST_DIFFERENCE_PX)
    return path


def check_3d(weights, folder, pairs):
    from onnx_detection3d import detect

    paths = export(DETECTION_3D, weights, folder)
    predictor = Detection3DPredictor.load(weights)
    for frame, sample in pairs:
        check_detections(detect(*paths, frame), predictor(sample), LARGEST_DIFFERENCE_M)


def check_depth(weights, folder, pairs):
    from onnx_depth import complete

    (path,) = export(DEPTH, weights, folder)
    predictor = DepthPredictor.load(weights)
    for frame, sample in pairs:
        found, expected = complete(path, frame), predictor(sample)
        assert np.abs(found.depth_m - expected.depth_m.numpy()).max() < LARGEST_DIFFERENCE_M
        error_m = expected.uncertainty_m.numpy()
        np.testing.assert_allclose(found.uncertainty_m, error_m, atol=LARGEST_DIFFERENCE_M)
        assert (found.valid != expected.valid.numpy()).mean() < 1e-4
        assert found.valid.mean() > 0.1


def test_boxes_in_the_image_by_the_script_are_sightlines(tmp_path):
    path = check_2d("detection2d-fast-cpu", tmp_path, frames())
    from onnx_detection2d import detect

    larger = resize(open_dataset(PACKAGED_FRAMES)[0], 480, 1590)  # frames as large are shrunk
    expected = DetectionPredictor.load("detection2d-fast-cpu")(larger).detections
    # Surer ones alone: the pixels are rounded differently, so doubtful boxes swap in suppression.
    found = [each for each in detect(path, frame_of(larger)) if each[1] > 0.3]
    assert found
    assert [name for name, _, _ in found] == list(expected.class_names[: len(found)])
    boxes = expected.boxes.tensor[: len(found)].numpy()
    np.testing.assert_allclose(np.stack([box for _, _, box in found]), boxes, atol=0.5)


def test_boxes_in_space_by_the_script_are_sightlines_with_all_that_the_best_weights_do(tmp_path):
    settings = load_network(DETECTION_3D, "detection3d-best").network.config
    assert settings.flip_test
    assert settings.axes
    assert settings.regions.mean_with_first
    check_3d("detection3d-best", tmp_path, frames())


def test_depth_by_the_script_is_sightlines_with_all_that_the_best_weights_do(
    tmp_path, depth_weights
):
    check_depth(depth_weights, tmp_path, frames()[:1] + frames()[2:])


@pytest.mark.parametrize("without_returns", [False, True])
def test_depth_from_the_image_by_the_script_is_sightlines(tmp_path, without_returns):
    from onnx_image_depth import guess

    (path,) = export(DEPTH, "depth-image", tmp_path)
    predictor = DepthPredictor.load("depth-image")
    frame, sample = frames()[0]
    if without_returns:
        frame = frame._replace(points=frame.points[:0])
        sample = replace(sample, points=sample.points[:0])
    found, expected = guess(path, frame), predictor(sample)
    off_m = np.abs(found.depth_m - expected.depth_m.numpy())
    assert np.quantile(off_m, 0.999) < 5 * LARGEST_DIFFERENCE_M  # rounded pixels differ
    off_m = np.abs(found.uncertainty_m - expected.uncertainty_m.numpy())
    assert np.quantile(off_m, 0.999) < 5 * LARGEST_DIFFERENCE_M


@pytest.mark.parametrize("edition", ["first", "second"])
@pytest.mark.parametrize("keep_every", [1, 4])
def test_the_scripts_completion_between_rings_is_sightlines(keep_every, edition):
    from adaptive_fill import fill

    sample = open_dataset(PACKAGED_FRAMES)[0]
    band = torch.arange(len(sample.points)) // 300 % keep_every  # pieces of rings are missing
    points = sample.points[band == 0]
    sparse = sparse_depth_map(points, sample.calibration, sample.image_size).numpy()
    network = random_network(replace(FILLED, filling=edition))
    rule = json.loads(json.dumps(depth_processing(network), allow_nan=False))["filling"]
    depth_m, is_trusted = fill(sparse, rule)
    expected = adaptive_depth(sparse, filling_config(edition))
    is_off = np.abs(depth_m - expected.depth_m.numpy()) > 1e-3
    # The second edition moves depths that differ by a share, at which the last digit decides.
    assert is_off.mean() <= (0 if edition == "first" else 1e-4)
    assert (is_trusted == expected.valid.numpy()).all()


def test_a_network_without_a_sweep_is_refused_by_the_script_of_others():
    from adaptive_fill import fill

    with pytest.raises(SystemExit, match=r"from the image; use onnx_image_depth\.py$"):
        fill(np.ones((4, 5), np.float32), {"method": "street"})


def test_a_sweep_that_shows_nothing_has_no_boxes_in_space_and_no_depth(tmp_path, depth_weights):
    from onnx_depth import complete
    from onnx_detection3d import detect

    frame = frames()[0][0]
    blind = frame._replace(points=frame.points[:0])
    empty = complete(*export(DEPTH, depth_weights, tmp_path), blind)
    assert not empty.depth_m.any()
    assert not empty.valid.any()
    paths = export(DETECTION_3D, "detection3d-best", tmp_path)
    assert detect(*paths, blind) == []
    lone = frame._replace(points=np.float32([[20, 0, -1, 0.3], [np.nan, 0, 0, 0]]))
    assert detect(*paths, lone) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["best", "fast-cpu"])
def test_shipped_weights_by_the_scripts_give_sightlines_answers(name, tmp_path):
    check_2d(f"detection2d-{name}", tmp_path, frames())
    check_3d(f"detection3d-{name}", tmp_path, frames())
    check_depth(f"depth-{name}", tmp_path, frames())


def imported(path):
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (each.name.partition(".")[0] for each in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module.partition(".")[0]


def test_the_scripts_are_short_and_need_numpy_and_onnxruntime_alone():
    paths = sorted(SCRIPTS.glob("*.py"))
    own = {path.stem for path in paths}
    assert {"onnx_depth", "onnx_detection2d", "onnx_detection3d"} <= own
    allowed = {"numpy", "onnxruntime", "cv2"} | own | set(sys.stdlib_module_names)
    for path in paths:
        assert len(path.read_text().splitlines()) <= 100, path.name
        assert set(imported(path)) <= allowed, path.name
        if path.stem != "kitti_frame":  # which decodes the image
            assert "cv2" not in imported(path), path.name


def test_wrong_arguments_of_a_script_are_one_line(tmp_path, monkeypatch):
    from kitti_frame import arguments, read_frame

    picture, calibration = (
        str(PACKAGED_FRAMES / "training" / part)
        for part in ("image_2/000000.png", "calib/000000.txt")
    )
    monkeypatch.setattr("sys.argv", ["script.py", "model.onnx"])
    with pytest.raises(SystemExit, match=r"^usage: python script\.py A B$"):
        arguments("Title.\n\npython script.py A B\n", 2)
    (tmp_path / "odd.bin").write_bytes(bytes(20))
    for sweep, described in ((tmp_path / "none.bin", calibration), (picture, calibration),
                             (tmp_path / "odd.bin", calibration), (picture, picture)):  # fmt: skip
        with pytest.raises(SystemExit, match=r"give IMAGE.png VELODYNE.bin CALIB.txt of KITTI"):
            read_frame(picture, str(sweep), described)


def test_an_orientation_noted_in_the_picture_is_ignored_as_by_sightline(tmp_path):
    from kitti_frame import read_frame

    picture, sweep, calibration = files_of(PACKAGED_FRAMES, "000000")
    tags = Image.Exif()
    tags[0x0112] = 3
    Image.open(picture).save(tmp_path / "noted.png", exif=tags)
    noted = read_frame(str(tmp_path / "noted.png"), sweep, calibration)
    np.testing.assert_array_equal(noted.rgb, read_frame(picture, sweep, calibration).rgb)


@pytest.mark.parametrize("factor", [0.5, 2])
def test_an_image_of_another_resolution_than_its_calibration_is_refused_by_the_scripts(
    tmp_path, factor
):
    from kitti_frame import read_frame

    picture, sweep, calibration = files_of(PACKAGED_FRAMES, "000000")
    image = cv2.imread(picture)
    cv2.imwrite(str(tmp_path / "cropped.png"), image[90:, 20:-20])
    read_frame(str(tmp_path / "cropped.png"), sweep, calibration)
    cv2.imwrite(str(tmp_path / "scaled.png"), cv2.resize(image, None, fx=factor, fy=factor))
    with pytest.raises(SystemExit, match="and P2 of such an image; give IMAGE"):
        read_frame(str(tmp_path / "scaled.png"), sweep, calibration)


@pytest.mark.parametrize(
    "rows",
    [
        np.float32([[20, 0, -1, 0.3], [np.nan, 0, 0, 0]]),
        np.float32([[20, 0, -1, 76.5]]),  # reflectances of 0 to 255
        np.float32([[20, 0, -1, 0.3, 7]] * 4),  # five columns: rings in the place of coordinates
        np.float64([[20.1, 0.3, -1.7, 0.3]] * 4),
        np.float32([[20100, 300, -1700, 0.3]]),  # millimetres
    ],
)
def test_a_sweep_in_another_form_is_refused_by_the_scripts(tmp_path, rows):
    from kitti_frame import read_frame

    picture, _, calibration = files_of(PACKAGED_FRAMES, "000000")
    rows.tofile(tmp_path / "odd.bin")
    with pytest.raises(SystemExit, match=r"expected points \[m\], reflectances up to 1, and P2"):
        read_frame(picture, str(tmp_path / "odd.bin"), calibration)


@pytest.mark.parametrize("turn_deg", [-90, -5.1, -4.9, 4.9, 5.1, 20, 180])
def test_a_lidar_that_sightline_turns_ahead_is_refused_by_the_scripts_until_it_is_turned(
    tmp_path, turn_deg
):
    from kitti_frame import read_frame

    picture, sweep, calibration = files_of(PACKAGED_FRAMES, "000000")
    frame = read_frame(picture, sweep, calibration)
    odd, text = tmp_path / "calib.txt", Path(calibration).read_text()

    def read(mounting):
        numbers = " ".join(map(str, mounting[:3].ravel()))  # R0_rect of the frame is the identity
        line = f"Tr_velo_to_cam: {numbers}"
        odd.write_text(re.sub(r"^Tr_velo_to_cam:.*", line, text, flags=re.MULTILINE))
        return read_frame(picture, sweep, str(odd)).mounting

    def turn(deg):
        cos, sin = np.cos(np.radians(deg)), np.sin(np.radians(deg))
        return np.array([[cos, -sin, 0, 0], [sin, cos, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])

    turned = frame.mounting @ np.linalg.inv(turn(turn_deg))
    if turn_ahead(turned)[1] == 0:
        np.testing.assert_allclose(read(turned), turned, atol=1e-12)
        return
    with pytest.raises(SystemExit, match=r"^[^\n]*, expected up to 5; turn [^\n]*$") as told:
        read(turned)
    advised_deg = float(re.search(r"by (\S+) degrees about z", str(told.value))[1])
    mended = turned @ np.linalg.inv(turn(advised_deg))
    np.testing.assert_allclose(read(mended), frame.mounting, atol=0.01)


def test_a_camera_without_focal_length_is_refused_by_the_scripts_and_blank_lines_are_not(tmp_path):
    from kitti_frame import read_frame

    picture, sweep, calibration = files_of(PACKAGED_FRAMES, "000000")
    text = Path(calibration).read_text()
    odd = tmp_path / "calib.txt"
    odd.write_text(re.sub(r"^P2:.*", "P2:" + " 0" * 12, text, flags=re.MULTILINE))
    with pytest.raises(SystemExit, match="and P2 of such an image"):
        read_frame(picture, sweep, str(odd))
    odd.write_text(text.replace("\n", "\n \n"))
    assert np.array_equal(
        read_frame(picture, sweep, str(odd)).camera,
        read_frame(picture, sweep, calibration).camera,
    )


def test_a_frame_of_several_views_is_refused_in_one_line(tmp_path):
    from onnx_detection2d import detect

    (path,) = export(DETECTION_2D, "detection2d-fast-cpu", tmp_path)
    frame = frames()[0][0]
    tall = frame._replace(rgb=np.zeros((1000, 750, 3), np.uint8))
    with pytest.raises(SystemExit, match=r"^this script takes only up to \d+ rows, a focal length"):
        detect(path, tall)
    far = frame._replace(camera=frame.camera * [[4], [4], [1]])
    with pytest.raises(SystemExit, match=r"^this script [^\n]* shrink or crop the frame"):
        detect(path, far)


def test_depth_is_written_under_the_name_given_or_refused_in_one_line(tmp_path):
    from depth_maps import write_maps

    write_maps(str(tmp_path / "out.depth"), {"depth_m": np.ones((2, 3))})
    assert [path.name for path in tmp_path.iterdir()] == ["out.depth"]
    assert np.load(tmp_path / "out.depth")["depth_m"].shape == (2, 3)
    for place in (tmp_path, tmp_path / "none" / "out.npz"):
        with pytest.raises(SystemExit, match=r"^[^\n]* cannot be written: [^\n]*; name a file"):
            write_maps(str(place), {})


def test_a_file_without_the_steps_is_refused_in_one_line(onnx_file, tmp_path):
    import onnx

    from kitti_frame import open_graph

    model = onnx.load(onnx_file)
    kept = [each for each in model.metadata_props if each.key != "sightline.processing"]
    del model.metadata_props[:]
    model.metadata_props.extend(kept)
    onnx.save(model, tmp_path / "older.onnx")
    with pytest.raises(SystemExit, match=r"older\.onnx lacks .*sightline\.processing"):
        open_graph(str(tmp_path / "older.onnx"), "depth-completion")
    (tmp_path / "text.onnx").write_text("no graph")
    with pytest.raises(SystemExit, match=r"^[^\n]*text\.onnx is no ONNX file that can be run: .*"):
        open_graph(str(tmp_path / "text.onnx"), "depth-completion")


def test_a_file_of_another_task_or_stage_is_refused_in_one_line(tmp_path, depth_weights):
    from onnx_depth import complete
    from onnx_detection2d import detect as detect_2d
    from onnx_detection3d import detect as detect_3d

    frame = frames()[0][0]
    (depth,) = export(DEPTH, depth_weights, tmp_path)
    first, second = export(DETECTION_3D, "detection3d-fast-cpu", tmp_path)
    (tmp_path / "best").mkdir()
    _, other = export(DETECTION_3D, "detection3d-best", tmp_path / "best")
    for run, message in (
        (lambda: detect_2d(depth, frame), "task 'depth-completion', expected detection2d; name"),
        (lambda: complete(first, frame), "task 'detection3d', expected depth-completion; name"),
        (lambda: detect_3d(depth, second, frame), "'depth-completion', expected detection3d"),
        (lambda: detect_3d(first, depth, frame), "'depth-completion', expected detection3d"),
        (lambda: detect_3d(second, first, frame), "expected pillars; name the other file"),
        (lambda: detect_3d(first, first, frame), "takes pillars, expected points; name the other"),
        (
            lambda: detect_3d(first, other, frame),
            "are of different weights; name both files of one",
        ),
    ):
        with pytest.raises(SystemExit, match=f"^[^\\n]*{message}[^\\n]*$"):
            run()


@pytest.mark.parametrize("name", ["best", "fast-cpu"])
@pytest.mark.parametrize("task", [DETECTION_2D, DETECTION_3D, DEPTH], ids=lambda task: task.name)
def test_each_file_describes_all_its_inputs_with_as_many_channels_as_they_have(task, name):
    weights = f"{'depth' if task is DEPTH else task.name}-{name}"
    for graph in task.graphs(load_network(task, weights)):
        steps = json.loads(graph.metadata.to_properties()["sightline.processing"])
        assert set(steps["inputs"]) == set(graph.example_inputs)
        for each in ("image", "lidar", "sparse_depth_m", "filled_depth_m", "pillars"):
            if each in graph.example_inputs:
                channels = graph.example_inputs[each].shape[1]
                assert len(steps["inputs"][each]["channels"]) == channels
        with torch.inference_mode():
            given = graph.module(**graph.example_inputs)._asdict()
        assert set(steps["outputs"]) == {key for key, value in given.items() if value is not None}
        assert "padding" not in steps or steps["padding"]["multiple_of"] == graph.metadata.stride
        if task is not DEPTH:
            assert steps["classes"] == ["Car", "Pedestrian", "Cyclist"]
        if graph.name != "proposals" and task is not DEPTH:
            assert {"kind", "iou"} <= set(steps["suppression"])


def test_the_lidar_image_is_described_in_the_range_that_the_network_takes():
    loaded = load_network(DETECTION_2D, "detection2d-fast-cpu")
    steps = detection2d_processing(loaded.network)
    sample = open_dataset(PACKAGED_FRAMES)[0]
    image = lidar_image(sample, loaded.network.config.input)
    assert image.max() <= 1 < 255 * image.max()
    assert {tuple(each["range"]) for each in steps["inputs"]["lidar"]["channels"]} == {(0, 1)}
