import json
import math
import re
import shutil
import subprocess
import sys

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.data.formats.map_png import read_depth_png, write_depth_png
from sightline.evaluation.depth import evaluate_depth
from sightline.files.problem import FileError
from tests.reference import depth_metrics as reference


def random_map(rng, density, size=(8, 12)):
    steps = rng.integers(256, 80 * 256, size) * (rng.random(size) < density)
    return (steps / 256).astype(np.float32)


def write_set(folder, *, names, seed=0, density=0.6):
    """Predictions and ground truth by name; also as lists, for the reference."""
    rng = np.random.default_rng(seed)
    lists = {}
    for name in names:
        prediction, truth = random_map(rng, density), random_map(rng, 0.3)
        truth[0, 0] = 7
        write_depth_png(folder / "predictions" / f"{name}.png", prediction)
        write_depth_png(folder / "truth" / f"{name}.png", truth)
        lists[name] = (prediction.astype(float).tolist(), truth.astype(float).tolist())
    return folder / "predictions", folder / "truth", lists


def agree(got, expected):
    assert list(got) == list(expected)
    for name, value in expected.items():
        if math.isnan(value):
            assert got[name] is None, name
        else:
            assert got[name] == pytest.approx(value, rel=1e-9, abs=1e-9), name


@pytest.mark.filterwarnings("ignore:.* images have no predicted depth")
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), density=st.sampled_from([0.02, 0.1, 0.5, 0.95, 1.0]))
def test_the_report_agrees_with_a_calculation_pixel_by_pixel(tmp_path_factory, seed, density):
    predictions, truth, lists = write_set(
        tmp_path_factory.mktemp("set"), names=["a", "b", "c"], seed=seed, density=density
    )
    report = evaluate_depth(predictions, truth).to_json()
    assert list(report) == ["images", "mean", "per_image", "predicted_pixels_only"]
    assert report["images"] == 3
    per_image = {name: reference.scores(*pair) for name, pair in lists.items()}
    for name, expected in per_image.items():
        agree(report["per_image"][name], expected)
    agree(report["mean"], reference.mean_of_images(list(per_image.values())))
    masked = [reference.scores(*pair, predicted_pixels_only=True) for pair in lists.values()]
    if any(masked):
        agree(report["predicted_pixels_only"], reference.mean_of_images(masked))
    json.dumps(report, allow_nan=False)


def test_each_image_counts_alike_however_many_pixels_it_has(tmp_path):
    for name, prediction, pixels in (("one", 21, 1), ("many", 23, 99)):
        truth = np.zeros((10, 10), np.float32)
        truth.flat[:pixels] = 20
        write_depth_png(tmp_path / "truth" / f"{name}.png", truth)
        write_depth_png(
            tmp_path / "predictions" / f"{name}.png", np.full((10, 10), prediction, np.float32)
        )
    report = evaluate_depth(tmp_path / "predictions", tmp_path / "truth")
    assert report.mean.mae_mm == 2000


def test_images_without_any_predicted_pixel_count_in_the_official_mean_only(tmp_path):
    for name, prediction in (("a", 11.0), ("b", 0.0)):
        write_depth_png(tmp_path / "truth" / f"{name}.png", np.full((2, 2), 10.0))
        write_depth_png(tmp_path / "predictions" / f"{name}.png", np.full((2, 2), prediction))
    with pytest.warns(
        UserWarning, match=r"1 of 2 images have no predicted depth .* \(b\): over all"
    ):
        report = evaluate_depth(tmp_path / "predictions", tmp_path / "truth")
    assert report.mean.mae_mm == (1000 + 11000) / 2
    assert report.predicted_pixels_only.mae_mm == 1000
    assert report.mean.coverage == 0.5


def test_two_files_are_scored_as_a_set_of_one(tmp_path):
    predictions, truth, lists = write_set(tmp_path, names=["a"])
    report = evaluate_depth(predictions / "a.png", truth / "a.png").to_json()
    agree(report["mean"], reference.scores(*lists["a"]))
    assert list(report["per_image"]) == ["a"]


