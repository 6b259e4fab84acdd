import json
import re

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from sightline.data.check import check_tree
from sightline.data.formats.kitti_labels import read_labels
from sightline.data.importing.import_recording import import_recording
from sightline.data.importing.nuscenes import find_tables
from sightline.data.open import open_dataset
from sightline.files.problem import FileError
from tests.data.recordings import SAMPLE, edit_table, write_nuscenes


@pytest.fixture(scope="module")
def nuscenes(tmp_path_factory):
    return write_nuscenes(tmp_path_factory.mktemp("nuscenes"))


def test_key_frames_come_out_as_they_were_simulated_wherever_the_car_was(nuscenes, tmp_path):
    report = import_recording(nuscenes, tmp_path)
    assert "rotated by -90 degrees" in str(report)
    dataset = open_dataset(tmp_path)
    assert dataset.sample_ids == ("scene-0001-000", "scene-0001-001")
    assert list(check_tree(tmp_path)) == []
    for sample in dataset:
        torch.testing.assert_close(sample.points[:-1], SAMPLE.points[:-1], rtol=0, atol=1e-5)
        ours, true = sample.calibration.image_from_lidar, SAMPLE.calibration.image_from_lidar
        torch.testing.assert_close(ours, true, rtol=0, atol=1e-6)
    assert dataset[1].timestamp_s == pytest.approx(0.5)


def test_labels_are_the_simulated_ones_of_the_classes_that_were_written(nuscenes, tmp_path):
    import_recording(nuscenes, tmp_path)
    names = ("Car", "Pedestrian", "Cyclist")
    true = SAMPLE.objects
    expected = true.select(torch.tensor([name in names for name in true.class_names]))
    for sample in open_dataset(tmp_path):
        assert sample.objects.class_names == expected.class_names
        ours = sample.objects.boxes3d.tensor
        torch.testing.assert_close(ours, expected.boxes3d.tensor, rtol=0, atol=0.02)


def test_images_take_no_room_and_a_second_run_writes_what_is_missing(nuscenes, tmp_path):
    import_recording(nuscenes, tmp_path / "out")
    image = tmp_path / "out" / "images" / "scene-0001-000.jpg"
    assert image.samefile(nuscenes / "samples" / "CAM_FRONT" / "0.jpg")
    (tmp_path / "out" / "points" / "scene-0001-001.bin").unlink()
    report = import_recording(nuscenes, tmp_path / "out")
    assert (report.written, report.skipped) == (1, 1)


def test_tables_that_changed_do_not_mix_with_their_import(tmp_path):
    write_nuscenes(tmp_path / "data")
    import_recording(tmp_path / "data", tmp_path / "out")
    edit_table(tmp_path / "data", "sample_annotation", lambda rows: rows.pop())
    before = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()}
    with pytest.raises(ValueError, match=r"made with tables [0-9a-f]{12} instead of"):
        import_recording(tmp_path / "data", tmp_path / "out")
    assert {path: path.read_bytes() for path in before} == before


def test_images_whose_names_have_no_usual_ending_are_read_from_the_recording(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=1)

    def rename(rows):
        for row in rows:
            if row["filename"].endswith(".jpg"):
                old = tmp_path / "data" / row["filename"]
                row["filename"] = row["filename"].removesuffix(".jpg")
                old.rename(tmp_path / "data" / row["filename"])

    edit_table(tmp_path / "data", "sample_data", rename)
    import_recording(tmp_path / "data", tmp_path / "out")
    (sample,) = open_dataset(tmp_path / "out")
    assert sample.image is not None
    assert (tmp_path / "out" / "images" / "scene-0001-000.jpeg").is_file()


def test_what_no_point_fell_on_is_a_region_and_a_parked_cycle_is_misc(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=1)

    def forget(rows):
        rows[0]["num_lidar_pts"] = 0
        for row in rows:
            row["attribute_tokens"] = []

    edit_table(tmp_path / "data", "sample_annotation", forget)
    import_recording(tmp_path / "data" / "v1.0-mini", tmp_path / "out")
    (sample,) = open_dataset(tmp_path / "out")
    assert sample.objects.class_names[0] == "DontCare"
    assert "Misc" in sample.objects.class_names
    assert "Cyclist" not in sample.objects.class_names


def test_a_channel_that_is_not_there_is_answered_with_those_that_are(nuscenes, tmp_path):
    with pytest.raises(ValueError, match="a camera CAM_BACK; name one of CAM_FRONT by --cam"):
        import_recording(nuscenes, tmp_path, camera_topic="CAM_BACK")


