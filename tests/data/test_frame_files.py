import pytest

from sightline.data.frame_files import require_frame_files
from sightline.evaluation.kitti_object import frame_names


def refusal(folder) -> str:
    with pytest.raises(ValueError, match="has no result file for 2 of 2 frames") as caught:
        require_frame_files(folder, ["000000", "000001"], "result", "write them")
    return str(caught.value)


def test_results_in_the_folder_data_are_found_and_named(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "000000.txt").write_text("")
    assert refusal(tmp_path).endswith(
        f"they are in {tmp_path / 'data'}, as KITTI's own program writes them; name that folder"
    )
    (tmp_path / "data" / "000000.txt").unlink()
    assert refusal(tmp_path).endswith(": write them")


def test_files_of_other_frames_or_formats_are_told(tmp_path):
    (tmp_path / "0.json").write_text("")
    assert "holds 1 files of another format, such as 0.json; write one NAME.txt" in refusal(
        tmp_path
    )
    (tmp_path / "000007.txt").write_text("")
    assert "holds 1 of other frames, such as 000007.txt; name a list" in refusal(tmp_path)


def test_labels_of_another_format_are_told(tmp_path):
    with pytest.raises(ValueError, match=r"no label files .*; give KITTI's folder label_2"):
        frame_names(tmp_path, None)
    (tmp_path / "000000.xml").write_text("")
    with pytest.raises(ValueError, match=r"1 files of another format, such as 000000\.xml"):
        frame_names(tmp_path, None)
