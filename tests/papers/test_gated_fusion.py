"""The tables and figures of the gated fusion paper, by tiny networks on the embedded frames."""

import json
import re
import statistics
from dataclasses import replace

import pytest
from rich.console import Console

from sightline.cli.main import main
from sightline.corruptions.generate import corrupt_dataset
from sightline.corruptions.suites import find_suite
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.formats.image_file import read_rgb
from sightline.data.layouts.frame_lists import read_sample_list
from sightline.detection2d.config import PostprocessConfig
from sightline.detection2d.predictor import DetectionPredictor
from sightline.detection2d.registration import TASK
from sightline.evaluation.kitti_object import evaluate_objects
from sightline.inference.predict import predict
from sightline.papers.gated_fusion import FULL, TABLE_1, GatedFusionReport
from sightline.papers.gated_fusion_cases import System, detect_in_cases, reproduce_gated_fusion
from sightline.papers.rows import GivenNetwork, is_published_split
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.detection2d.frames import TINY, write_network

SUITE = find_suite("dgfn7")
FRAMES = ("000000", "000001")
LABELS = PACKAGED_FRAMES / "training" / "label_2"
OTHER = GivenNetwork(name="any", design="any", departures=("width 0.03",))
FEW = PostprocessConfig(min_score=0.2, max_detections=10)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Of every way of fusion, drawn at random."""
    folder = tmp_path_factory.mktemp("weights")
    for fusion in ("gated", "ones", "camera"):
        config = replace(TINY, fusion=fusion, postprocess=FEW)
        write_network(folder / f"{fusion}.safetensors", config)
    return {path.stem: path for path in folder.iterdir()}


@pytest.fixture(scope="module")
def run(weights, tmp_path_factory):
    """A report, the folder that it was made in and that of its figures."""
    out, figures = (tmp_path_factory.mktemp(name) for name in ("out", "figures"))
    report = reproduce_gated_fusion(
        PACKAGED_FRAMES, weights, out, figures=figures, figure_frame="000001", workers=1, seed=3
    )
    return report, out, figures


def text(report):
    console = Console(width=200)
    with console.capture() as captured:
        console.print(report.table())
    return captured.get()


def files_of(folder):
    return {
        path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


def test_published_figures_are_quoted_and_open_cells_say_what_they_need(run):
    printed = text(run[0])
    for levels in (
        TABLE_1["late"]["lidar_occlusion"],
        TABLE_1["ones"][FULL],
        (94.49, 89.65, 80.97),
    ):
        assert " ".join(f"{value:6.2f}" for value in levels) in printed
    assert printed.count("needs --early WEIGHTS") == printed.count("needs --late WEIGHTS") == 8
    assert printed.count("needs --lidar WEIGHTS") == 1
    assert "recipe detection2d-dgfn-kitti), without --gated --ones --early" in printed
    assert "does not compare with the published figures" in printed


def test_a_row_of_the_paper_is_filled_by_its_own_network_alone(run):
    report = run[0]
    gated = report.systems["gated"]
    figures = " ".join(f"{value:6.2f}" for value in gated.cases["lidar_blank"].max_recall)
    published = " ".join(f"{value:6.2f}" for value in TABLE_1["gated"]["lidar_blank"])
    printed = text(report)
    row = next(line for line in printed.splitlines() if published in line)
    assert "needs --gated WEIGHTS" in row
    assert figures not in row
    assert printed.count("not the paper's: gated: DGFN, width 0.03,") == 9  # Table I and II
    assert "Not the paper's network: gated (width 0.03" in printed
    as_papers = replace(gated.network, departures=())
    printed = text(replace(report, systems={"gated": replace(gated, network=as_papers)}))
    row = next(line for line in printed.splitlines() if published in line)
    assert "gated: DGFN, width 0.03, steps unknown" in row
    assert figures in row
    assert "needs --gated" not in printed


def test_without_data_the_published_figures_stand_alone():
    report = reproduce_gated_fusion()
    assert isinstance(report, GatedFusionReport)
    printed = text(report)
    assert "98.69  90.31  82.16" in printed
    assert printed.rstrip().splitlines()[-1] == (
        "Not measured: ours, without --data KITTI and weights."
    )
    assert report.to_json()["networks"] == {}
    with pytest.raises(ValueError, match="name KITTI's object tree with --data"):
        reproduce_gated_fusion(None, {"gated": "detection2d-best"})


def test_the_published_row_of_all_is_the_mean_of_the_others_but_for_one_misprint():
    off = {}
    for fusion, rows in TABLE_1.items():
        means = [
            statistics.fmean(rows[case.name][level] for case in SUITE.cases) for level in range(3)
        ]
        off |= {
            (fusion, level): abs(mean - printed)
            for level, (mean, printed) in enumerate(zip(means, rows[FULL], strict=True))
        }
    assert off.pop(("ones", 2)) == pytest.approx(0.506, abs=0.001)
    assert max(off.values()) < 0.011


def test_what_is_found_is_what_corrupt_and_predict_give(run, weights, tmp_path):
    _, out, _ = run
    name = "camera_occlusion"
    corrupt_dataset(
        PACKAGED_FRAMES, tmp_path, suite="dgfn7", seed=3, cases=[name, "lidar_blank"], workers=1
    )
    predictor = DetectionPredictor.load(weights["gated"], threads=1)
    for case in (name, "lidar_blank"):
        predict(TASK, predictor, tmp_path / case, tmp_path / "found" / case, workers=1)
        for frame in FRAMES:
            expected = (tmp_path / "found" / case / f"{frame}.txt").read_text()
            assert expected
            assert (out / "gated" / case / f"{frame}.txt").read_text() == expected


def test_a_second_call_makes_what_is_missing_and_nothing_else(run, weights):
    _, out, _ = run
    before = files_of(out)
    (out / "gated" / "camera_blank" / "000001.txt").unlink()
    (out / "ones" / "clean" / "000000.txt").unlink()
    dataset = KittiObjectDataset(PACKAGED_FRAMES)
    systems = [
        System(
            fusion=fusion,
            predictor=DetectionPredictor.load(weights[fusion], threads=1),
            network=OTHER,
            cases=SUITE.cases,
        )
        for fusion in ("gated", "ones")
    ]
    done = detect_in_cases(dataset, systems, out, suite=SUITE, seed=3, workers=1)
    assert (done.written, done.skipped) == (2, 26)
    assert files_of(out) == before
    assert detect_in_cases(dataset, systems, out, suite=SUITE, seed=3).written == 0


def test_detectors_of_one_sensor_are_asked_in_the_clean_case_only(run):
    report, out, _ = run
    assert [path.name for path in (out / "camera").iterdir() if path.is_dir()] == ["clean"]
    assert set(report.systems["camera"].cases) == {"clean"}


def test_files_of_other_weights_or_another_seed_are_not_mixed(run, weights, tmp_path):
    _, out, _ = run
    other = tmp_path / "gated.safetensors"
    write_network(other, DetectionPredictor.load(weights["gated"])._config, seed=1)
    with pytest.raises(ValueError, match="files made with weights_sha256"):
        reproduce_gated_fusion(PACKAGED_FRAMES, {"gated": other}, out, seed=3)
    with pytest.raises(ValueError, match="files made with seed 3 instead of 4"):
        reproduce_gated_fusion(PACKAGED_FRAMES, {"gated": weights["gated"]}, out, seed=4)


@pytest.fixture
def with_cars_found(weights, tmp_path):
    """A folder in which the network without gates found the labelled objects, and no others."""
    out = tmp_path / "out"
    given = {"ones": weights["ones"]}
    reproduce_gated_fusion(PACKAGED_FRAMES, given, out, sample_list=["000000"], workers=1)
    lines = (LABELS / "000000.txt").read_text().splitlines()
    for case in ("clean", "camera_noise"):
        left = lines if case == "clean" else lines[::2]
        result = "".join(f"{line} 0.9\n" for line in left if not line.startswith("DontCare"))
        (out / "ones" / case / "000000.txt").write_text(result)
    return given, out


def test_every_cell_is_what_evaluate_objects_gives(with_cars_found):
    given, out = with_cars_found
    report = reproduce_gated_fusion(
        PACKAGED_FRAMES, given, out, sample_list=["000000"], bootstrap=20, workers=1
    )
    system = report.systems["ones"]
    for case in ("clean", "camera_noise"):
        scored = evaluate_objects(out / "ones" / case, LABELS, sample_list=["000000"], bootstrap=20)
        entries = [e for e in scored.entries if (e.class_name, e.metric) == ("Car", "bbox")]
        assert system.cases[case].ap_r40 == tuple(entry.ap_r40 for entry in entries)
        assert system.cases[case].ap_r11 == tuple(entry.ap_r11 for entry in entries)
        assert system.cases[case].max_recall == tuple(100 * e.max_recall for e in entries)
        points = tuple(entry.all_points.ap for entry in entries)
        assert system.cases[case].ap_all_points == points
    assert system.cases["clean"].max_recall[2] == 100
    assert system.cases["clean"].ap_r40[2] > system.cases["camera_noise"].ap_r40[2] > 0
    moderate = [system.cases[case.name].ap_r11[1] for case in SUITE.cases]
    assert system.full.ap_r11[1] == pytest.approx(statistics.fmean(moderate))
    assert "ours, all points" in text(report)


def test_a_damaged_file_of_the_run_is_to_be_removed(with_cars_found):
    given, out = with_cars_found
    (out / "ones" / "clean" / "000000.txt").write_text("Car 0 0")
    with pytest.raises(ValueError, match=r"line 1 has 3 fields, .*; remove it and run the same"):
        reproduce_gated_fusion(PACKAGED_FRAMES, given, out, sample_list=["000000"], workers=1)


def test_another_class_and_another_overlap_take_the_same_files(with_cars_found):
    given, out = with_cars_found
    settings = {"sample_list": ["000000"], "workers": 1}
    people = reproduce_gated_fusion(
        PACKAGED_FRAMES, given, out, class_name="Pedestrian", **settings
    )
    assert (people.iou, people.is_comparable) == (0.5, False)
    loose = reproduce_gated_fusion(PACKAGED_FRAMES, given, out, iou=0.25, **settings)
    assert loose.iou == 0.25
    assert "Car, IoU 0.25" in text(loose)
    with pytest.raises(ValueError, match="overlap bbox must be at least 0 and below 1"):
        reproduce_gated_fusion(PACKAGED_FRAMES, given, out, iou=1.5, **settings)


def test_the_gates_of_every_case_are_told(run):
    report, out, _ = run
    assert [case.case for case in report.gates] == list(SUITE.case_names)
    by_case = {case.case: case for case in report.gates}
    frames = [
        json.loads((out / "gated" / "camera_blank" / "gates" / f"{name}.json").read_text())
        for name in FRAMES
    ]
    means = [frame["camera"]["mean"] for frame in frames]
    assert by_case["camera_blank"].scores["camera"].mean == pytest.approx(statistics.fmean(means))
    assert (
        by_case["camera_blank"].scores["camera"].auroc_cells is None
    )  # nothing is left to compare with
    assert by_case["camera_blank"].scores["camera"].auroc_clean_cells is not None
    assert by_case["camera_blank"].scores["lidar"].auroc_frames is None
    assert 0 < by_case["lidar_occlusion"].scores["lidar"].auroc_cells < 1
    assert by_case["clean"].scores["camera"].masked_mean is None
    assert re.search(r"Lidar \+ RGB \(blank\) +camera +0\.\d{3}", text(report))


def test_published_figures_stand_only_beside_what_they_measure(run):
    printed = text(replace(run[0], class_name="Pedestrian", iou=0.5))
    assert "nothing was published for these" in printed
    for levels in (TABLE_1["ones"][FULL], (94.49, 89.65, 80.97)):
        assert " ".join(f"{value:6.2f}" for value in levels) not in printed


def test_the_figures_show_every_case(run):
    _, _, figures = run
    means, maps = (read_rgb(figures / f"gate_{name}.png") for name in ("means", "maps"))
    assert means.shape[0] >= 4 * 190
    assert maps.shape[0] >= 7 * 180
    assert maps.std() > 20


def test_the_file_for_scripts_holds_what_the_tables_say(run):
    report, _, _ = run
    saved = json.loads(json.dumps(report.to_json()))
    assert saved["comparable_with_published"] is False
    assert saved["table_1"]["early"]["ours"] is None
    ours = saved["table_1"]["gated"]["ours"]
    assert list(ours)[:3] == ["name", "is_papers", "full"]
    assert ours["clean"]["ap_r11"] == list(report.systems["gated"].cases["clean"].ap_r11)
    assert saved["table_2"]["ours"]["camera"]["name"] == "camera"
    assert [case["case"] for case in saved["gates"]] == list(SUITE.case_names)


def test_only_the_val_split_of_kitti_compares_with_the_published_figures(run, monkeypatch):
    report, _, _ = run
    assert replace(report, is_published_split=True).is_comparable
    assert not replace(report, is_published_split=True, iou=0.5).is_comparable
    dataset = KittiObjectDataset(PACKAGED_FRAMES)
    assert not is_published_split(dataset)
    monkeypatch.setattr(
        KittiObjectDataset, "sample_ids", read_sample_list("kitti-object-val", PACKAGED_FRAMES)
    )
    assert is_published_split(dataset)


def test_what_makes_no_sense_is_refused_before_anything_is_done(weights, tmp_path):
    out = tmp_path / "out"
    ones = {"ones": weights["ones"]}
    for given, settings, printed in (
        ({"gated": weights["ones"]}, {}, "ones is a network of fusion ones, expected gated; give"),
        (ones, {"figure_frame": "000009"}, "frame 000009 to draw is not among the 2 frames"),
        (ones, {"suite": "dgfn8"}, "perhaps dgfn7"),
        (ones, {"workers": 0}, "workers must be at least 1"),
        (ones, {"seed": -1}, "seed must not be negative"),
    ):
        with pytest.raises(ValueError, match=printed):
            reproduce_gated_fusion(PACKAGED_FRAMES, given, out, **settings)
    assert not out.exists()


def test_data_without_labels_are_refused(weights, tmp_path):
    (tmp_path / "testing").symlink_to(PACKAGED_FRAMES / "training")
    with pytest.raises(ValueError, match="with labels to score against"):
        reproduce_gated_fusion(tmp_path, {"ones": weights["ones"]}, tmp_path / "out")


def test_the_command_prints_the_tables_and_names_the_pictures(run, weights, tmp_path, capsys):
    _, out, _ = run
    command = ["reproduce", "gated-fusion", "--data", str(PACKAGED_FRAMES), "--out", str(out)]
    command += ["--gated", str(weights["gated"]), "--seed", "3", "--workers", "1"]
    command += ["--figures", str(tmp_path), "--json", str(tmp_path / "report.json")]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert "Table II: sound sensors" in printed
    assert printed.splitlines()[-1] == str(tmp_path / "gate_maps.png")
    assert json.loads((tmp_path / "report.json").read_text())["frames"] == 2


@pytest.mark.parametrize("weights", [None, {"camera": "detection2d-fast-cpu"}])
def test_figures_without_a_gated_network_are_refused_before_work(tmp_path, weights):
    data = None if weights is None else PACKAGED_FRAMES
    with pytest.raises(ValueError, match=r"the figures show gates; .*--gated.* leave the figures"):
        reproduce_gated_fusion(data, weights, tmp_path / "out", figures=tmp_path / "figures")
    assert not (tmp_path / "out").exists()


def test_streams_of_networks_with_joint_maps_are_compared(run):
    report, _, _ = run
    recorded = report.to_json()["stream_similarity"]
    assert recorded.keys() == {"gated", "ones"}
    for fusion, values in recorded.items():
        assert tuple(values) == report.systems[fusion].similarity
        assert all(each is None or 0 <= each <= 1 + 1e-9 for each in values)
    assert "Similarity of both streams' features" in text(report)