def test_tables_without_key_frames_say_so_and_not_that_a_channel_lacks(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=2)

    def unmark(rows):
        for row in rows:
            row["is_key_frame"] = False

    edit_table(tmp_path / "data", "sample_data", unmark)
    with pytest.raises(FileError, match=r"has no key frame: none of its 4 rows has is_key_frame"):
        import_recording(tmp_path / "data", tmp_path / "out")


@pytest.mark.parametrize("num_points", [1000, 1001])  # the bytes fit rows of 20, or not
def test_sweeps_of_four_columns_are_named_as_such(tmp_path, num_points):
    write_nuscenes(tmp_path / "data", num_samples=1)
    path = tmp_path / "data" / "samples" / "LIDAR_TOP" / "0.pcd.bin"
    np.fromfile(path, "<f4").reshape(-1, 5)[:num_points, :4].tofile(path)
    with pytest.raises(FileError, match=r"four columns of float32, expected nuScenes' five"):
        import_recording(tmp_path / "data", tmp_path / "out")
    path.write_bytes(b"# .PCD v0.7\n" + bytes(400))
    with pytest.raises(FileError, match=r"probably, PCD, expected nuScenes' five"):
        import_recording(tmp_path / "data", tmp_path / "out")


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (lambda root: (root / "v1.0-mini/ego_pose.json").unlink(), "ego_pose.json: cannot be read"),
        (
            lambda root: (root / "v1.0-mini/scene.json").write_text("{"),
            "scene.json: is invalid JSON",
        ),
        (
            lambda root: (root / "samples/LIDAR_TOP/0.pcd.bin").write_bytes(bytes(21)),
            "holds 21 bytes, expected a multiple of 20",
        ),
        (
            lambda root: np.zeros((1, 5), np.float32).tofile(root / "samples/LIDAR_TOP/0.pcd.bin"),
            "",
        ),
    ],
)
def test_a_damaged_file_is_named(tmp_path, damage, expected):
    write_nuscenes(tmp_path / "data", num_samples=1)
    damage(tmp_path / "data")
    if not expected:  # a sweep with its only point at the LiDAR's origin is valid
        report = import_recording(tmp_path / "data", tmp_path / "out")
        assert report.written == 1
        assert (
            "warning: 1 of 1 sweeps have no point left, e.g. that of frame scene-0001-000"
            in str(report)
        )
        return
    with pytest.raises(ValueError, match=expected):
        import_recording(tmp_path / "data", tmp_path / "out")


def test_scenes_follow_each_other_without_a_doubt_about_the_time_between_them(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=4)

    def add_scene(rows):
        rows.append({"token": "s1", "name": "scene-0000"})  # comes first, and was taken later

    def move(rows):
        for row in rows[2:]:
            row.update(scene_token="s1", timestamp=row["timestamp"] + 600_000_000)

    edit_table(tmp_path / "data", "scene", add_scene)
    edit_table(tmp_path / "data", "sample", move)
    edit_table(
        tmp_path / "data",
        "sample_data",
        lambda rows: [row.update(timestamp=row["timestamp"] + 600_000_000) for row in rows[4:]],
    )
    report = str(import_recording(tmp_path / "data", tmp_path / "out"))
    assert "2 scenes follow each other, told apart by the names of their frames" in report
    assert "gap" not in report
    assert "rise" not in report
    assert open_dataset(tmp_path / "out").sample_ids[1:3] == ("scene-0000-001", "scene-0001-000")


def test_key_frames_whose_files_were_not_extracted_are_dropped_and_told(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=3)
    (tmp_path / "data" / "samples" / "LIDAR_TOP" / "1.pcd.bin").unlink()
    report = import_recording(tmp_path / "data", tmp_path / "out")
    assert "dropped 1 of 3 key frames, whose image or sweep is missing" in str(report)
    assert open_dataset(tmp_path / "out").sample_ids == ("scene-0001-000", "scene-0001-002")
    for path in (tmp_path / "data" / "samples" / "CAM_FRONT").iterdir():
        path.unlink()
    with pytest.raises(ValueError, match=r"lacks files of all 3 key frames of CAM_FRONT and LIDAR"):
        import_recording(tmp_path / "data", tmp_path / "other")


