import math
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from sightline.evaluation.kitti_object import evaluate_objects
from sightline.evaluation.kitti_object_matching import find_thresholds
from sightline.evaluation.kitti_object_rules import (
    DIFFICULTIES,
    LOOSE,
    STRICT,
    ClassOverlaps,
    MinimumOverlaps,
)
from tests.evaluation.kitti_scenes import (
    MISSING,
    Line,
    random_crowd,
    random_street,
    submissions,
    text_of,
    write_frames,
)
from tests.reference import kitti_object as reference

LOOSE_OVERLAPS = {
    "Car": (0.7, 0.5, 0.5),
    "Pedestrian": (0.5, 0.25, 0.25),
    "Cyclist": (0.5, 0.25, 0.25),
}


def evaluate(files, overlaps=STRICT, **options):
    """Entries by class, metric and difficulty."""
    with TemporaryDirectory() as folder:
        results, labels = write_frames(Path(folder), files)
        report = evaluate_objects(results, labels, overlaps=overlaps, **options)
    return {(each.class_name, each.metric, each.difficulty): each for each in report.entries}


def assert_equal(entries, expected):
    assert list(entries) == list(expected)
    for key, scores in expected.items():
        entry = entries[key]
        assert entry.n_gt == scores.n_gt, key
        assert entry.thresholds.tolist() == scores.thresholds, key
        assert entry.tp.tolist() == scores.tp, key
        assert entry.fp.tolist() == scores.fp, key
        assert entry.fn.tolist() == scores.fn, key
        assert entry.precision.tolist() == pytest.approx(scores.precision, abs=1e-12), key
        assert entry.ap_r11 == pytest.approx(scores.ap_r11, abs=1e-9), key
        assert entry.ap_r40 == pytest.approx(scores.ap_r40, abs=1e-9), key
        assert entry.aos_r11 == pytest.approx(scores.aos_r11, abs=1e-9), key
        assert entry.aos_r40 == pytest.approx(scores.aos_r40, abs=1e-9), key
        assert entry.flipped_share == scores.flipped_share, key
        assert 0 <= entry.max_recall <= 1, key
        assert_same_curve(entry, scores)


def assert_same_curve(entry, scores):
    """The curve that is drawn has the points that the counts by hand give."""
    curve = entry.curve()
    points = list(zip(curve.recall.tolist(), curve.precision.tolist(), strict=True))
    by_hand = [
        (tp / scores.n_gt, tp / (tp + fp) if tp + fp else 0)
        for tp, fp in zip(scores.tp, scores.fp, strict=True)
    ]
    assert points == by_hand
    assert curve.slots.tolist() == pytest.approx(scores.precision, abs=1e-12)
    best = [max(precision for _, precision in points[slot:]) for slot in range(len(points))]
    assert curve.slots.tolist() == best + [0] * (41 - len(best))
    assert curve.ap_r40 == pytest.approx(100 * sum(scores.precision[1:]) / 40, abs=1e-9)
    assert curve.ap_r11 == pytest.approx(100 * sum(scores.precision[::4]) / 11, abs=1e-9)
    assert curve.num_objects == scores.n_gt


@settings(max_examples=100)
@given(files=submissions(), is_loose=st.booleans())
def test_any_scene_gives_the_counts_that_the_rules_give_by_hand(files, is_loose):
    by_hand = reference.Evaluation(files, LOOSE_OVERLAPS if is_loose else reference.STRICT)
    assume(not by_hand.is_ambiguous())
    assert_equal(evaluate(files, LOOSE if is_loose else STRICT), by_hand.run())


@pytest.mark.parametrize("seed", range(3))
def test_many_frames_give_the_counts_that_the_rules_give_by_hand(seed):
    files = random_street(seed, num_frames=60)
    by_hand = reference.Evaluation(files, LOOSE_OVERLAPS)
    assert not by_hand.is_ambiguous()
    entries = evaluate(files, LOOSE)
    assert_equal(entries, by_hand.run())
    assert len(entries["Car", "bbox", "hard"].thresholds) > 20


@pytest.mark.parametrize("seed", range(4))
def test_crowds_full_of_ties_give_the_counts_that_the_rules_give_by_hand(seed):
    files = random_crowd(seed, num_frames=150)
    by_hand = reference.Evaluation(files)
    assert not by_hand.is_ambiguous()
    assert_equal(evaluate(files), by_hand.run())


