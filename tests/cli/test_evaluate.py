from dataclasses import replace

import pytest

from sightline.cli.main import main
from tests.evaluation.kitti_scenes import Line, text_of, write_frames

CAR = Line(z=15)


@pytest.fixture
def folders(tmp_path):
    results, labels = write_frames(tmp_path, [(text_of([CAR]), text_of([replace(CAR, score=1)]))])
    (labels / "000001.txt").write_text(text_of([CAR]))
    return [str(results), str(labels)]


def test_scores_by_distance_go_to_people_and_to_files(folders, tmp_path, capsys):
    files = [str(tmp_path / name) for name in ("all.json", "scores.csv", "scores.md")]
    options = [
        word for pair in zip(("--json", "--csv", "--markdown"), files, strict=True) for word in pair
    ]
    command = ["evaluate", "objects", *folders, "--missing-as-empty", "--by-distance", "10", "20.5"]
    assert main([*command, *options]) in (0, None)
    told = capsys.readouterr().out
    assert all(band in told for band in ("0-10 m", "10-20.5 m", "20.5 m on"))
    assert "1 frames had no result file" in told
    assert all((tmp_path / name).stat().st_size > 100 for name in files)


def test_a_place_that_cannot_be_written_to_is_refused_before_the_work(folders, tmp_path, capsys):
    assert main(["evaluate", "objects", *folders, "--csv", str(tmp_path)]) != 0
    assert str(tmp_path) in capsys.readouterr().err
