"""Depth maps of other frames, in mixed units or of distances along rays, told by the evaluation."""

import cv2
import numpy as np
import pytest

from sightline.data.formats.map_png import write_depth_png
from sightline.evaluation.depth import evaluate_depth

SIZE = (60, 120)
NAMES = tuple("abcdefgh")


def scene(number):
    """Depths of a road with a box at a place of the frame's own."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    depth_m = np.minimum(200 / (rows + 3), 50.0)
    return np.where(abs(columns - 13 * number - 10) < 12, 5.0 + 2 * number, depth_m)


def write_scenes(folder, predicted, true=lambda depth_m: depth_m):
    """Write the ground truth of frames, and a prediction by number with 2 % of noise."""
    rng = np.random.default_rng(0)
    for number, name in enumerate(NAMES):
        truth_m = true(scene(number)) * (rng.random(SIZE) < 0.4)
        write_depth_png(folder / "truth" / f"{name}.png", truth_m)
        found_m = predicted(number) * rng.normal(1, 0.02, SIZE)
        write_depth_png(folder / "found" / f"{name}.png", found_m)
    return folder / "found", folder / "truth"


def as_rays(depth_m):
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    squares = (columns - 59.5) ** 2 + (rows - 29.5) ** 2
    return depth_m * np.sqrt(1 + squares / 72**2)


def test_sound_depths_of_many_frames_are_not_doubted(tmp_path):
    evaluate_depth(*write_scenes(tmp_path, scene))  # warnings are errors here


def test_distances_along_rays_are_told_with_the_focal_length(tmp_path):
    folders = write_scenes(tmp_path, lambda number: as_rays(scene(number)))
    told = r"found: depths grow against those of .*truth .* f of 0\.(59|6|61) times the longer side"
    with pytest.warns(UserWarning, match=told) as warned:
        evaluate_depth(*folders)
    assert len(warned) == 1


def test_distances_along_rays_in_the_ground_truth_are_told_of_it(tmp_path):
    folders = write_scenes(tmp_path, scene, as_rays)
    told = "truth: depths grow against those of .*found .* divide them by this root"
    with pytest.warns(UserWarning, match=told):
        evaluate_depth(*folders)


@pytest.mark.parametrize(
    "change",
    [
        lambda depth_m, x: depth_m * (1 + 0.15 * x),  # larger on one side only
        lambda depth_m, x: depth_m * (1 + 0.15 * (abs(x) > 0.3)),
        lambda depth_m, x: depth_m * (1.15 + 0 * x),
    ],
)
def test_other_errors_by_the_place_in_the_image_are_no_distances_along_rays(tmp_path, change):
    across = np.linspace(-1, 1, SIZE[1])[None]
    evaluate_depth(*write_scenes(tmp_path, lambda number: change(scene(number), across)))


def test_maps_of_which_some_are_in_millimetres_are_counted(tmp_path):
    found, truth = write_scenes(tmp_path, scene)
    for number in (1, 4, 6):
        steps = np.rint(scene(number) * 1000).astype(np.uint16)
        cv2.imwrite(str(found / f"{NAMES[number]}.png"), steps)
    told = "3 of 8 maps have most depths about 3.91 times .* predictions in millimetres in these"
    with pytest.warns(UserWarning, match=told) as warned:
        evaluate_depth(found, truth)
    assert len(warned) == 1


@pytest.mark.parametrize("shift", [1, -1])
def test_maps_of_the_frame_beside_are_told(tmp_path, shift):
    folders = write_scenes(tmp_path, lambda number: scene((number + shift) % len(NAMES)))
    name = "next frame" if shift > 0 else "frame before"
    told = f"in 7 of 7 compared frames the map fits the ground truth of the {name} in"
    with pytest.warns(UserWarning, match=told):
        evaluate_depth(*folders)
    with pytest.warns(UserWarning, match=told):  # of the other method, too
        evaluate_depth(write_scenes(tmp_path / "own", scene)[0], folders[1], against=folders[0])


def test_one_map_for_several_frames_is_told_unless_their_truth_is_one_too(tmp_path):
    found, truth = write_scenes(tmp_path, scene)
    for name in "bcd":
        (found / f"{name}.png").write_bytes((found / "a.png").read_bytes())
    told = r"found: 4 of 8 maps are the same as another frame's, .* differs \(a, b, c, d\): one map"
    with pytest.warns(UserWarning, match=told):
        evaluate_depth(found, truth)
    for name in "bcd":
        (truth / f"{name}.png").write_bytes((truth / "a.png").read_bytes())
    evaluate_depth(found, truth)  # a car that stands still