@pytest.mark.parametrize(
    ("table", "change", "expected"),
    [
        ("ego_pose", list.pop, r"sample_data.json: row 3 has the ego_pose_token 's0-1', which ego"),
        (
            "sample_data",
            lambda rows: rows[0].pop("is_key_frame"),
            r"sample_data.json: row 1 lacks 'is_key_frame'",
        ),
        (
            "calibrated_sensor",
            lambda rows: rows[0].update(rotation=[0, 0, 0, 0]),
            "calibrated_sensor.json: row 1 has the quaternion 0 0 0 0",
        ),
    ],
)
def test_a_table_that_does_not_go_with_the_others_is_named(tmp_path, table, change, expected):
    write_nuscenes(tmp_path / "data")
    edit_table(tmp_path / "data", table, change)
    with pytest.raises(ValueError, match=expected):
        import_recording(tmp_path / "data", tmp_path / "out")


@pytest.mark.parametrize(
    ("table", "changes", "expected"),
    [
        ("scene", {"name": "../../victim"}, r"scene.json: row 1: the name .* holds a separator"),
        ("scene", {"name": ".hidden"}, r"row 1: the name .* begins with a dot"),
        ("scene", {"name": "a\x1b[2J"}, r"row 1: the name .* holds a control character"),
        ("scene", {"name": "n" * 300}, r"row 1: the name .* has more than 200 bytes"),
        ("scene", {"name": ["a"]}, r"row 1: the name .* is no text"),
        ("sample_data", {"filename": "/etc/hostname"}, r"row 1: the filename is '/etc/hostname'"),
        ("sample_data", {"filename": "samples/../../a.jpg"}, r"row 1: the filename is .* '\.\.'"),
        ("sample_data", {"filename": None}, r"row 1: the filename is None"),
    ],
)
def test_a_name_that_leads_out_of_the_folders_is_refused_and_nothing_written(
    tmp_path, table, changes, expected
):
    write_nuscenes(tmp_path / "data", num_samples=1)
    edit_table(tmp_path / "data", table, lambda rows: rows[0].update(changes))
    with pytest.raises(FileError, match=expected):
        import_recording(tmp_path / "data", tmp_path / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data"]


def test_a_file_that_is_a_link_out_of_the_data_set_is_refused_but_a_linked_folder_is_read(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=1)
    folder = tmp_path / "data" / "samples" / "CAM_FRONT"
    folder.rename(tmp_path / "elsewhere")
    folder.symlink_to(tmp_path / "elsewhere")
    assert import_recording(tmp_path / "data", tmp_path / "out").written == 1
    image = tmp_path / "elsewhere" / "0.jpg"
    image.rename(tmp_path / "private.jpg")
    image.symlink_to(tmp_path / "private.jpg")
    with pytest.raises(FileError, match=r"row 1: the filename names .*, a link that leads out"):
        import_recording(tmp_path / "data", tmp_path / "other")


def test_two_scenes_of_one_name_are_refused_as_one_would_replace_the_other(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=1)
    edit_table(tmp_path / "data", "scene", lambda rows: rows.append({**rows[0], "token": "s1"}))
    with pytest.raises(FileError, match=r"scene.json: row 2 has the name 'scene-0001' of row 1"):
        import_recording(tmp_path / "data", tmp_path / "out")


def rename_categories(names):
    def change(rows):
        for row, name in zip(rows, names, strict=True):
            row["name"] = name

    return change


@pytest.mark.parametrize(
    "names",
    [("car", "pedestrian", "bicycle"), ("REGULAR_VEHICLE", "PEDESTRIAN", "BICYCLIST")],
)
def test_categories_as_lyft_and_argoverse_spell_them_become_labels(nuscenes, tmp_path, names):
    write_nuscenes(tmp_path / "data", num_samples=1)
    edit_table(tmp_path / "data", "category", rename_categories(names))
    edit_table(
        tmp_path / "data", "attribute", lambda rows: rows[0].update(name="object_action_other")
    )
    report = import_recording(tmp_path / "data", tmp_path / "out")
    import_recording(nuscenes, tmp_path / "usual")
    labels = [
        folder / "labels" / "scene-0001-000.txt"
        for folder in (tmp_path / "out", tmp_path / "usual")
    ]
    assert labels[0].read_text() == labels[1].read_text()
    assert "left out" not in str(report)


def test_categories_that_are_left_out_are_told_with_their_counts(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=2)
    edit_table(
        tmp_path / "data",
        "category",
        rename_categories(("movable_object.barrier", "animal", "vehicle.bicycle")),
    )
    report = str(import_recording(tmp_path / "data", tmp_path / "out"))
    rows = json.loads((tmp_path / "data" / "v1.0-mini" / "sample_annotation.json").read_text())
    cars, walkers, cycles = (
        sum(row["instance_token"] == f"i-{name}" for row in rows)
        for name in ("vehicle.car", "human.pedestrian.adult", "vehicle.bicycle")
    )
    assert f"labels: {len(rows)} annotations became {cycles} labels ({cycles} Cyclist)" in report
    assert f"left out {cars + walkers} annotations of categories" in report
    assert f"{cars} movable_object.barrier" in report
    assert f"{walkers} animal" in report


def test_an_import_that_leaves_no_label_at_all_warns(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=1)
    edit_table(tmp_path / "data", "category", rename_categories(("animal", "animal", "animal")))
    report = str(import_recording(tmp_path / "data", tmp_path / "out"))
    assert "warning: no annotation became a label" in report


@pytest.mark.parametrize("count", [None, -1, "absent"])
def test_where_points_in_boxes_are_not_counted_the_sweep_is_looked_at(nuscenes, tmp_path, count):
    write_nuscenes(tmp_path / "data", num_samples=1)

    def forget(rows):
        for row in rows:
            row.pop("num_lidar_pts") if count == "absent" else row.update(num_lidar_pts=count)
        # an empty box above all echoes, inside the image
        rows.append({**rows[0], "token": "high", "size": [0.1, 0.1, 0.1]})
        rows[-1]["translation"] = [*rows[0]["translation"][:2], rows[0]["translation"][2] + 1.2]

    edit_table(tmp_path / "data", "sample_annotation", forget)
    import_recording(tmp_path / "data", tmp_path / "out")
    import_recording(nuscenes, tmp_path / "usual")
    ours, usual = (
        open_dataset(folder)[0].objects.class_names
        for folder in (tmp_path / "out", tmp_path / "usual")
    )
    assert ours == (*usual, "DontCare")


def test_an_import_into_its_source_or_around_it_is_refused(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=1)
    for out in (tmp_path / "data", tmp_path / "data" / "out", tmp_path):
        with pytest.raises(ValueError, match="beside it"):
            import_recording(tmp_path / "data", out)


@pytest.mark.parametrize("focal", [0.0, -700.0, 1e8])
def test_a_camera_that_nobody_could_read_is_refused_before_anything_is_written(tmp_path, focal):
    write_nuscenes(tmp_path / "data", num_samples=1)

    def change(rows):
        rows[0]["camera_intrinsic"][0][0] = focal

    edit_table(tmp_path / "data", "calibrated_sensor", change)
    with pytest.raises(FileError, match=r"0.jpg: is unusable: its .* focal lengths"):
        import_recording(tmp_path / "data", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_points_that_are_dropped_are_counted(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=1)
    path = tmp_path / "data" / "samples" / "LIDAR_TOP" / "0.pcd.bin"
    sweep = np.fromfile(path, np.float32).reshape(-1, 5)
    sweep[:3, 0] = np.nan
    sweep[3:5, :3] = 0
    sweep.tofile(path)
    report = str(import_recording(tmp_path / "data", tmp_path / "out"))
    assert f"dropped 5 of {len(sweep)} points: 3 not finite, 2 at the LiDAR's origin" in report


def outcome(work):
    """Error message of bad data; None: no error."""
    try:
        work()
    except ValueError as error:
        return str(error)
    return None


def test_tables_of_any_damage_give_moments_or_one_line_that_names_file_and_row(tmp_path):
    write_nuscenes(tmp_path, num_samples=1)
    tables = find_tables(tmp_path)
    whole = {path: path.read_text() for path in tables.folder.iterdir()}
    random = np.random.default_rng(0)
    wrong = (None, -1, 1e308, "", "../x", [], {}, True, [None] * 3, 2**70, "\ud800", "keep")
    outcomes = []
    for number in range(400):
        path = sorted(whole)[number % len(whole)]
        rows = json.loads(whole[path])
        row = rows[random.integers(len(rows))]
        name = sorted(row)[random.integers(len(row))]
        value = wrong[random.integers(len(wrong))]
        if value == "keep":
            del row[name]
        else:
            row[name] = value
        path.write_text(json.dumps(rows))
        outcomes.append(outcome(lambda: tables.moments("CAM_FRONT", "LIDAR_TOP")))
        path.write_text(whole[path])
    lines = [line for line in outcomes if line is not None]
    assert all(line.isprintable() for line in lines)
    assert sum(".json: row " in line for line in lines) > 200


def test_two_channels_that_are_no_camera_and_lidar_are_refused(nuscenes, tmp_path):
    with pytest.raises(ValueError, match="a camera LIDAR_TOP; name one of CAM_FRONT by --camera"):
        import_recording(nuscenes, tmp_path, camera_topic="LIDAR_TOP", lidar_topic="CAM_FRONT")


def test_tables_without_any_camera_say_so(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=1)
    edit_table(tmp_path / "data", "sensor", lambda rows: rows[0].update(modality="radar"))
    with pytest.raises(ValueError, match="of a camera CAM_FRONT; it has no camera"):
        import_recording(tmp_path / "data", tmp_path / "out")


def test_samples_without_files_in_the_tables_are_counted(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=3)
    edit_table(tmp_path / "data", "sample_data", lambda rows: rows.__delitem__(slice(2, None)))
    report = str(import_recording(tmp_path / "data", tmp_path / "out"))
    assert "dropped 2 samples without a key frame of each channel" in report


def set_times(root, timestamps):
    write_nuscenes(root, num_samples=len(timestamps))

    def change(rows):
        for index, row in enumerate(rows):
            row["timestamp"] = timestamps[index * len(timestamps) // len(rows)]

    for table in ("sample", "sample_data"):
        edit_table(root, table, change)


def test_times_that_do_not_rise_are_a_warning(tmp_path):
    set_times(tmp_path / "data", [7, 7, 7])
    report = str(import_recording(tmp_path / "data", tmp_path / "out"))
    assert f"warning: {tmp_path / 'out' / 'times.txt'}: " in report
    assert "times that do not rise from frame to frame: 2 of 3, 2 of them equal" in report


@pytest.mark.parametrize("timestamps", [[1.5e9, 1.5e9 + 0.5], [15, 15, 16], [1500, 2000]])
def test_times_in_seconds_or_milliseconds_are_refused_by_their_table(tmp_path, timestamps):
    set_times(tmp_path / "data", timestamps)
    with pytest.raises(FileError, match=r"sample_data\.json: .*write microseconds in sample\.json"):
        import_recording(tmp_path / "data", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_times_that_no_recording_may_have_are_refused_before_anything_is_written(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=1)

    def in_nanoseconds(rows):
        rows[0]["timestamp"] = 1_700_000_000_000_000_000

    edit_table(tmp_path / "data", "sample", in_nanoseconds)
    with pytest.raises(FileError, match=r"sample\.json: row 1 has the timestamp 17.*microseconds"):
        import_recording(tmp_path / "data", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_cycle_without_the_entry_of_attributes_is_not_taken_for_a_parked_one(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=1)

    def remove(rows):
        for row in rows:
            row.pop("attribute_tokens", None)

    edit_table(tmp_path / "data", "sample_annotation", remove)
    import_recording(tmp_path / "data", tmp_path / "out")
    (sample,) = open_dataset(tmp_path / "out")
    assert "Cyclist" in sample.objects.class_names
    assert "Misc" not in sample.objects.class_names


def test_rotations_with_w_last_are_told_by_boxes_that_lean(nuscenes, tmp_path):
    assert "lean" not in str(import_recording(nuscenes, tmp_path / "sound"))
    write_nuscenes(tmp_path / "data")

    def reorder(rows):
        for row in rows:
            row["rotation"] = [*row["rotation"][1:], row["rotation"][0]]

    edit_table(tmp_path / "data", "sample_annotation", reorder)
    report = str(import_recording(tmp_path / "data", tmp_path / "out"))
    assert "annotations lean by more than 20 degrees against the LiDAR" in report
    assert "quaternions w, x, y, z" in report


def test_a_sweep_without_points_is_not_taken_for_misplaced_labels(tmp_path):
    write_nuscenes(tmp_path / "data")
    (tmp_path / "data" / "samples" / "LIDAR_TOP" / "1.pcd.bin").write_bytes(b"")
    report = str(import_recording(tmp_path / "data", tmp_path / "out"))
    assert "warning: 1 of 2 sweeps have no point left" in report
    assert "misplaced" not in report


def test_poses_that_do_not_fit_the_annotations_are_told_by_boxes_without_points(nuscenes, tmp_path):
    assert "misplaced" not in str(import_recording(nuscenes, tmp_path / "sound"))
    write_nuscenes(tmp_path / "data")

    def move_second(rows):
        rows[1]["translation"][1] += 4.0

    edit_table(tmp_path / "data", "ego_pose", move_second)
    report = str(import_recording(tmp_path / "data", tmp_path / "out"))
    assert re.search(r"[5-8] of 17 annotations with at least 5 LiDAR points by the tables", report)
    assert "correct ego_pose" in report


def test_a_wrong_size_in_the_tables_is_not_taken_for_a_wrong_calibration(tmp_path):
    root = write_nuscenes(tmp_path / "data")
    edit_table(root, "sample_data", lambda rows: [row.update(width=100) for row in rows])
    with pytest.raises(
        FileError, match=r"is 375x1242 .*, expected 375x100 as in its row of sample"
    ):
        import_recording(root, tmp_path / "out")


def test_labels_of_a_lidar_that_looks_down_are_those_of_a_level_one(nuscenes, tmp_path):
    import_recording(nuscenes, tmp_path / "level")
    root = write_nuscenes(tmp_path / "data")
    down = Rotation.from_euler("x", -25, degrees=True)  # its y axis points ahead

    def tilt(rows):
        w, *xyz = rows[1]["rotation"]
        x, y, z, w = (Rotation.from_quat([*xyz, w]) * down).as_quat().tolist()
        rows[1]["rotation"] = [w, x, y, z]

    edit_table(root, "calibrated_sensor", tilt)
    for path in (root / "samples" / "LIDAR_TOP").iterdir():
        sweep = np.fromfile(path, np.float32).reshape(-1, 5)
        sweep[:, :3] = down.inv().apply(sweep[:, :3])
        sweep.tofile(path)
    assert "lean" not in str(import_recording(root, tmp_path / "out"))
    for path in (tmp_path / "level" / "labels").iterdir():
        level, tilted = (
            read_labels(each / path.name) for each in (path.parent, tmp_path / "out" / "labels")
        )
        assert tilted.class_names == level.class_names
        assert np.abs(tilted.locations - level.locations).max() < 0.02
        assert np.abs(tilted.rotation_y - level.rotation_y).max() < 0.02


def test_rotations_of_sensors_with_w_last_are_named_beside_faulty_annotations(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=1)

    def reorder(rows):
        for row in rows:
            row["rotation"] = [*row["rotation"][1:], row["rotation"][0]]

    edit_table(tmp_path / "data", "calibrated_sensor", reorder)
    with pytest.raises(FileError, match=r"rotations of calibrated_sensor \(quaternions w, x, y, z"):
        import_recording(tmp_path / "data", tmp_path / "out")


@pytest.mark.parametrize("change", ["twice", "length first"])
def test_faulty_annotations_are_told_by_their_table_not_by_the_image(tmp_path, change):
    write_nuscenes(tmp_path / "data", num_samples=1)

    def spoil(rows):
        if change == "twice":
            rows.extend([dict(row, token=row["token"] + "b") for row in rows])
        for row in rows if change == "length first" else ():
            width, length, height = row["size"]
            row["size"] = [length, width, height]

    edit_table(tmp_path / "data", "sample_annotation", spoil)
    told = r"sample_annotation\.json: gives an .* \(frame scene-0001-000\); .*width, length, height"
    with pytest.raises(FileError, match=told):
        import_recording(tmp_path / "data", tmp_path / "out")


def test_frames_of_a_scene_of_over_a_thousand_samples_are_in_order(tmp_path):
    root = write_nuscenes(tmp_path / "data", num_samples=1)
    (sample,) = json.loads((root / "v1.0-mini" / "sample.json").read_text())
    rows = json.loads((root / "v1.0-mini" / "sample_data.json").read_text())

    def many(rows, key):
        return [
            {**row, key: f"{row[key]}+{number}" if number else row[key]}
            | {"timestamp": row["timestamp"] + number, "token": f"{row['token']}+{number}"}
            for number in range(1001)
            for row in rows
        ]

    samples = [
        {**sample, "token": sample["token"] + (f"+{number}" if number else "")}
        | {"timestamp": sample["timestamp"] + number}
        for number in range(1001)
    ]
    edit_table(root, "sample", lambda old: old.__setitem__(slice(None), samples))
    edit_table(
        root, "sample_data", lambda old: old.__setitem__(slice(None), many(rows, "sample_token"))
    )
    moments = find_tables(root).moments("CAM_FRONT", "LIDAR_TOP").moments
    names = [moment.name for moment in moments]
    assert names == sorted(names)
    assert names[-1] == "scene-0001-1000"
