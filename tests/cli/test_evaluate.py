from dataclasses import replace
from pathlib import Path

import pytest

from sightline.cli.main import main
from sightline.simulation.packaged import PACKAGED_FRAMES
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
    plots = tmp_path / "plots"
    assert main([*command, *options, "--plots", str(plots)]) in (0, None)
    printed = capsys.readouterr().out
    assert all(band in printed for band in ("0-10 m", "10-20.5 m", "20.5 m on"))
    assert printed.count("AP R40") == printed.count("AP all points") == 3 * (1 + 3)
    assert "1 frame had no result file" in printed
    assert all((tmp_path / name).stat().st_size > 100 for name in files)
    assert f"{plots}: 12 pictures" in printed
    bands = ("", "_0-10_m", "_10-20.5_m", "_20.5_m_on")
    names = {f"Car_{metric}{band}.png" for metric in ("bbox", "bev", "3d") for band in bands}
    assert {path.name for path in plots.iterdir()} == names


def test_all_files_are_written_though_the_reader_of_the_table_has_gone(
    folders, tmp_path, monkeypatch
):
    def closed(_table):
        raise BrokenPipeError

    monkeypatch.setattr("sightline.cli.report.show_table", closed)
    files = [tmp_path / name for name in ("all.json", "scores.csv", "scores.md")]
    options = [f"--{file.suffix[1:].replace('md', 'markdown')}={file}" for file in files]
    command = ["evaluate", "objects", *folders, "--missing-as-empty", *options]
    main([*command, "--plots", str(tmp_path / "plots")])
    assert all(file.stat().st_size > 100 for file in files)
    assert list((tmp_path / "plots").iterdir())


def test_a_table_says_that_few_objects_cannot_fill_the_recall_positions(folders, capsys):
    assert main(["evaluate", "objects", *folders, "--missing-as-empty"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "2 of Car, easy, give R40 of at most 2.5" in printed


def test_of_nothing_there_are_no_pictures(folders, tmp_path, capsys):
    for path in Path(folders[0]).iterdir():
        path.write_text("")
    plots = tmp_path / "plots"
    options = ["--missing-as-empty", "--plots", str(plots)]
    assert main(["evaluate", "objects", *folders, *options]) == 0
    assert f"{plots}: 0 pictures" in capsys.readouterr().out
    assert not list(plots.glob("*"))


def test_a_place_that_cannot_be_written_to_is_refused_before_the_work(folders, tmp_path, capsys):
    assert main(["evaluate", "objects", *folders, "--csv", str(tmp_path)]) != 0
    assert str(tmp_path) in capsys.readouterr().err
    file = tmp_path / "file"
    file.write_text("")
    assert main(["evaluate", "objects", *folders, "--plots", str(file)]) == 2
    printed = capsys.readouterr()
    assert f"{file} is no folder: {file} is a file; name another folder" in printed.err
    assert not printed.out


def test_a_picture_without_values_says_why_it_is_empty(tmp_path, capsys):
    frame = (text_of([CAR]), text_of([replace(CAR, score=1, z=-1000)]))
    results, labels = write_frames(tmp_path, [frame])
    picture = tmp_path / "reliability.png"
    command = ["evaluate", "calibration", str(results), str(labels), "--metric", "3d"]
    assert main([*command, "--picture", str(picture)]) == 2
    error = capsys.readouterr().err
    assert f"{picture} cannot be drawn: none of 1 results is of a class and has values" in error
    assert "another --metric" in error
    assert not picture.exists()


def test_files_never_replace_each_other_or_what_is_scored(folders, tmp_path, capsys):
    same = str(tmp_path / "same")
    assert main(["evaluate", "objects", *folders, "--csv", same, "--markdown", same]) == 2
    assert f"--csv and --markdown are both {same}" in capsys.readouterr().err
    for command in (["evaluate", "calibration", *folders], ["health", str(PACKAGED_FRAMES)]):
        assert main([*command, "--json", same, "--picture", same]) == 2
        assert f"--json and --picture are both {same}" in capsys.readouterr().err
    for folder in folders:
        result = Path(folder) / "000000.txt"
        before = result.read_bytes()
        for what in ("objects", "calibration"):
            assert main(["evaluate", what, *folders, "--json", str(result)]) == 2
            error = capsys.readouterr().err
            assert "among the input results" in error or "would change the data set" in error
            assert result.read_bytes() == before
    beside = Path(folders[0]) / "objects.json"
    for _ in range(2):  # a report beside them may be written anew
        command = ["evaluate", "objects", *folders, "--missing-as-empty"]
        assert main([*command, "--json", str(beside)]) == 0


@pytest.mark.parametrize("command", ["objects", "proposals", "calibration"])
def test_results_are_not_scored_against_themselves(command, tmp_path, capsys):
    (tmp_path / "000000.txt").write_text("Car 0 0 0 1 1 50 50 1.5 1.6 4 0 1.6 20 0 0.9\n")
    assert main(["evaluate", command, str(tmp_path), f"{tmp_path}/."]) == 2
    assert "named both as the results and as the labels" in capsys.readouterr().err