# Traps, one by one. CAR is a car in plain sight, 60 px high; FOUND a detection right on it.
CAR = Line()
FOUND = replace(CAR, score=0.5)
OTHER = FOUND.moved(image=1000, ground=100)
SMALL = {"y2": CAR.y1 + 39}


def easy(labels, found, metric="bbox", name="Car", **options):
    """The entry of one frame at the easy level."""
    entries = evaluate([(text_of(labels), text_of(found))], **options)
    return entries[name, metric, "easy"]


def counts(entry):
    return entry.tp.tolist(), entry.fp.tolist(), entry.fn.tolist()


def test_of_equal_scores_the_first_in_the_file_is_matched():
    big = CAR.moved(y2=CAR.y1 + 50)
    small = replace(big, score=0.5, y2=big.y1 + 39.5)
    assert easy([big], [small, FOUND]).thresholds.size == 0
    assert easy([big], [FOUND, small]).thresholds.tolist() == [0.5]


def test_a_score_of_minus_ten_million_is_never_matched():
    assert easy([CAR], [replace(FOUND, score=-1e7)]).thresholds.size == 0
    assert easy([CAR], [replace(FOUND, score=-1e7 + 1)]).thresholds.size == 1


def test_of_equal_overlaps_the_first_in_the_file_is_taken():
    left, right = FOUND.moved(image=-4, alpha=0), FOUND.moved(image=4, alpha=math.pi)
    assert easy([CAR], [left, right]).aos_r11 > 0
    assert easy([CAR], [right, left]).aos_r11 == 0


def test_a_detection_found_by_overlap_replaces_a_small_one_even_with_less_overlap():
    big = CAR.moved(y2=CAR.y1 + 41)
    small = replace(big, score=0.5, y2=big.y1 + 39.5)
    apart = replace(big, score=0.9).moved(image=15)
    assert counts(easy([big], [small, apart])) == ([1], [0], [0])
    assert counts(easy([big], [apart, small])) == ([1], [0], [0])


def test_of_several_small_detections_the_first_in_the_file_is_taken():
    low = replace(CAR, y2=CAR.y1 + 41)
    beside = low.moved(image=24)
    on_both, on_one = (replace(low, score=1, **SMALL).moved(image=by) for by in (12, 4))
    labels, seen = [low, beside], FOUND.moved(image=500)
    labels.append(replace(seen, score=None))
    assert counts(easy(labels, [on_one, on_both, seen])) == ([1], [0], [0])
    assert counts(easy(labels, [on_both, on_one, seen])) == ([1], [0], [1])


def test_a_small_detection_of_any_class_hides_a_truth():
    low, high = replace(CAR, y2=CAR.y1 + 41), CAR.moved(image=500, ground=50)
    cat = replace(low, name="Cat", y2=CAR.y1 + 39, score=0.9)
    entry = easy([low, high], [cat, replace(high, score=0.5)])
    assert entry.n_gt == 2
    assert counts(entry) == ([1], [0], [0])  # without the cat the low one is missed
    assert counts(easy([low, high], [replace(high, score=0.5)])) == ([1], [0], [1])


def test_a_small_detection_is_no_false_positive():
    assert counts(easy([CAR], [FOUND, replace(OTHER, **SMALL)])) == ([1], [0], [0])
    assert counts(easy([CAR], [FOUND, OTHER])) == ([1], [1], [0])


@pytest.mark.parametrize(
    ("metric", "changes"),
    [
        ("bbox", {"x1": CAR.x1 + 10, "x2": CAR.x1 + 40}),
        ("bev", {"x": CAR.x + 1}),
        ("3d", {"y": CAR.y + 1}),
    ],
)
def test_an_overlap_equal_to_the_limit_is_no_match(metric, changes):
    person = replace(CAR, name="Pedestrian", x2=CAR.x1 + 30, l=3, h=3)
    found = replace(person, score=0.5, **changes)
    assert easy([person], [found], metric, "Pedestrian").thresholds.size == 0
    overlaps = MinimumOverlaps(pedestrian=ClassOverlaps(bbox=0.499, bev=0.499, box3d=0.499))
    entry = easy([person], [found], metric, "Pedestrian", overlaps=overlaps)
    assert entry.thresholds.size == 1


