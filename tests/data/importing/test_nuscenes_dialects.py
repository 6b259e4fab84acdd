"""Tables of other data sets in nuScenes' format: Lyft's, TIER IV's, and tables with faults."""

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from sightline.data.check import check_tree
from sightline.data.formats.image_file import read_rgb
from sightline.data.formats.kitti_labels import read_labels
from sightline.data.formats.rings import ring_numbers
from sightline.data.importing.import_recording import import_recording
from sightline.data.open import open_dataset
from sightline.files.problem import FileError
from tests.data.recordings import CAMERA_MATRIX, IMAGE, POINTS, edit_table, write_nuscenes

LENS = [-0.3, 0.1, 0.0, 0.0, 0.0]


@pytest.fixture
def data(tmp_path):
    return write_nuscenes(tmp_path / "data")


def test_sweeps_come_out_ring_by_ring_by_their_column_of_rings(data, tmp_path):
    rings, random = ring_numbers(POINTS), np.random.default_rng(0)
    no_echoes = np.full((3000, 5), 3e-6, np.float32)
    paths = sorted((data / "samples" / "LIDAR_TOP").iterdir())
    for path in paths:
        sweep = np.fromfile(path, np.float32).reshape(-1, 5)
        sweep[:, 4] = 40 - rings
        no_echoes[:, 4] = np.arange(3000) % 40
        random.permutation(np.concatenate((sweep, no_echoes))).tofile(path)
    report = str(import_recording(data, tmp_path / "out"))
    assert f"dropped {3000 * len(paths)} of" in report
    points = open_dataset(tmp_path / "out")[0].points.numpy()
    assert (np.bincount(ring_numbers(points)) == np.bincount(rings)).all()


def set_entries(data, table, **entries):
    edit_table(data, table, lambda rows: [row.update(entries) for row in rows])


def occlusions(out):
    objects = read_labels(out / "labels" / "scene-0001-000.txt")
    return {
        float(each) for each in objects.occlusion[[n != "DontCare" for n in objects.class_names]]
    }


@pytest.mark.parametrize(
    ("level", "occlusion"),
    [("v0-40", 2), ("v40-60", 1), ("v60-80", 1), ("v80-100", 0), ("none", 2), ("partial", 1),
     ("Most", 1), ("full", 0)],
)  # fmt: skip
def test_levels_of_visibility_are_those_of_their_table(data, tmp_path, level, occlusion):
    rows = [{"token": "1", "level": level, "description": ""}]
    (data / "v1.0-mini" / "visibility.json").write_text(json.dumps(rows))
    set_entries(data, "sample_annotation", visibility_token="1")
    report = str(import_recording(data, tmp_path / "out"))
    assert occlusions(tmp_path / "out") == {occlusion}
    assert "no visibility" not in report


@pytest.mark.parametrize(
    ("scale", "said"),
    [
        (0, "all intensities are 100, so reflectances carry no information"),
        (
            1 / 255,
            "intensities are below a hundredth of max_intensity, 255, for 99 of 100 measured",
        ),
    ],
)
def test_tables_with_doubtful_intensities_are_imported_with_a_word(data, tmp_path, scale, said):
    for path in data.glob("samples/LIDAR_TOP/*"):
        points = np.fromfile(path, np.float32).reshape(-1, 5)
        points[:, 3] = points[:, 3] * scale + (100 if scale == 0 else 0)
        points.tofile(path)
    report = str(import_recording(data, tmp_path / "out"))
    assert report.count("warning: in 2 of 2 sweeps, e.g. that of frame scene-0001-000, ") == 1
    assert report.count(said) == 1


def test_bright_points_in_tables_are_limited_and_told_and_far_more_are_dropped(tmp_path):
    data = write_nuscenes(tmp_path / "data", num_samples=3)
    for number, step in ((1, 50), (2, 5)):
        path = data / "samples" / "LIDAR_TOP" / f"{number}.pcd.bin"
        points = np.fromfile(path, np.float32).reshape(-1, 5)
        points[::step, 3] = 300
        points.tofile(path)
    report = str(import_recording(data, tmp_path / "out"))
    assert "warning: 1 sweeps, e.g. that of frame scene-0001-001, have more than one" in report
    assert "dropped 1 of 3 key frames, whose image or sweep cannot be read; the first" in report
    assert float(open_dataset(tmp_path / "out")[1].points[:, 3].max()) == 1


