import json

import numpy as np
import pytest
import torch

from sightline.data.check import check_tree
from sightline.data.importing.import_recording import import_recording
from sightline.data.open import open_dataset
from tests.data.recordings import SAMPLE, write_nuscenes


@pytest.fixture(scope="module")
def nuscenes(tmp_path_factory):
    return write_nuscenes(tmp_path_factory.mktemp("nuscenes"))


def edit(root, table, change):
    path = root / "v1.0-mini" / f"{table}.json"
    rows = json.loads(path.read_text())
    change(rows)
    path.write_text(json.dumps(rows))


def test_key_frames_come_out_as_they_were_simulated_wherever_the_car_was(nuscenes, tmp_path):
    report = import_recording(nuscenes, tmp_path)
    assert "turned by -90 degrees" in str(report)
    dataset = open_dataset(tmp_path)
    assert dataset.sample_ids == ("scene-0001-000", "scene-0001-001")
    assert list(check_tree(tmp_path)) == []
    for sample in dataset:
        torch.testing.assert_close(sample.points, SAMPLE.points, rtol=0, atol=1e-5)
        ours, true = sample.calibration.image_from_lidar, SAMPLE.calibration.image_from_lidar
        torch.testing.assert_close(ours, true, rtol=0, atol=1e-6)
    assert dataset[1].timestamp_s == pytest.approx(0.5)


def test_labels_are_the_simulated_ones_of_the_classes_that_were_written(nuscenes, tmp_path):
    import_recording(nuscenes, tmp_path)
    names = ("Car", "Pedestrian", "Cyclist")
    true = SAMPLE.objects
    wanted = true.select(torch.tensor([name in names for name in true.class_names]))
    for sample in open_dataset(tmp_path):
        assert sample.objects.class_names == wanted.class_names
        ours = sample.objects.boxes3d.tensor
        torch.testing.assert_close(ours, wanted.boxes3d.tensor, rtol=0, atol=0.02)


def test_images_take_no_room_and_a_second_run_writes_what_is_missing(nuscenes, tmp_path):
    import_recording(nuscenes, tmp_path / "out")
    image = tmp_path / "out" / "images" / "scene-0001-000.jpg"
    assert image.samefile(nuscenes / "samples" / "CAM_FRONT" / "0.jpg")
    (tmp_path / "out" / "points" / "scene-0001-001.bin").unlink()
    report = import_recording(nuscenes, tmp_path / "out")
    assert (report.written, report.skipped) == (1, 1)


def test_what_no_point_fell_on_is_a_region_and_a_parked_cycle_is_misc(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=1)

    def forget(rows):
        rows[0]["num_lidar_pts"] = 0
        for row in rows:
            row["attribute_tokens"] = []

    edit(tmp_path / "data", "sample_annotation", forget)
    import_recording(tmp_path / "data" / "v1.0-mini", tmp_path / "out")
    (sample,) = open_dataset(tmp_path / "out")
    assert sample.objects.class_names[0] == "DontCare"
    assert "Misc" in sample.objects.class_names
    assert "Cyclist" not in sample.objects.class_names


def test_a_channel_that_is_not_there_is_answered_with_those_that_are(nuscenes, tmp_path):
    with pytest.raises(ValueError, match="CAM_BACK; name one of CAM_FRONT, LIDAR_TOP by --camera"):
        import_recording(nuscenes, tmp_path, camera_topic="CAM_BACK")


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda root: (root / "v1.0-mini/ego_pose.json").unlink(), "ego_pose.json: cannot be read"),
        (lambda root: (root / "v1.0-mini/scene.json").write_text("{"), "scene.json: is no JSON"),
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
def test_a_damaged_file_is_named(tmp_path, damage, said):
    write_nuscenes(tmp_path / "data", num_samples=1)
    damage(tmp_path / "data")
    if not said:  # a sweep of one point in the LiDAR itself is a sweep, of which nothing is left
        with pytest.warns(UserWarning, match=r"0\.pcd\.bin: 1 of 1 points .* none is left"):
            assert import_recording(tmp_path / "data", tmp_path / "out").written == 1
        return
    with pytest.raises(ValueError, match=said):
        import_recording(tmp_path / "data", tmp_path / "out")


def test_key_frames_whose_files_were_not_extracted_are_dropped_and_told(tmp_path):
    write_nuscenes(tmp_path / "data", num_samples=3)
    (tmp_path / "data" / "samples" / "LIDAR_TOP" / "1.pcd.bin").unlink()
    report = import_recording(tmp_path / "data", tmp_path / "out")
    assert "dropped 1 of 3 key frames, whose image or sweep is not there" in str(report)
    assert open_dataset(tmp_path / "out").sample_ids == ("scene-0001-000", "scene-0001-002")
    for path in (tmp_path / "data" / "samples" / "CAM_FRONT").iterdir():
        path.unlink()
    with pytest.raises(ValueError, match=r"lacks the files of all 3 key frames of CAM_FRONT and"):
        import_recording(tmp_path / "data", tmp_path / "other")


@pytest.mark.parametrize(
    ("table", "change", "said"),
    [
        ("ego_pose", list.pop, r"v1.0-mini: has a table without the row or entry 's0-1' that"),
        ("sample_data", lambda rows: rows[0].pop("is_key_frame"), "or entry 'is_key_frame' that"),
        (
            "calibrated_sensor",
            lambda rows: rows[0].update(rotation=[0, 0, 0, 0]),
            "row cc has the quaternion 0 0 0 0",
        ),
    ],
)
def test_a_table_that_does_not_go_with_the_others_is_named(tmp_path, table, change, said):
    write_nuscenes(tmp_path / "data")
    edit(tmp_path / "data", table, change)
    with pytest.raises(ValueError, match=said):
        import_recording(tmp_path / "data", tmp_path / "out")


def test_two_channels_that_are_no_camera_and_lidar_are_refused(nuscenes, tmp_path):
    with pytest.raises(ValueError, match=r"no sample with key frames of LIDAR_TOP and LIDAR_TOP"):
        import_recording(nuscenes, tmp_path, camera_topic="LIDAR_TOP")