@pytest.mark.parametrize("name", [".", "a.png"])
def test_predictions_that_are_the_ground_truth_are_refused_and_copies_are_doubted(tmp_path, name):
    truth = tmp_path / "truth"
    write_depth_png(truth / "a.png", np.full((20, 10), 9.0, np.float32))
    (tmp_path / "link").symlink_to(truth)
    with pytest.raises(ValueError, match=r"named both as the results and as the ground truth"):
        evaluate_depth(tmp_path / "link" / name, truth / name)
    shutil.copytree(truth, tmp_path / "copies")
    with pytest.warns(UserWarning, match=r"every depth is exactly that of .*: they are copies"):
        evaluate_depth(tmp_path / "copies" / name, truth / name)


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_the_number_of_workers_changes_nothing(tmp_path, workers):
    predictions, truth, _ = write_set(tmp_path, names=[f"{i:03}" for i in range(30)])
    report = evaluate_depth(predictions, truth, workers=workers)
    assert [image.name for image in report.images] == [f"{i:03}" for i in range(30)]
    assert report == evaluate_depth(predictions, truth, workers=3, progress=False)


@pytest.mark.parametrize(
    ("unit", "steps"), [("metres", 1), ("centimetres", 100), ("millimetres", 1000)]
)
@pytest.mark.parametrize("kind", ["predictions", "ground truth"])
def test_depths_in_another_unit_are_doubted_and_sound_ones_are_not(tmp_path, kind, unit, steps):
    rng = np.random.default_rng(0)
    true_m = rng.integers(2, 60, (20, 30))
    found_m = true_m * rng.uniform(0.95, 1.05, true_m.shape)
    paths = tmp_path / "found.png", tmp_path / "true.png"
    for path, depth_m in zip(paths, (found_m, true_m), strict=True):
        write_depth_png(path, depth_m.astype(np.float32))
    evaluate_depth(*paths)  # warnings are errors here
    wrong, depth_m = (paths[0], found_m) if kind == "predictions" else (paths[1], true_m)
    cv2.imwrite(str(wrong), np.rint(depth_m * steps).astype(np.uint16))
    or_scaled = ", or of predictions with 65535 for 100 m" * (
        (kind, unit) == ("ground truth", "centimetres")
    )
    told = rf"because of {kind} in {unit}{or_scaled}: write metres times"
    with pytest.warns(UserWarning, match=told):
        evaluate_depth(*paths)


@pytest.mark.parametrize(
    ("factor", "doubt"),
    [
        (256, r"over 4 times those of .* or less than 1/4: write"),
        (10, r"are 7\.19 times those of .* of 35\.5% only"),
        (1 / 10, r"are 0\.1 times those of .* of 0\.1% only"),
        (1 / 1000, r"are 0\.000993 times those of .* of 7\.4% only"),
    ],
)
def test_depths_by_any_other_large_factor_are_doubted(tmp_path, factor, doubt):
    paths = tmp_path / "found.png", tmp_path / "true.png"
    true_m = np.random.default_rng(0).uniform(5, 60, (20, 30)).astype(np.float32)
    write_depth_png(paths[1], true_m)
    steps = np.rint(256 * factor * true_m).clip(1, 65535)  # saturates
    cv2.imwrite(str(paths[0]), steps.astype(np.uint16))
    with pytest.warns(UserWarning, match=doubt):
        evaluate_depth(*paths)


@pytest.mark.parametrize("kind", ["predictions", "ground truth"])
def test_millimetres_whose_far_pixels_saturate_are_told_as_such(tmp_path, kind):
    paths = tmp_path / "found.png", tmp_path / "true.png"
    depth_m = np.random.default_rng(0).uniform(5, 80, (20, 30)).astype(np.float32)
    for path in paths:
        write_depth_png(path, depth_m * (1 + 0.01 * (path == paths[0])))
    wrong = paths[0] if kind == "predictions" else paths[1]
    cv2.imwrite(str(wrong), np.rint(depth_m * 1000).clip(1, 65535).astype(np.uint16))
    with pytest.warns(UserWarning, match=f"because of {kind} in millimetres: write") as told:
        evaluate_depth(*paths)
    assert len(told) == 1