def damage(data, *numbers, kind="sweep"):
    for number in numbers:
        name = f"LIDAR_TOP/{number}.pcd.bin" if kind == "sweep" else f"CAM_FRONT/{number}.jpg"
        path = data / "samples" / name
        content = path.read_bytes()
        path.unlink()  # else the image of an earlier import, a hard link, changes, too
        path.write_bytes(content[:-8] if kind == "sweep" else b"no image")


@pytest.mark.parametrize("kind", ["sweep", "image"])
@pytest.mark.parametrize("numbers", [(0,), (5,), (0, 1, 2, 3), (2, 5)])
def test_key_frames_that_cannot_be_read_are_dropped_and_told(tmp_path, kind, numbers):
    data = write_nuscenes(tmp_path / "data", num_samples=6)
    damage(data, *numbers, kind=kind)
    file = f"{numbers[0]}.pcd.bin: holds" if kind == "sweep" else f"{numbers[0]}.jpg: is neither"
    told = (
        rf"warning: dropped {len(numbers)} of 6 key frames, whose image or sweep cannot be read; "
        rf"the first, scene-0001-00{numbers[0]}: .*{file}"
    )
    left = [f"scene-0001-00{number}" for number in range(6) if number not in numbers]
    for written in (len(left), 0):
        report = import_recording(data, tmp_path / "out")
        assert report.written == written
        assert str(report).startswith(f"{len(left)} key frames of CAM_FRONT and LIDAR_TOP")
        assert re.search(told, str(report))
        assert str(report).count("warning") == 1
        assert "kept" not in str(report)
        assert [
            line[:14] for line in (tmp_path / "out/times.txt").read_text().split("\n")[:-1]
        ] == left
        assert list(check_tree(tmp_path / "out")) == []
        assert open_dataset(tmp_path / "out").sample_ids == tuple(left)


