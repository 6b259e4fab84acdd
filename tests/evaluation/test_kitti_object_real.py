import tarfile

import pytest

from sightline.data.formats.kitti_labels import read_labels, write_objects
from sightline.evaluation.kitti_object import evaluate_objects


@pytest.fixture(scope="session")
def labels_7481(kitti_root, tmp_path_factory):
    folder = tmp_path_factory.mktemp("kitti")
    with tarfile.open(kitti_root / "labels_and_calib_7481.tar.gz") as archive:
        members = [each for each in archive if each.name.startswith("label_2/")]
        # As an attribute: the argument came with Python 3.11.4.
        archive.extraction_filter = getattr(tarfile, "data_filter", None)
        archive.extractall(folder, members)
    return folder / "label_2"


@pytest.fixture(scope="session")
def labels_as_results(labels_7481, tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    for path in labels_7481.iterdir():
        lines = path.read_text().splitlines()
        found = [f"{line} 0.9\n" for line in lines if not line.startswith("DontCare")]
        (folder / path.name).write_text("".join(found))
    return folder


def test_labels_against_themselves_are_perfect_where_objects_fill_the_slots(
    kitti_root, labels_7481, labels_as_results
):
    listed = kitti_root / "ImageSets" / "val.txt"
    report = evaluate_objects(labels_as_results, labels_7481, sample_list=listed)
    assert report.frames == 3769
    assert len(report.entries) == 27
    for entry in report.entries:
        assert entry.fn.tolist() == [0] * 41
        assert entry.fp.tolist() == [0] * 41
        assert entry.ap_r40 == entry.ap_r11 == 100
        assert entry.max_recall == 1
        assert entry.aos_r40 == (100 if entry.metric == "bbox" else None)
    cars = [entry.n_gt for entry in report.entries if entry.class_name == "Car"]
    assert cars == [2906, 7874, 10960] * 3


def test_labels_against_themselves_fill_as_many_slots_as_there_are_objects_in_a_small_sample(
    kitti_root, labels_7481, labels_as_results
):
    listed = kitti_root / "ImageSets" / "sample_val.txt"
    report = evaluate_objects(labels_as_results, labels_7481, sample_list=listed, bootstrap=5)
    for entry in report.entries:
        filled = min(entry.n_gt, 41)
        assert entry.precision.tolist() == [1.0] * filled + [0.0] * (41 - filled)
        assert entry.ap_r40 == pytest.approx(100 * max(filled - 1, 0) / 40)
        assert entry.all_points is None or entry.all_points.ap == 100


def test_all_label_files_are_written_byte_for_byte_as_they_were_read(labels_7481, tmp_path):
    for path in sorted(labels_7481.iterdir())[::25]:
        write_objects(tmp_path / path.name, read_labels(path))
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()