def street(rng, size=(40, 60)):
    """Depths of a road below a wall on the left side and an open right side, 0.1 % of noise."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    depth_m = np.minimum(200 / (rows + 1), np.where(columns < 20, 8.0, 60.0))
    return (depth_m * rng.uniform(0.999, 1.001, size)).astype(np.float32)


def write_street(folder, change):
    """Write two maps of a street, and predictions of them after a change."""
    for name in ("a", "b"):
        rng = np.random.default_rng(ord(name))
        truth_m = street(rng) * (rng.random((40, 60)) < 0.3)
        write_depth_png(folder / "truth" / f"{name}.png", truth_m)
        write_depth_png(folder / "found" / f"{name}.png", change(street(rng), rng))
    return folder / "found", folder / "truth"


@pytest.mark.parametrize(
    ("change", "doubt"),
    [
        (lambda depth_m: depth_m[:, ::-1], "better mirrored from left to right: .* as written"),
        (lambda depth_m: depth_m[::-1], "better upside down: "),
        (lambda depth_m: depth_m[::-1, ::-1], "better rotated by 180 degrees: "),
        (lambda depth_m: 40 / depth_m, r"correlation of their logarithms -\d.*inverse depths or"),
        (lambda depth_m: 1.4 * depth_m, r"are 1\.4 times those of .*, with a spread of .* only"),
        (lambda depth_m: depth_m / 7, r"are 0\.143 times those of .*, with a spread of .* only"),
        (
            lambda depth_m: 4.2 * (depth_m - 4),
            r"logarithms 0\.98\), but are 2\.\d+ times .* to 0\.\.65535: w",
        ),
    ],
)
def test_depths_in_another_orientation_inverse_or_of_another_scale_are_doubted(
    tmp_path, change, doubt
):
    with pytest.warns(UserWarning, match=doubt) as told:
        evaluate_depth(*write_street(tmp_path, lambda depth_m, _: change(depth_m)))
    assert len(told) == 1


def test_disparities_that_fit_better_turned_are_told_as_such(tmp_path):
    def disparities(depth_m, rng):
        return 384 / depth_m * rng.uniform(0.98, 1.02, depth_m.shape)

    with pytest.warns(UserWarning, match="inverse depths or disparities"):
        evaluate_depth(*write_street(tmp_path, disparities))


def test_other_predictions_and_sparse_maps_are_doubted_too(tmp_path):
    found, truth = write_street(tmp_path, lambda depth_m, rng: depth_m * rng.uniform(0.9, 1.1))
    in_mm, _ = write_street(tmp_path / "mm", lambda depth_m, _: depth_m * 1000 / 256)
    blank, _ = write_street(tmp_path / "blank", lambda depth_m, _: 0 * depth_m)
    nothing, _ = write_street(tmp_path / "nothing", lambda depth_m, _: 0 * depth_m)
    for path in nothing.iterdir():
        value_m = np.where(read_depth_png(truth / path.name) > 0, 0, 9)
        write_depth_png(path, value_m.astype(np.float32))
    sparse, _ = write_street(
        tmp_path / "sparse", lambda depth_m, rng: depth_m * (rng.random(depth_m.shape) < 0.2)
    )
    evaluate_depth(found, truth, sparse=sparse)  # warnings are errors here
    for options, doubt in (
        ({"against": in_mm}, f"{in_mm}: most depths are about 3.91 times"),
        ({"sparse": in_mm}, f"{in_mm}: most depths are about 3.91 times"),
        ({"sparse": blank}, f"{blank}: every map is empty, as of a LiDAR without returns, so no"),
        ({"sparse": nothing}, f"{nothing}: no map has a value at a pixel with ground truth"),
    ):
        with pytest.warns(UserWarning, match=re.escape(doubt)):
            evaluate_depth(found, truth, **options)


@pytest.mark.parametrize(
    "change",
    [
        lambda depth_m, _: 1.2 * depth_m,
        lambda depth_m, rng: depth_m * rng.lognormal(0.3, 0.3, depth_m.shape),
        lambda depth_m, _: np.full_like(depth_m, 20),
        lambda depth_m, rng: depth_m * (rng.random(depth_m.shape) < 0.05),
        lambda depth_m, rng: rng.uniform(10, 40, depth_m.shape),
    ],
)
def test_sound_and_bad_depths_alike_are_not_doubted_for_their_errors(tmp_path, change):
    evaluate_depth(*write_street(tmp_path, change))  # warnings are errors here


@pytest.mark.parametrize("which", ["predictions", "truth"])
def test_the_largest_number_for_no_value_is_told_with_its_count(tmp_path, which):
    rng = np.random.default_rng(3)
    maps = {name: rng.uniform(2, 60, (40, 40)) for name in ("predictions", "truth")}
    maps[which][:10] = 65535 / 256
    for name, depth_m in maps.items():
        write_depth_png(tmp_path / name / "0.png", depth_m)
    expected = f"{tmp_path / which}: 400 of 1,600 compared pixels hold 65535, probably for no value"
    with pytest.warns(UserWarning, match=expected):
        evaluate_depth(tmp_path / "predictions", tmp_path / "truth")


def test_subfolders_are_part_of_the_name(tmp_path):
    predictions, truth, _ = write_set(tmp_path, names=["x/000", "y/000"])
    assert [i.name for i in evaluate_depth(predictions, truth).images] == ["x/000", "y/000"]


@pytest.mark.parametrize(
    ("prediction", "truth"),
    [
        (
            "2011_09_26_drive_0002_sync_image_0000000005_image_02",
            "2011_09_26_drive_0002_sync_groundtruth_depth_0000000005_image_02",
        ),
        (
            "2011_09_26_drive_0002_sync_velodyne_raw_0000000005_image_02",
            "2011_09_26_drive_0002_sync_groundtruth_depth_0000000005_image_02",
        ),
        (
            "2011_09_26_drive_0002_sync_image_0000000005_image_02",
            "val/2011_09_26_drive_0002_sync/proj_depth/groundtruth/image_02/0000000005",
        ),
    ],
)
def test_names_of_the_benchmarks_archives_match_across_kinds(tmp_path, prediction, truth):
    write_depth_png(tmp_path / "predictions" / f"{prediction}.png", np.ones((2, 2)))
    write_depth_png(tmp_path / "truth" / f"{truth}.png", np.ones((2, 2)))
    (image,) = evaluate_depth(tmp_path / "predictions", tmp_path / "truth").images
    assert image.name == "2011_09_26_drive_0002_sync_image_0000000005_image_02"


def test_two_files_for_one_frame_are_refused(tmp_path):
    predictions, truth, _ = write_set(tmp_path, names=["d_image_0_image_02"])
    write_depth_png(truth / "d_groundtruth_depth_0_image_02.png", np.ones((8, 12)))
    with pytest.raises(ValueError, match="both stand for frame d_image_0_image_02"):
        evaluate_depth(predictions, truth)


def test_a_missing_prediction_is_an_error_that_names_it(tmp_path):
    predictions, truth, _ = write_set(tmp_path, names=["a", "b", "c"])
    (predictions / "b.png").unlink()
    with pytest.raises(ValueError, match=r"lacks predictions for 1 of the 3 images .* \(b\)"):
        evaluate_depth(predictions, truth)


def test_predictions_without_ground_truth_are_counted_but_not_scored(tmp_path):
    predictions, truth, _ = write_set(tmp_path, names=["a", "b", "c"])
    (truth / "b.png").unlink()
    report = evaluate_depth(predictions, truth)
    assert report.unused_predictions == 1
    assert list(report.to_json()["per_image"]) == ["a", "c"]
    assert "1 predictions without ground truth left out" in report.table().title


def test_suffixes_in_capitals_are_read_too(tmp_path):
    predictions, truth, _ = write_set(tmp_path, names=["a", "b", "c"])
    (truth / "b.png").rename(truth / "b.PNG")
    (predictions / "c.png").rename(predictions / "c.PNG")
    report = evaluate_depth(predictions, truth)
    assert list(report.to_json()["per_image"]) == ["a", "b", "c"]
    assert report.unused_predictions == 0


@pytest.mark.parametrize("folder", [".sightline-x", "#recycle"])
def test_files_that_are_still_being_written_or_were_deleted_do_not_count(tmp_path, folder):
    predictions, truth, _ = write_set(tmp_path, names=["a"])
    (predictions / folder).mkdir()
    (predictions / folder / "b.png").write_bytes(b"half")
    assert evaluate_depth(predictions, truth).unused_predictions == 0


def bad_files(tmp_path):
    predictions, truth, _ = write_set(tmp_path, names=["a"])
    return predictions / "a.png", truth / "a.png"


def eight_bits(prediction, _truth):
    cv2.imwrite(str(prediction), np.ones((8, 12), np.uint8))
    return f"{prediction}: is a PNG of 1 channels with 8 bits"


def three_channels(prediction, _truth):
    cv2.imwrite(str(prediction), np.ones((8, 12, 3), np.uint16))
    return f"{prediction}: is a PNG of 3 channels with 16 bits"


def other_size(prediction, _truth):
    write_depth_png(prediction, np.ones((4, 12)))
    return "the prediction is 4x12 but the ground truth is 8x12"


def empty_truth(_prediction, truth):
    write_depth_png(truth, np.zeros((8, 12)))
    return f"{truth}: the ground truth holds no depth at all"


def cut_short(prediction, _truth):
    prediction.write_bytes(prediction.read_bytes()[:-30])
    return f"{prediction}"


@pytest.mark.parametrize("spoil", [eight_bits, three_channels, other_size, empty_truth, cut_short])
def test_a_bad_file_is_one_line_that_names_it(tmp_path, spoil):
    prediction, truth = bad_files(tmp_path)
    message = spoil(prediction, truth)
    with pytest.raises(ValueError, match=r"^[^\n]+$") as raised:
        evaluate_depth(prediction.parent, truth.parent)
    assert message in str(raised.value)


def test_folders_that_are_absent_empty_or_files_are_refused(tmp_path):
    predictions, truth, _ = write_set(tmp_path, names=["a"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="nowhere does not exist"):
        evaluate_depth(predictions, tmp_path / "nowhere")
    with pytest.raises(ValueError, match="empty holds no PNG: write predictions as PNGs"):
        evaluate_depth(tmp_path / "empty", truth)
    np.save(tmp_path / "empty" / "a.npy", np.ones((3, 4)))
    with pytest.raises(ValueError, match=r"1 \.npy files and no PNG: write .*write_depth_png"):
        evaluate_depth(tmp_path / "empty", truth)
    with pytest.raises(
        ValueError, match=r"holds 1 \.npy files and no PNG: name a folder of 16-bit"
    ):
        evaluate_depth(predictions, tmp_path / "empty")
    with pytest.raises(ValueError, match=r"a\.png is a file where the other is a folder"):
        evaluate_depth(predictions, truth / "a.png")
    with pytest.raises(ValueError, match="workers must be at least 1, got 0"):
        evaluate_depth(predictions, truth, workers=0)


def test_the_table_has_both_variants_side_by_side(tmp_path):
    predictions, truth, _ = write_set(tmp_path, names=["a"])
    table = evaluate_depth(predictions, truth).table()
    assert (len(table.columns), table.row_count) == (3, 8)


def test_scoring_depth_needs_no_torch():
    # a command should not wait seconds for a library that it makes no use of
    code = "import sys, sightline.evaluation.depth; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    ("folder", "given"),
    [("", "train"), ("", "train/D/proj_depth/groundtruth"), ("train/D", "proj_depth")],
)
def test_annotated_drives_hold_ground_truth_beside_sparse_maps(
    tmp_path, monkeypatch, folder, given
):
    rng = np.random.default_rng(0)
    drive = tmp_path / "train" / "D" / "proj_depth"
    for number in range(3):
        place = f"image_02/{number:010}.png"
        truth_m = random_map(rng, 0.5)
        truth_m[0, 0] = 7
        write_depth_png(drive / "groundtruth" / place, truth_m)
        write_depth_png(drive / "velodyne_raw" / place, random_map(rng, 0.2))
        write_depth_png(tmp_path / "found" / f"D_image_{number:010}_image_02.png", truth_m + 1)
    monkeypatch.chdir(tmp_path / folder)
    report = evaluate_depth(tmp_path / "found", given, sparse=tmp_path / "train")
    assert report.mean.rmse_mm == pytest.approx(1000)
    assert report.returns is not None
    assert report.images[0].name == "D_image_0000000000_image_02"


@pytest.mark.parametrize("kind", ["groundtruth", "velodyne_raw"])
def test_drive_and_camera_need_be_told_by_one_folder_alone(tmp_path, kind):
    annotated = tmp_path / "train" / "D" / "proj_depth" / kind
    for folder in (annotated / "image_02", tmp_path / "found", tmp_path / "other" / "image_02"):
        write_depth_png(folder / "0000000005.png", np.full((3, 4), 7 + len(folder.parts) % 2))
    (tmp_path / "link").symlink_to(annotated / "image_02")
    for one, other in (
        ("found", annotated / "image_02"),
        ("other", annotated),
        ("other/image_02", "link"),
        ("found", f"train/D/proj_depth/{kind}/../{kind}/image_02"),
        ("found", "train"),
        ("found", "train/D"),
        ("other", "train"),
    ):
        for pair in ((one, other), (other, one)):
            (image,) = evaluate_depth(*(tmp_path / each for each in pair)).images
            assert image.name.endswith("0000000005") is (pair[1] == one)


def test_numbers_without_a_camera_are_told_where_there_are_two(tmp_path):
    annotated = tmp_path / "train" / "D" / "proj_depth" / "groundtruth"
    for folder in (annotated / "image_02", annotated / "image_03", tmp_path / "found"):
        write_depth_png(folder / "0000000005.png", np.ones((3, 4)))
    with pytest.raises(ValueError, match=f"or score against {annotated / 'image_02'}$"):
        evaluate_depth(tmp_path / "found", tmp_path / "train")


def test_frames_of_other_drives_are_no_predictions(tmp_path):
    for drive in "AB":
        folder = tmp_path / drive / "proj_depth" / "groundtruth" / "image_02"
        write_depth_png(folder / "0000000005.png", np.ones((3, 4)))
    with pytest.raises(ValueError, match="lacks predictions for 1 of the 1 images"):
        evaluate_depth(*(tmp_path / drive / "proj_depth" for drive in "AB"))


@pytest.mark.parametrize("place", ["training/depth", "depth"])
def test_a_data_set_in_place_of_its_depth_maps_is_told(tmp_path, place):
    predictions, truth, _ = write_set(tmp_path, names=["a"])
    shutil.copytree(truth, tmp_path / "data" / place)
    cv2.imwrite(str(tmp_path / "data" / "a.png"), np.ones((3, 4, 3), np.uint8))
    with pytest.raises(ValueError, match=f"or score against {tmp_path / 'data' / place}$"):
        evaluate_depth(predictions, tmp_path / "data")


def test_predictions_one_folder_below_are_named(tmp_path):
    predictions, truth, _ = write_set(tmp_path, names=["a", "b"])
    shutil.move(predictions, tmp_path / "found" / "data")
    with pytest.raises(ValueError, match=f"has the name of one: give {tmp_path}/found/data$"):
        evaluate_depth(tmp_path / "found", truth)


def test_predictions_with_other_names_are_told(tmp_path):
    predictions, truth, _ = write_set(tmp_path, names=["a", "b"])
    for number, name in enumerate("ab"):
        (predictions / f"{name}.png").rename(predictions / f"{number:010d}.png")
    told = r"\(a, b\), as none of its 2 maps, such as 0000000000\.png, has the name of one: predict"
    with pytest.raises(ValueError, match=told):
        evaluate_depth(predictions, truth)


def test_pictures_of_a_data_set_are_no_ground_truth(tmp_path):
    predictions, _, _ = write_set(tmp_path, names=["a"])
    (tmp_path / "drive" / "images").mkdir(parents=True)
    cv2.imwrite(str(tmp_path / "drive" / "images" / "a.png"), np.ones((3, 4, 3), np.uint8))
    with pytest.raises(FileError, match=r"images/a\.png.*expected a depth map"):
        evaluate_depth(predictions, tmp_path / "drive")


def test_results_in_place_of_the_ground_truth_are_told(tmp_path):
    predictions, truth, _ = write_set(tmp_path, names=["a"])
    (predictions / "sightline.json").write_text("{}")
    evaluate_depth(predictions, truth)
    with pytest.warns(UserWarning, match=r"predictions: a command wrote it .*: name the results"):
        evaluate_depth(truth, predictions)


def test_the_folder_of_the_ground_truth_in_the_given_one_is_named(tmp_path):
    _, truth, _ = write_set(tmp_path / "data", names=["a"])
    truth.rename(tmp_path / "data" / "groundtruth_depth")
    write_depth_png(tmp_path / "found" / "a.png", np.ones((3, 4), np.float32))
    told = r"lacks predictions for 2 of the 2 images .*, or score against .*/data/groundtruth_depth"
    with pytest.raises(ValueError, match=told):
        evaluate_depth(tmp_path / "found", tmp_path / "data")
