"""Files of an import that a user corrected, or whose source has changed, and a further run."""

import os

import pytest

from sightline.data.check import check_tree
from sightline.data.importing.import_recording import import_recording
from tests.data.recordings import write_bag, write_nuscenes


def test_a_calibration_that_was_corrected_is_kept_by_a_further_import(tmp_path):
    bag = write_bag(tmp_path / "drive", 2)
    import_recording(bag, tmp_path / "out")
    path = tmp_path / "out" / "calibration.yaml"
    made = path.read_text()
    assert "is kept" not in str(import_recording(bag, tmp_path / "out"))
    path.write_text(f"{made}lidar_height_m: 1.55\n")
    (tmp_path / "out" / "points" / "000001.bin").unlink()
    report = str(import_recording(bag, tmp_path / "out"))
    assert "calibration.yaml differs from that of the bag, and is kept" in report
    assert path.read_text() == f"{made}lidar_height_m: 1.55\n"


@pytest.mark.parametrize("place", ["calibration.yml", "calibration.json", "calibration"])
def test_a_calibration_that_was_corrected_in_another_place_is_kept_alone(tmp_path, place):
    bag = write_bag(tmp_path / "drive", 2)
    import_recording(bag, tmp_path / "out")
    made = tmp_path / "out" / "calibration.yaml"
    text = f"{made.read_text()}lidar_height_m: 1.55\n"
    made.unlink()
    names = [place] if "." in place else [f"{place}/00000{number}.yaml" for number in range(2)]
    for name in names:
        (tmp_path / "out" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "out" / name).write_text(text)
    report = str(import_recording(bag, tmp_path / "out"))
    assert report.count("kept") == 1
    assert not made.exists()
    assert list(check_tree(tmp_path / "out")) == []
    if place == "calibration":  # a frame without one needs that of all
        (tmp_path / "out" / names[0]).unlink()
        assert "kept" not in str(import_recording(bag, tmp_path / "out"))
        assert made.exists()


@pytest.mark.parametrize("name", ["times.txt", "Times.TXT"])
def test_times_that_were_corrected_are_kept_by_a_further_import(tmp_path, name):
    bag = write_bag(tmp_path / "drive", 3)
    import_recording(bag, tmp_path / "out")
    path = tmp_path / "out" / "times.txt"
    made = path.read_text()
    path.write_text(made.partition("\n")[0])  # as by a stopped import, or after faulty frames
    assert "is kept" not in str(import_recording(bag, tmp_path / "out"))
    assert path.read_text() == made
    path.unlink()
    path = path.with_name(name)
    path.write_text(made.replace("000001 2.", "000001 5."))
    report = str(import_recording(bag, tmp_path / "out"))
    assert f"{name} differs from the times of the source, and is kept" in report
    assert path.read_text() == made.replace("000001 2.", "000001 5.")
    assert len(list((tmp_path / "out").glob("[tT]imes*"))) == 1


def test_times_calibrations_and_labels_that_were_corrected_are_kept_by_a_further_import(tmp_path):
    nuscenes = write_nuscenes(tmp_path / "nuscenes")
    import_recording(nuscenes, tmp_path / "out")
    times = tmp_path / "out" / "times.txt"
    corrected = [tmp_path / "out" / "labels" / "scene-0001-000.txt"]
    corrected.append(tmp_path / "out" / "calibration" / "scene-0001-000.yaml")
    for path in corrected:
        path.write_text(f"{path.read_text()}\n")
    times.write_text(times.read_text().replace("0.5", "0.6"))
    texts = [path.read_text() for path in (times, *corrected)]
    (tmp_path / "out" / "points" / "scene-0001-000.bin").unlink()
    report = import_recording(nuscenes, tmp_path / "out")
    assert report.written == 1
    assert "times.txt differs from the times of the source, and is kept" in str(report)
    assert [path.read_text() for path in (times, *corrected)] == texts


@pytest.mark.parametrize("kind", ["mcap", "folder", "nuscenes"])
def test_kept_frames_that_are_older_than_their_source_are_told_with_the_remedy(tmp_path, kind):
    out = tmp_path / "out"
    if kind == "nuscenes":
        data = write_nuscenes(tmp_path / "data")
        source = data / "samples" / "LIDAR_TOP" / "1.pcd.bin"
        told = "of 2 frames that were there already, 1 are older than their source, the first is "
        told += "scene-0001-001"
    else:
        data = write_bag(tmp_path / "data", 2)
        (source,) = data.glob("*.mcap")
        data = source if kind == "mcap" else data
        told = "of 2 frames that were there already, 2 are older than their source, the first is "
        told += "000000"
    import_recording(data, out)
    unchanged = import_recording(data, out).notes
    assert not [note for note in unchanged if "there already" in note]
    kept = {path: path.read_bytes() for path in out.rglob("*.*")}
    later_ns = source.stat().st_mtime_ns + 10**10
    os.utime(source, ns=(later_ns, later_ns))
    report = import_recording(data, out)
    (note,) = set(report.notes) - set(unchanged)
    assert note.startswith(f"warning: {told}: ")
    assert note.endswith(f"to import them anew, name another folder or remove {out}")
    assert [each for each in report.notes if each != note] == list(unchanged)
    assert {path: path.read_bytes() for path in out.rglob("*.*")} == kept
    for cloud in (out / "points").iterdir():
        cloud.unlink()
    assert "there already," not in str(import_recording(data, out))