@pytest.mark.parametrize("num_samples", [5, 8])
@pytest.mark.parametrize("kind", ["sweep", "image"])
def test_tables_of_which_no_first_key_frame_can_be_read_are_refused(tmp_path, num_samples, kind):
    data = write_nuscenes(tmp_path / "data", num_samples=num_samples)
    damage(data, *range(5), kind=kind)
    with pytest.raises(FileError, match="0.pcd.bin: holds" if kind == "sweep" else "0.jpg: is"):
        import_recording(data, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("is_written", [True, False])
def test_times_follow_the_frames_whose_files_are_removed_before_a_further_run(tmp_path, is_written):
    data = write_nuscenes(tmp_path / "data", num_samples=4)
    import_recording(data, tmp_path / "out")
    if not is_written:  # as if the first run had been stopped there
        for path in (tmp_path / "out").glob("*/scene-0001-002.*"):
            path.unlink()
    (data / "samples" / "LIDAR_TOP" / "2.pcd.bin").unlink()
    report = str(import_recording(data, tmp_path / "out"))
    assert "kept" not in report
    assert "warning" not in report
    assert ("dropped 1 of 4 key frames" in report) != is_written
    assert f"0 frames written, {3 + is_written} were there already" in report
    assert list(check_tree(tmp_path / "out")) == []
    assert len((tmp_path / "out" / "times.txt").read_text().splitlines()) == 3 + is_written


def written_files(out):
    paths = [path for folder in ("images", "points") for path in (out / folder).iterdir()]
    return {path: path.read_bytes() for path in (*paths, out / "times.txt")}


@pytest.mark.parametrize("kind", ["sweep", "image", "missing"])
@pytest.mark.parametrize("removed", ["labels", "calibration", "images"])
def test_frames_of_an_earlier_import_stay_when_their_source_is_damaged(tmp_path, kind, removed):
    data, out = write_nuscenes(tmp_path / "data", num_samples=4), tmp_path / "out"
    import_recording(data, out)
    shutil.rmtree(out / removed)
    kept = [*(out / "images").glob("*"), *(out / "points").iterdir(), out / "times.txt"]
    before = {path: path.read_bytes() for path in kept}
    if kind == "missing":
        (data / "samples" / "LIDAR_TOP" / "2.pcd.bin").unlink()
    else:
        damage(data, 2, kind=kind)
    report = str(import_recording(data, out))
    assert {path: path.read_bytes() for path in kept} == before
    assert "dropped" not in report
    assert re.search(
        r"warning: 1 of 4 frames stay as imported before, without the files that they lack, "
        rf".*; the first, scene-0001-002: {data}/samples/(LIDAR_TOP|CAM_FRONT)/2\.",
        report,
    )
    assert "3 frames written, 1 were there already" in report
    assert not any("belong to no frame" in str(each) for each in check_tree(out))


def test_an_image_without_its_cloud_whose_sweep_is_damaged_is_no_frame(tmp_path):
    data, out = write_nuscenes(tmp_path / "data", num_samples=4), tmp_path / "out"
    import_recording(data, out)
    (out / "points" / "scene-0001-002.bin").unlink()  # as if the run had been stopped there
    damage(data, 2)
    assert "dropped 1 of 4 key frames" in str(import_recording(data, out))
    left = {f"scene-0001-00{number}" for number in (0, 1, 3)}
    assert {path.stem for path in written_files(out)} == {*left, "times"}
    assert {line[:14] for line in (out / "times.txt").read_text().splitlines()} == left


@pytest.mark.parametrize("error", [FileNotFoundError(2, "No such file"), PermissionError(13, "no")])
@pytest.mark.parametrize("number", [0, 2])
@pytest.mark.parametrize("is_resumed", [True, False])
def test_files_that_cannot_be_accessed_stop_the_import(
    tmp_path, monkeypatch, error, number, is_resumed
):
    data, out = write_nuscenes(tmp_path / "data", num_samples=4), tmp_path / "out"
    before = {}
    if is_resumed:
        import_recording(data, out)
        before = written_files(out)
        shutil.rmtree(out / "labels")
    opened = Path.open

    def open_file(path, *args, **options):
        if path.name == f"{number}.pcd.bin":  # as if its disk were gone since the start
            raise error
        return opened(path, *args, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", open_file)
        with pytest.raises(FileError, match=rf"LIDAR_TOP/{number}.pcd.bin: cannot be read: no"):
            import_recording(data, out)
    if is_resumed:
        assert written_files(out) == before
    import_recording(data, out)
    assert list(check_tree(out)) == []
    assert len(open_dataset(out)) == 4


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("numbers", [(0,), (2,), (0, 1, 2, 3, 4)])
def test_images_that_are_cut_short_are_dropped_and_told(tmp_path, suffix, numbers):
    data, out = write_nuscenes(tmp_path / "data", num_samples=6), tmp_path / "out"
    for number in numbers:
        path = data / "samples" / "CAM_FRONT" / f"{number}.jpg"
        _, content = cv2.imencode(suffix, cv2.imread(str(path)))
        path.write_bytes(content.tobytes()[: len(content) // 3])
    said = rf"{numbers[0]}.jpg: is cut short: its (JPEG|PNG) end mark is missing"
    if len(numbers) == 5:
        with pytest.raises(FileError, match=said):
            import_recording(data, out)
        assert not out.exists()
        return
    report = str(import_recording(data, out))
    assert re.search(rf"warning: dropped 1 of 6 key frames, .*{said}", report)
    assert report.count("warning") == 1
    assert len(open_dataset(out)) == 5
    assert list(check_tree(out)) == []


@pytest.mark.parametrize(("token", "occlusion"), [("1", 2), ("2", 1), ("3", 1), ("4", 0)])
def test_without_their_table_tokens_are_nuscenes(data, tmp_path, token, occlusion):
    set_entries(data, "sample_annotation", visibility_token=token)
    import_recording(data, tmp_path / "out")
    assert occlusions(tmp_path / "out") == {occlusion}


@pytest.mark.parametrize("token", ["", None, "v80-100", 7])
def test_labels_of_unknown_visibility_count_as_visible_with_a_word(data, tmp_path, token):
    set_entries(data, "sample_annotation", visibility_token=token)
    report = str(import_recording(data, tmp_path / "out"))
    assert occlusions(tmp_path / "out") == {0}
    found = [each.objects.class_names for each in open_dataset(tmp_path / "out")]
    number = sum(name != "DontCare" for names in found for name in names)
    assert f"{number} of {number} labels have no visibility in the tables" in report


def test_a_distorting_lens_is_refused_and_straightened_on_request(data, tmp_path):
    edit_table(data, "calibrated_sensor", lambda rows: rows[0].update(camera_distortion=LENS))
    with pytest.raises(ValueError, match=r"lens of CAM_FRONT distorts \(-0.3, 0.1, .*--undistort"):
        import_recording(data, tmp_path / "out")
    import_recording(data, tmp_path / "out", undistort=True)
    straight = open_dataset(tmp_path / "out")[0].image.permute(1, 2, 0).numpy()
    raw = read_rgb(data / "samples" / "CAM_FRONT" / "0.jpg")
    expected = cv2.undistort(raw, np.array(CAMERA_MATRIX), np.array(LENS))
    assert np.abs(straight.astype(int) - expected).mean() < 0.5


@pytest.mark.parametrize("entry", [None, [], [0, 0, 0, 0, 0]])
def test_a_straight_lens_is_none(data, tmp_path, entry):
    edit_table(data, "calibrated_sensor", lambda rows: rows[0].update(camera_distortion=entry))
    import_recording(data, tmp_path / "out")
    text = (tmp_path / "out" / "calibration" / "scene-0001-000.yaml").read_text()
    assert "distortion" not in text


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ("none", "has the camera_distortion 'none', expected 0 finite numbers"),
        ([0.1, "k"], "expected 2 finite numbers"),
        ([0.1] * 7, "the lens has 7 distortion coefficients, expected"),
    ],
)
def test_a_lens_that_is_none_is_refused(data, tmp_path, entry, expected):
    edit_table(data, "calibrated_sensor", lambda rows: rows[0].update(camera_distortion=entry))
    with pytest.raises(FileError, match=expected):
        import_recording(data, tmp_path / "out", undistort=True)


def test_images_taken_long_after_their_sweep_are_told(data, tmp_path):
    def delay(rows):
        for row in rows:
            row["timestamp"] += 2_000_000 * row["filename"].endswith(".jpg")

    assert "before or after" not in str(import_recording(data, tmp_path / "sound"))
    edit_table(data, "sample_data", delay)
    report = str(import_recording(data, tmp_path / "out"))
    assert "2 of 2 images were taken more than 0.15 s before or after their sweep, e.g. " in report
    assert "scene-0001-000 by 2 s" in report


def test_invalid_rows_and_other_lidars_are_left_out_with_a_word(data, tmp_path):
    def change(rows):
        rows[0]["is_valid"] = False
        rows.append(rows[1] | {"token": "left", "calibrated_sensor_token": "cleft"})

    edit_table(data, "sample_data", change)
    sensor = {"token": "lleft", "channel": "LIDAR_LEFT", "modality": "lidar"}
    edit_table(data, "sensor", lambda rows: rows.append(sensor))
    mount = {"token": "cleft", "sensor_token": "lleft"}
    edit_table(data, "calibrated_sensor", lambda rows: rows.append(rows[1] | mount))
    report = str(import_recording(data, tmp_path / "out"))
    assert "dropped 1 images and sweeps that the tables call invalid" in report
    assert "dropped 1 samples without a key frame of each channel" in report
    assert "other LiDARs are left out: LIDAR_LEFT; choose one by --lidar-topic" in report
    assert open_dataset(tmp_path / "out").sample_ids == ("scene-0001-001",)
    assert IMAGE.shape[:2] == open_dataset(tmp_path / "out")[0].image_size


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"calibration": "none.yaml"}, "--calibration has no effect on nuScenes"),
        ({"info_topic": "/info", "clock": "received"}, "--info-topic and --clock have no effect"),
        ({"max_gap_s": 0.001}, "--max-gap-s has no effect on nuScenes"),
    ],
)
def test_options_without_an_effect_are_refused(data, tmp_path, options, named):
    with pytest.raises(ValueError, match=named):
        import_recording(data, tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_tables_without_annotations_give_no_labels_and_nothing_to_doubt(tmp_path):
    data = tmp_path / "data"
    write_nuscenes(data, num_samples=2)
    for table in ("sample_annotation", "instance"):
        edit_table(data, table, lambda rows: rows.clear())
    report = str(import_recording(data, tmp_path / "out"))
    assert "warning: the tables hold no annotation of these frames: no labels" in report
    assert not (tmp_path / "out" / "labels").exists()
    assert not list(check_tree(tmp_path / "out"))
    again = str(import_recording(data, tmp_path / "out"))
    assert "0 frames written, 2 were there already" in again


@pytest.mark.parametrize("tables", ["sample_annotation", "sample_annotation attribute category"])
def test_missing_tables_of_annotations_are_a_warning_and_give_no_labels(data, tmp_path, tables):
    for table in tables.split():
        (data / "v1.0-mini" / f"{table}.json").unlink()
    report = str(import_recording(data, tmp_path / "out"))
    named = ", ".join(f"{each}.json" for each in tables.split())
    assert f"warning: v1.0-mini lacks {named}, so the frames have no labels" in report
    assert not (tmp_path / "out" / "labels").exists()
    assert not list(check_tree(tmp_path / "out"))
    assert "2 were there already" in str(import_recording(data, tmp_path / "out"))


@pytest.mark.parametrize("table", ["attribute", "category", "instance"])
def test_tables_that_annotations_refer_to_may_lack_only_without_annotations(data, tmp_path, table):
    (data / "v1.0-mini" / f"{table}.json").unlink()
    expected = rf"{table}\.json: is missing, and rows of sample_annotation.json .* without labels"
    with pytest.raises(FileError, match=expected):
        import_recording(data, tmp_path / "out")
    keep_annotations(data, lambda _: False)
    report = str(import_recording(data, tmp_path / "out"))
    assert f"warning: v1.0-mini lacks {table}.json, so the frames have no labels" in report


def test_a_link_to_a_table_of_annotations_that_cannot_be_reached_is_refused(data, tmp_path):
    table = data / "v1.0-mini" / "sample_annotation.json"
    table.unlink()
    table.symlink_to("nowhere")
    with pytest.raises(FileError, match=r"sample_annotation\.json: is a link to 'nowhere'"):
        import_recording(data, tmp_path / "out")


def test_frames_without_annotations_among_others_are_a_warning(tmp_path):
    data = write_nuscenes(tmp_path / "data", num_samples=3)
    assert "have no annotation" not in str(import_recording(data, tmp_path / "sound"))
    first = json.loads((data / "v1.0-mini" / "sample.json").read_text())[0]["token"]
    edit_table(
        data,
        "sample_annotation",
        lambda rows: rows.__setitem__(
            slice(None), [row for row in rows if row["sample_token"] == first]
        ),
    )
    report = str(import_recording(data, tmp_path / "out"))
    assert (
        "warning: 2 of 3 frames have no annotation and get empty label files, e.g. scene-0001-001:"
    ) in report
    files = sorted((tmp_path / "out" / "labels").iterdir())
    assert [path.stat().st_size > 0 for path in files] == [True, False, False]


def keep_annotations(data, is_kept):
    def change(rows):
        rows[:] = [row for row in rows if is_kept(row["sample_token"])]

    edit_table(data, "sample_annotation", change)


def test_a_damaged_frame_is_not_counted_among_those_without_annotations(tmp_path):
    data = write_nuscenes(tmp_path / "data", num_samples=4)
    keep_annotations(data, lambda token: token not in ("s0-2", "s0-3"))
    damage(data, 2)
    report = str(import_recording(data, tmp_path / "out"))
    assert "warning: 1 of 3 frames have no annotation and get empty label files, e.g. sc" in report
    assert "e.g. scene-0001-003: they count" in report


@pytest.mark.parametrize("kind", ["sweep", "image"])
def test_annotations_of_damaged_frames_alone_give_no_labels_until_they_are_sound(tmp_path, kind):
    data, out = write_nuscenes(tmp_path / "data", num_samples=4), tmp_path / "out"
    keep_annotations(data, lambda token: token == "s0-2")
    sound = shutil.copytree(data / "samples", tmp_path / "samples")
    damage(data, 2, kind=kind)
    assert "no annotation of these frames: no labels" in str(import_recording(data, out))
    assert not (out / "labels").exists()
    assert "0 frames written, 3 were there already" in str(import_recording(data, out))
    shutil.rmtree(data / "samples")
    sound.rename(data / "samples")
    assert "3 of 4 frames have no annotation" in str(import_recording(data, out))
    assert len(list((out / "labels").iterdir())) == 4
    assert list(check_tree(out)) == []


def test_tables_that_are_a_link_go_with_the_data_around_the_link(tmp_path):
    data, elsewhere = tmp_path / "data", tmp_path / "metadata"
    write_nuscenes(data, num_samples=1)
    (data / "v1.0-mini").rename(elsewhere)
    (data / "v1.0-mini").symlink_to(elsewhere)
    import_recording(data / "v1.0-mini", tmp_path / "out")
    (tmp_path / "link").symlink_to(data / "v1.0-mini")
    (data / "v1.0-mini").unlink()
    elsewhere.rename(data / "v1.0-mini")
    import_recording(tmp_path / "link", tmp_path / "other")
    names = [path.name for path in (tmp_path / "out" / "images").iterdir()]
    assert names == [path.name for path in (tmp_path / "other" / "images").iterdir()] != []


@pytest.mark.parametrize(
    ("emptied", "example", "archives"),
    [
        (["CAM_FRONT"], "CAM_FRONT/0.jpg", "CAM_FRONT"),
        (["LIDAR_TOP"], "LIDAR_TOP/0.pcd.bin", "LIDAR_TOP"),
        (["CAM_FRONT", "LIDAR_TOP"], "CAM_FRONT/0.jpg", "CAM_FRONT and LIDAR_TOP"),
    ],
)
def test_channels_whose_archives_were_not_extracted_are_named(
    data, tmp_path, emptied, example, archives
):
    for channel in emptied:
        for path in (data / "samples" / channel).iterdir():
            path.unlink()
    named = f"e.g. {data}/samples/{example}; extract the archives with {archives} into it"
    with pytest.raises(ValueError, match=re.escape(named)):
        import_recording(data, tmp_path / "out")


@pytest.mark.parametrize(
    ("state", "class_name"),
    [
        ("cycle.without_rider", "Misc"),
        ("cycle_state.without_rider", "Misc"),
        ("motorcycle_state.without_rider", "Misc"),
        ("two_wheel_vehicle_state.Without Rider", "Misc"),
        ("vehicle_state.parked", "Misc"),
        ("cycle_state.with_rider", "Cyclist"),
        ("two_wheel_vehicle_state.with_rider", "Cyclist"),
        ("object_state.still", "Cyclist"),
    ],
)
@pytest.mark.parametrize("category", ["bicycle", "vehicle.motorcycle", "motorbike"])
def test_cycles_without_a_rider_are_misc_as_each_data_set_names_them(
    data, tmp_path, category, state, class_name
):
    edit_table(data, "category", lambda rows: rows[2].update(name=category))
    edit_table(data, "attribute", lambda rows: rows[0].update(name=state))
    import_recording(data, tmp_path / "out")
    names = set(read_labels(tmp_path / "out" / "labels" / "scene-0001-000.txt").class_names)
    assert names & {"Misc", "Cyclist"} == {class_name}


@pytest.mark.parametrize(
    ("category", "class_name"),
    [
        ("construction_worker", "Pedestrian"),
        ("police_officer", "Pedestrian"),
        ("pedestrian.police_officer", "Pedestrian"),
        ("police_car", "Car"),
        ("ambulance", "Van"),
        ("vehicle.emergency (ambulance & police)", "Van"),
        ("fire_truck", "Truck"),
        ("vehicle.fire", "Truck"),
        ("vehicle.bus (bendy & rigid)", "Truck"),
        ("semi_trailer", "Truck"),
        ("movable_object.barrier", None),
        ("SUV", "Car"),  # as `check` reads the classes of labels
        ("vehicle.automobile", "Car"),
        ("minivan", "Van"),
        ("vehicle.spaceship", None),
        ("static_object.suv", None),
    ],
)
def test_categories_of_tier_iv_and_others_have_the_classes_of_nuscenes(
    data, tmp_path, category, class_name
):
    place = int(class_name == "Pedestrian")  # of cars, or of pedestrians: their sizes are judged
    edit_table(data, "category", lambda rows: rows[place].update(name=category))
    report = str(import_recording(data, tmp_path / "out"))
    objects = read_labels(tmp_path / "out" / "labels" / "scene-0001-000.txt")
    assert ("left out" in report) == (class_name is None)
    found = set(objects.class_names) - {"Cyclist", "DontCare"}
    assert found == {class_name, "Car" if place else "Pedestrian"} - {None}


def add_lidar(data):
    """Add a second LiDAR to the tables, whose files are those of the first."""
    sensor = {"token": "l2", "channel": "LIDAR_LEFT", "modality": "lidar"}
    mount = {"token": "c2", "sensor_token": "l2"}
    row = {"calibrated_sensor_token": "c2", "token": "second"}
    edit_table(data, "sensor", lambda rows: rows.append(sensor))
    edit_table(data, "calibrated_sensor", lambda rows: rows.append(rows[1] | mount))
    edit_table(data, "sample_data", lambda rows: rows.append(rows[1] | row))


@pytest.mark.parametrize(("count", "num_lidars"), [(0, 1), (0, 2), (99_999, 2)])
def test_counts_of_no_or_of_several_lidars_are_those_of_the_sweep(
    data, tmp_path, count, num_lidars
):
    import_recording(data, tmp_path / "usual")
    if num_lidars > 1:
        add_lidar(data)
    set_entries(data, "sample_annotation", num_lidar_pts=count)
    assert "misplaced" not in str(import_recording(data, tmp_path / "out"))
    usual, labels = (tmp_path / name / "labels" / "scene-0001-000.txt" for name in ("usual", "out"))
    assert labels.read_text() == usual.read_text()


@pytest.mark.parametrize("folder", ["data", "lidar"])
def test_linked_tables_of_other_data_sets_go_with_the_data_around_the_link(data, tmp_path, folder):
    (data / "samples").rename(data / folder)
    place = f"{folder}/"

    def rename(rows):
        for row in rows:
            row["filename"] = row["filename"].replace("samples/", place)

    edit_table(data, "sample_data", rename)
    (data / "v1.0-mini").rename(tmp_path / "tables")
    (data / "annotation").symlink_to(tmp_path / "tables")
    assert import_recording(data / "annotation", tmp_path / "out").written == 2


def test_pointers_of_git_lfs_in_place_of_tables_are_told(data, tmp_path):
    (data / "v1.0-mini" / "ego_pose.json").write_text("version https://git-lfs.github.com/spec/v1")
    with pytest.raises(FileError, match=r"ego_pose\.json: is a pointer of Git LFS.*git lfs pull"):
        import_recording(data, tmp_path / "out")


def test_folders_of_files_with_a_further_word_are_named_with_what_the_tables_have(data, tmp_path):
    (data / "samples").rename(data / "train_samples")  # as Kaggle packs Lyft's
    with pytest.raises(ValueError, match=r"; rename train_samples to samples, as the tables have"):
        import_recording(data, tmp_path / "out")


def test_annotations_far_from_the_sweep_are_told_by_their_distance(data, tmp_path):
    def move(rows):
        for row in rows:
            row["translation"][0] += 2000.0

    edit_table(data, "sample_annotation", move)
    report = str(import_recording(data, tmp_path / "out"))
    assert "annotations lie over 300 m from the LiDAR, so none became a label" in report
    assert "name another camera" not in report
