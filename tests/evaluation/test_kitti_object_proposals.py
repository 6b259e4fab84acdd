import io
from dataclasses import replace

import pytest
from rich.console import Console

from sightline.evaluation.kitti_object_proposals import evaluate_proposals
from tests.evaluation.kitti_scenes import Line, random_street, text_of, write_frames
from tests.reference import kitti_object as reference

CAR = Line()
FOUND = replace(CAR, score=0.5)


def entries_of(folders, **options):
    report = evaluate_proposals(*folders, **options)
    return {
        (each.class_name, each.metric, each.iou, each.difficulty): each for each in report.entries
    }


def test_recall_is_that_counted_by_hand(tmp_path):
    files = random_street(2, num_frames=40)
    entries = entries_of(write_frames(tmp_path, files), ious=(0.3, 0.6))
    by_hand = reference.Evaluation(files)
    for (name, metric, iou, difficulty), entry in entries.items():
        counts = []
        for truths, found in by_hand.frames:
            mine = [each for each in found if each.name == name.lower()]
            level = ("easy", "moderate", "hard", None).index(difficulty)
            counted = [
                each
                for each in truths
                if each.name == name.lower()
                and (level == 3 or reference.truth_kind(each, each.name, level) == "valid")
            ]
            hits = [
                any(by_hand.overlap(each, truth, metric) >= iou for each in mine)
                for truth in counted
            ]
            counts.append((sum(hits), len(counted)))
        n_found, n_gt = sum(c[0] for c in counts), sum(c[1] for c in counts)
        recalls = [found / total for found, total in counts if total]
        assert (entry.n_gt, entry.n_found) == (n_gt, n_found)
        assert entry.recall == pytest.approx(100 * n_found / n_gt)
        mean = 100 * sum(recalls) / len(recalls)
        assert entry.recall_frames_with_objects == pytest.approx(mean)
        assert entry.recall_all_frames == pytest.approx(100 * sum(recalls) / len(counts))
    assert len(entries) == 3 * 3 * 2 * 4


def test_frames_without_objects_count_as_zero_in_one_mean_and_not_at_all_in_the_other(tmp_path):
    entries = entries_of(write_frames(tmp_path, [(CAR.text(), FOUND.text()), ("", FOUND.text())]))
    entry = entries["Car", "3d", 0.5, "easy"]
    assert entry.recall == 100
    assert entry.recall_frames_with_objects == 100
    assert entry.recall_all_frames == 50


def test_one_proposal_may_find_several_objects_and_an_equal_overlap_is_enough(tmp_path):
    twins = replace(CAR, name="Cyclist", l=3).moved(ground=1), replace(CAR, name="Cyclist", l=3)
    found = replace(twins[1], score=0.5)
    entries = entries_of(write_frames(tmp_path, [(text_of(twins), found.text())]), ious=(0.5,))
    assert entries["Cyclist", "bev", 0.5, None].n_found == 2


def test_only_the_proposals_of_the_highest_scores_count(tmp_path):
    noise = [FOUND.moved(ground=50 + place, image=900, score=place) for place in range(1, 5)]
    folders = write_frames(tmp_path, [(CAR.text(), text_of([FOUND, *noise]))])
    assert entries_of(folders, max_proposals=4)["Car", "3d", 0.5, "hard"].recall == 0
    assert entries_of(folders, max_proposals=5)["Car", "3d", 0.5, "hard"].recall == 100


def test_the_report_has_json_and_a_table(tmp_path):
    report = evaluate_proposals(*write_frames(tmp_path, [(CAR.text(), FOUND.text())]))
    entry = report.to_json()["entries"][-1]
    assert (entry["class"], entry["metric"], entry["difficulty"]) == ("Car", "3d", "all")
    console = Console(width=80, record=True)
    console.print(report.table())
    text = console.export_text()
    assert "by frame, empty 0" in text
    assert "…" not in text


@pytest.mark.parametrize("options", [{"ious": ()}, {"ious": (0.0,)}, {"max_proposals": 0}])
def test_arguments_out_of_range_are_refused(tmp_path, options):
    with pytest.raises(ValueError, match=r"must be (above 0|positive)"):
        evaluate_proposals(tmp_path, tmp_path, **options)


def test_what_is_left_out_is_counted(tmp_path):
    strange = replace(FOUND, name="[/b]Car").text()
    results, labels = write_frames(tmp_path, [(CAR.text(), FOUND.text() * 3 + strange)])
    (results / "000007.txt").write_text("")
    report = evaluate_proposals(results, labels, max_proposals=2)
    assert report.remarks == (
        "1 result files were left out: no label file has their name (the first is 000007.txt).",
        "2 of 4 proposals were left out: only 2 of a frame are taken.",
        "1 of 4 results were left out: their classes are not scored ([/b]Car 1; Car, Pedestrian, "
        "Cyclist are).",
    )
    assert report.to_json()["notes"] == list(report.remarks)
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(report.table())
    shown = console.export_text()
    assert all(remark[:40] in shown for remark in report.remarks)


def test_where_nothing_is_left_out_there_are_no_notes(tmp_path):
    report = evaluate_proposals(*write_frames(tmp_path, [(CAR.text(), FOUND.text())]))
    assert report.remarks == ()
    assert report.to_json().keys() == {"frames", "entries"}
