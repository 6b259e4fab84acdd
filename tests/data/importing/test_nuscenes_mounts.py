"""LiDARs of nuScenes' tables that are mounted upside down, on their side or turned."""

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from sightline.data.check import check_tree
from sightline.data.formats.kitti_labels import read_labels
from sightline.data.importing.import_recording import import_recording
from sightline.data.open import open_dataset
from sightline.files.problem import FileError
from tests.data.recordings import edit_table, write_nuscenes


def write_mounted(root, new_from_old, *, with_tables=True):
    """Data whose LiDAR is mounted in another way, by its sweeps and usually by its tables."""
    write_nuscenes(root)

    def turn(rows):
        w, *xyz = rows[1]["rotation"]
        x, y, z, w = (Rotation.from_quat([*xyz, w]) * new_from_old.inv()).as_quat().tolist()
        rows[1]["rotation"] = [w, x, y, z]

    if with_tables:
        edit_table(root, "calibrated_sensor", turn)
    for path in (root / "samples" / "LIDAR_TOP").iterdir():
        sweep = np.fromfile(path, np.float32).reshape(-1, 5)
        sweep[:, :3] = new_from_old.apply(sweep[:, :3])
        sweep.tofile(path)
    return root


@pytest.mark.parametrize(
    ("angles_deg", "up"), [((0, 0, 180), "-z"), ((50, 0, 180), "-z"), ((0, 0, 90), "-y")]
)
def test_a_lidar_upside_down_or_on_its_side_is_turned(tmp_path, angles_deg, up):
    import_recording(write_nuscenes(tmp_path / "level"), tmp_path / "expected")
    turn = Rotation.from_euler("zyx", angles_deg, degrees=True)
    report = str(import_recording(write_mounted(tmp_path / "data", turn), tmp_path / "out"))
    assert report.count(f"the LiDAR's {up} points up, by its calibration and the road") == 1
    assert list(check_tree(tmp_path / "out")) == []
    for expected, found in zip(
        open_dataset(tmp_path / "expected"), open_dataset(tmp_path / "out"), strict=True
    ):
        gaps_m, _ = KDTree(expected.points[:, :3]).query(found.points[:, :3])
        assert len(found.points) == len(expected.points)
        assert gaps_m.max() < 0.02
    for path in (tmp_path / "expected" / "labels").iterdir():
        expected, found = map(read_labels, (path, tmp_path / "out" / "labels" / path.name))
        assert found.class_names == expected.class_names
        assert np.abs(found.locations - expected.locations).max() < 0.02
        assert np.abs(found.rotation_y - expected.rotation_y).max() < 0.02


def test_sweeps_upside_down_of_a_lidar_that_is_upright_by_the_tables_are_refused(tmp_path):
    turn = Rotation.from_euler("x", 180, degrees=True)
    data = write_mounted(tmp_path / "data", turn, with_tables=False)
    with pytest.raises(FileError, match="has its road in the direction z"):
        import_recording(data, tmp_path / "out")