def test_a_truth_of_exactly_forty_pixels_is_ignored_and_a_detection_of_them_is_not_small():
    edge = replace(CAR, y2=CAR.y1 + 40)
    entry = easy([edge, CAR], [FOUND, replace(OTHER, y2=OTHER.y1 + 40)])
    assert entry.n_gt == 1
    assert counts(entry) == ([1], [1], [0])
    assert counts(easy([CAR], [FOUND, replace(OTHER, y2=OTHER.y1 + 39.99)])) == ([1], [0], [0])


def test_occlusion_truncation_and_height_set_the_difficulty():
    labels = [
        CAR,
        replace(CAR, occlusion=1),
        replace(CAR, truncation=0.3),
        replace(CAR, y2=CAR.y1 + 25.5),
        replace(CAR, occlusion=2),
        replace(CAR, truncation=0.5),
        replace(CAR, occlusion=3),
        replace(CAR, truncation=0.51),
        replace(CAR, y2=CAR.y1 + 25),
    ]
    entries = evaluate([(text_of(labels), FOUND.text())])
    assert [entries["Car", "bbox", level].n_gt for level in DIFFICULTIES] == [1, 4, 6]


def test_vans_and_sitting_persons_are_never_missed_and_may_be_found():
    van = CAR.moved(image=500, ground=50, name="van")
    assert counts(easy([CAR, van], [FOUND, replace(van, name="car", score=1)])) == ([1], [0], [0])
    person = replace(CAR, name="pedestrian")
    sitting = person.moved(image=500, name="PERSON_SITTING")
    found = [replace(person, score=0.5), replace(sitting, name="Pedestrian", score=1)]
    entry = easy([person, sitting], found, name="Pedestrian")
    assert counts(entry) == ([1], [0], [0])


def test_slots_fill_by_position_so_few_objects_never_reach_100():
    labels = [CAR.moved(image=200 * place, ground=10 * place) for place in range(20)]
    found = [replace(line, score=place) for place, line in enumerate(labels)]
    entry = easy(labels, found)
    assert entry.max_recall == 1
    assert entry.precision.tolist() == [1.0] * 20 + [0.0] * 21
    assert entry.ap_r40 == pytest.approx(100 * 19 / 40)
    assert entry.ap_r11 == pytest.approx(100 * 5 / 11)


def test_a_region_of_no_interest_forgives_what_it_covers_by_the_share_of_the_detection():
    region = replace(OTHER, name="dontcare", x2=OTHER.x2 + 5000, score=None)
    inside = [FOUND, OTHER, OTHER.moved(image=200)]
    assert counts(easy([CAR, region], inside)) == ([1], [0], [0])
    beside = OTHER.moved(image=-35)  # covered by 65 %
    assert counts(easy([CAR, region], [FOUND, beside])) == ([1], [1], [0])


def test_detections_without_3d_part_are_forgiven_on_the_ground_where_a_region_lacks_it_too():
    region = replace(OTHER, name="DontCare", score=None, **MISSING)
    found = [FOUND, replace(OTHER, **MISSING)]
    assert counts(easy([CAR, region], found, "bev")) == ([1], [0], [0])
    assert counts(easy([CAR], found, "bev")) == ([1], [1], [0])
    assert counts(easy([CAR, region], found, "3d")) == ([1], [1], [0])


@pytest.mark.parametrize("size", [{"w": 0}, {"l": 0}, {"w": 0, "l": 0}])
def test_a_detection_without_area_overlaps_nothing(size):
    found = [FOUND, replace(FOUND, **size)]
    assert counts(easy([CAR, CAR], found, "bev")) == ([1], [1], [1])
    assert counts(easy([replace(CAR, **size)], found, "bev"))[0] == []


