"""Scores by distance, against the rules by hand with what is out of a band left out."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import assume, given, settings

from sightline.evaluation.kitti_object import evaluate_objects
from sightline.evaluation.kitti_object_rules import LOOSE
from tests.evaluation.kitti_scenes import Line, random_street, submissions, text_of, write_frames
from tests.evaluation.test_kitti_object import LOOSE_OVERLAPS, assert_equal
from tests.reference import kitti_object as reference

EDGES = (20.001, 20.04)  # the scenes of `submissions` lie about 20 m ahead
CAR = Line(z=15)
FAR = Line(z=45, x1=300, x2=340)


def bands_of(folder, files, edges, **options):
    results, labels = write_frames(folder, files)
    bands = evaluate_objects(results, labels, by_distance=edges, **options).bands
    return {
        (band.from_m, band.to_m): {
            (each.class_name, each.metric, each.difficulty): each for each in band.entries
        }
        for band in bands
    }


def located(files):
    """Without the detections that have no place."""
    return [
        (labels, "".join(line for line in found.splitlines(True) if " -1000.0 " not in line))
        for labels, found in files
    ]


def check(folder, files, edges):
    found = bands_of(folder, files, edges, overlaps=LOOSE)
    assert list(found) == list(pairwise((0, *edges, math.inf)))
    for band, entries in found.items():
        assert_equal(entries, reference.Evaluation(files, LOOSE_OVERLAPS, band).run())
    return found


@settings(max_examples=60)
@given(files=submissions())
def test_any_scene_gives_the_counts_that_the_rules_give_by_hand(files, tmp_path_factory):
    with_place = located(files)
    assume(not reference.Evaluation(with_place, LOOSE_OVERLAPS).is_ambiguous())
    check(tmp_path_factory.mktemp("scene"), with_place, EDGES)


def test_the_bands_of_a_street_hold_all_its_objects_once(tmp_path):
    files = located(random_street(5, num_frames=40))
    found = check(tmp_path, files, (15.0, 30.0, 50.0))
    whole = evaluate_objects(tmp_path / "results", tmp_path / "labels", overlaps=LOOSE)
    for entry in whole.entries:
        key = (entry.class_name, entry.metric, entry.difficulty)
        assert sum(entries[key].n_gt for entries in found.values()) == entry.n_gt


def test_what_is_found_beyond_a_band_is_not_false_in_it_and_what_is_false_counts_where_it_is(
    tmp_path,
):
    found = [
        replace(CAR, score=0.9),
        replace(FAR, score=0.8),
        replace(FAR, score=0.95, x=20, x1=600, x2=640),
    ]
    bands = bands_of(tmp_path, [(text_of([CAR, FAR]), text_of(found))], (30.0,))
    near, far = (entries["Car", "3d", "moderate"] for entries in bands.values())
    assert (near.n_gt, near.tp[-1], near.fp[-1]) == (1, 1, 0)
    assert (far.n_gt, far.tp[-1], far.fp[-1]) == (1, 1, 1)


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        ((40.0, 20.0), "must rise from above 0 and be finite, got 40, 20"),
        ((0.0,), "must rise"),
        ((20.0, math.inf), "be finite"),
    ],
)
def test_edges_that_do_not_rise_are_refused_before_anything_is_read(tmp_path, edges, message):
    with pytest.raises(ValueError, match=message):
        evaluate_objects(tmp_path / "no", tmp_path / "folder", by_distance=edges)


def test_detections_without_a_place_have_no_distance(tmp_path):
    flat = Line(score=0.5, x=-1000, y=-1000, z=-1000)
    results, labels = write_frames(tmp_path, [(text_of([CAR]), text_of([flat]))])
    with pytest.raises(ValueError, match="need detections with 3D locations"):
        evaluate_objects(results, labels, by_distance=(20.0,))