def test_a_class_is_evaluated_only_by_the_metrics_that_some_detection_serves():
    def metrics(*found):
        files = [(CAR.text(), text_of(found)), (CAR.text(), "")]
        return {metric for _, metric, _ in evaluate(files)}

    assert metrics() == set()
    assert metrics(replace(FOUND, name="Van")) == set()
    assert metrics(replace(FOUND, name="cAr")) == {"bbox", "bev", "3d"}
    assert metrics(replace(FOUND, x1=-1)) == {"bev", "3d"}
    assert metrics(replace(FOUND, **MISSING)) == {"bbox"}
    assert metrics(replace(FOUND, y=-1000)) == {"bbox", "bev"}
    assert metrics(replace(FOUND, h=0)) == {"bbox", "bev"}
    assert metrics(replace(FOUND, z=-1000)) == {"bbox"}
    assert metrics(replace(FOUND, l=-1)) == {"bbox"}
    assert metrics(replace(FOUND, x1=-1), replace(FOUND, **MISSING)) == {"bbox", "bev", "3d"}


def test_one_detection_without_heading_of_any_class_leaves_orientation_out():
    assert easy([CAR], [FOUND]).aos_r11 == pytest.approx(100 / 11)
    assert easy([CAR], [FOUND, replace(OTHER, name="Unicycle", alpha=-10)]).aos_r11 is None
    assert easy([CAR], [FOUND], "bev").aos_r11 is None


@pytest.mark.parametrize(("turned", "share"), [(1.5, 0.0), (1.6, 1.0), (-math.pi, 1.0)])
@pytest.mark.parametrize("metric", ["bbox", "bev", "3d"])
def test_a_heading_is_flipped_beyond_90_degrees(turned, share, metric):
    found = replace(FOUND, alpha=CAR.alpha + turned)
    assert easy([CAR], [found], metric).flipped_share == share
    assert easy([CAR], [replace(found, alpha=-10)], metric).flipped_share is None


def test_orientation_counts_half_where_headings_are_square_to_each_other():
    square = replace(FOUND, alpha=math.pi / 2)
    assert easy([CAR], [square]).aos_r11 == pytest.approx(100 / 11 / 2)


def test_nothing_found_and_nothing_false_at_a_threshold_is_a_precision_of_zero():
    van = replace(CAR, name="Van")
    # by score the van takes SURE and leaves NEAR to the car; by overlap it takes NEAR
    sure, near = FOUND.moved(image=-12, score=0.9), FOUND.moved(image=3, score=0.5)
    car = CAR.moved(image=9)
    region = replace(CAR, name="DontCare", x1=0, x2=400)
    entry = easy([van, car, region], [sure, near])
    assert counts(entry) == ([0], [0], [1])
    assert entry.precision.tolist() == [0.0] * 41
    assert entry.ap_r11 == 0


def test_thresholds_round_as_the_official_sums_do():
    for n_gt in range(1, 260):
        for num_matches in {1, n_gt // 3 + 1, n_gt // 2 + 1, n_gt}:
            scores = np.arange(num_matches, 0.0, -1)
            expected = reference.thresholds_of(scores.tolist(), n_gt)
            assert find_thresholds(scores[::-1], n_gt).tolist() == expected
            assert len(expected) <= 41


def test_scores_may_be_logits():
    labels = [CAR.moved(image=200 * place) for place in range(3)]
    found = [
        replace(line, score=score) for line, score in zip(labels, (-9.5, 31.0, -0.25), strict=True)
    ]
    assert easy(labels, found).thresholds.tolist() == [31.0, -0.25, -9.5]


def test_labels_with_a_score_serve_as_truth():
    assert easy([replace(CAR, score=0.3)], [FOUND]).tp.tolist() == [1]


@pytest.mark.parametrize("turn", [0, 0.5, math.pi / 2, -2.2])
def test_convention_rotation_y_turns_from_the_right_to_the_camera(turn):
    # 1 m along the heading (cos, -sin) two cars of 4 m share 3 m of 5; across, 1 m of 3
    overlaps = MinimumOverlaps(car=ClassOverlaps(bbox=0.7, bev=0.599, box3d=0.599))
    truth = replace(CAR, ry=turn)
    ahead = replace(truth, x=math.cos(turn), z=CAR.z - math.sin(turn), score=1)
    aside = replace(truth, x=math.sin(turn), z=CAR.z + math.cos(turn), score=1)
    assert easy([truth], [ahead], "bev", overlaps=overlaps).thresholds.size == 1
    assert easy([truth], [aside], "bev", overlaps=overlaps).thresholds.size == 0
