import math
from dataclasses import replace

import pytest

from sightline.evaluation.kitti_object import evaluate_objects
from tests.evaluation.kitti_scenes import MISSING, Line, text_of, write_frames

CAR = Line()
FOUND = replace(CAR, score=0.5)


def notes_of(tmp_path, labels, results):
    folders = write_frames(tmp_path, [(text_of(labels), text_of(results))])
    return " ".join(evaluate_objects(*folders).notes())


@pytest.mark.parametrize(
    ("labels", "results", "expected"),
    [
        ([CAR], [FOUND, replace(FOUND, name="vehicle"), replace(FOUND, name="bus")],
         "2 of 3 results were left out: their classes are not scored (bus 1, vehicle 1;"),
        ([CAR, replace(CAR, name="automobile"), replace(CAR, name="Van")], [FOUND],
         "1 of 3 labels were left out: their classes are none of KITTI's (automobile 1)"),
        ([CAR, replace(CAR, name="Cyclist")], [FOUND],
         "No result is of Cyclist: its one labelled object is missed"),
        ([CAR], [FOUND, replace(FOUND, name="Pedestrian")],
         "No label is of Pedestrian: its 1 results cannot match"),
        ([CAR], [FOUND, replace(FOUND, **MISSING)],
         "1 of 2 results of scored classes have no 3D part"),
        ([CAR], [], "WARNING: the result files hold no object at all"),
        ([replace(CAR, name="DontCare")], [FOUND], "WARNING: no label is of a scored class"),
    ],
)  # fmt: skip
def test_what_cannot_be_scored_is_said_with_counts(tmp_path, labels, results, expected):
    assert expected in notes_of(tmp_path, labels, results)


@pytest.mark.parametrize(
    ("labels", "expected"),
    [
        ([replace(CAR, occlusion=3), replace(CAR, truncation=2.0)],
         "WARNING: none of the 2 labels of scored classes counts at any difficulty: 2 have an "
         "occlusion above 2 (3 is unknown) or a truncation above 0.5, the others are at most 25"),
        ([replace(CAR, y2=CAR.y1 + 9)],
         "WARNING: none of the 1 labels of scored classes counts at any difficulty: 0 have"),
        ([CAR, replace(CAR, name="Cyclist", truncation=0.6)],
         "No label of Cyclist (1) counts at any difficulty, by occlusion, truncation or height"),
        ([replace(CAR, **MISSING), CAR],
         "1 of 2 labels of scored classes have no 3D part: nothing matches them in bird's eye"),
    ],
)  # fmt: skip
def test_labels_that_count_nowhere_are_told(tmp_path, labels, expected):
    assert expected in notes_of(tmp_path, labels, [FOUND])
    (tmp_path / "sound").mkdir()
    counted = notes_of(tmp_path / "sound", [CAR, *labels[:1]], [FOUND])
    assert "counts at any difficulty" not in counted


def test_labels_that_are_ignored_by_a_flag_for_the_truncation_are_told(tmp_path):
    flagged = [replace(CAR, truncation=1.0)] * 5
    at_the_border = replace(CAR, x1=0.0, y1=0.0, x2=1241.0, y2=374.0)
    told = notes_of(tmp_path, [CAR, at_the_border, *flagged], [FOUND])
    assert "WARNING: the labels give 5 of 7 objects a truncation of 1 or more and none" in told
    (tmp_path / "sound").mkdir()
    share = replace(CAR, truncation=0.3)
    sound = notes_of(tmp_path / "sound", [CAR, at_the_border, share, *flagged], [FOUND])
    assert "probably flags" not in sound


def test_labels_without_truncation_and_occlusion_are_told_but_not_such_results(tmp_path):
    unknown = {"truncation": -1.0, "occlusion": -1}
    labels = [
        CAR,
        replace(CAR, **unknown),
        replace(CAR, occlusion=-1),
        replace(CAR, name="Van", **unknown),
    ]
    text = "1 of 3 labels of scored classes have no truncation and no occlusion (-1 -1): they"
    assert text in notes_of(tmp_path, labels, [FOUND])
    (tmp_path / "sound").mkdir()
    sound = notes_of(tmp_path / "sound", [CAR], [replace(FOUND, **unknown)])
    assert "-1" not in sound


@pytest.mark.parametrize("angle", ["alpha", "ry"])
def test_angles_in_degrees_are_told_of_results_and_of_labels(tmp_path, angle):
    turned = replace(CAR, **{angle: -88.0})
    notes = notes_of(tmp_path, [CAR, turned], [replace(turned, score=0.5)])
    assert "1 of 2 labels and 1 of 1 results have angles beyond two pi, probably degrees" in notes


def spaced(number, **changes):
    """A car of a row, with the alpha of its place."""
    car = replace(CAR, **changes).moved(image=110 * number, ground=5 * number)
    return replace(car, alpha=car.ry - math.atan2(car.x, car.z))


SPACED = [spaced(n, y=1.7, z=20.0) for n in range(50)]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda line: replace(line, h=line.l, l=line.h),
         "sizes of Car in the results are probably in the order length, width, height"),
        (lambda line: replace(line, h=line.h / 2, w=line.w / 2, l=line.l / 2),
         "sizes of Car in the results are probably halves: KITTI's are whole height"),
        (lambda line: replace(line, y=line.y - line.h / 2),
         "their y is probably that of the centre"),
        (lambda line: replace(line, x=line.z, y=-line.x, z=-1.0),
         "50 of 50 3D boxes of results lie behind the camera"),
        (lambda line: replace(line, x2=line.x2 - line.x1, y2=line.y2 - line.y1),
         "2D boxes of results are probably x_min, y_min, width, height: read so they match 50 of"),
        (lambda line: replace(line, x1=(line.x1 + line.x2) / 2, y1=(line.y1 + line.y2) / 2,
                              x2=line.x2 - line.x1, y2=line.y2 - line.y1),
         "2D boxes of results are probably centre x, centre y, width, height"),
        (lambda line: replace(line, x1=line.y1, y1=line.x1, x2=line.y2, y2=line.x2),
         "2D boxes of results are probably y_min, x_min, y_max, x_max: read so they match 50 of 50 "
         "labelled objects clearly better in the image, and 0 worse"),
        (lambda line: replace(line, x1=line.x1 / 2, y1=line.y1 / 2, x2=line.x2 / 2, y2=line.y2 / 2),
         "2D boxes of results are probably pixels of an image of half the size"),
        (lambda line: replace(line, y1=line.y1 / 3 + 90, y2=line.y2 / 3 + 90,
                              x1=line.x1 / 3, x2=line.x2 / 3),
         "probably pixels of another image, resized or cut (x times 0.333, y times 0.333 plus 90 px"
         "): read so they match 50 of 50"),
        (lambda line: replace(line, y1=line.y1 - 23, y2=line.y2 - 23),
         "pixels of another image, resized or cut (y minus 23 px): read so they match 50 of 50"),
        (lambda line: replace(line, y1=line.y1 + line.x1**2 % 997 + 200,
                              y2=line.y2 + line.x1**2 % 997 + 200),
         "3D boxes of results match labels and 2D boxes do not: of 50 labelled objects 0 are"
         " matched"),
        (lambda line: spaced((line.x - CAR.x) / 5, y=1.7, z=60.0),
         "2D boxes of results match labels and 3D boxes do not: of 50 labelled objects 50 are"
         " matched"),
        (lambda line: replace(line, alpha=0.0), "alpha of all 50 results is 0"),
        (lambda line: replace(line, alpha=-1.0), "alpha of all 50 results is -1"),
        (lambda line: replace(line, z=line.z + 1.0),
         "3D boxes of results lie 1.00 m further than those of labels (median of 50): moved back"),
        (lambda line: replace(line, x=line.x - 0.3, y=line.y + 0.4),
         "3D boxes of results lie 0.30 m left and 0.40 m lower than those of labels"),
        (lambda line: replace(line, x1=0.1, y1=0.2, x2=0.2, y2=0.4),
         "all 2D boxes of results lie within the first pixel"),
        (lambda line: replace(line, x1=0.0, y1=0.0, x2=0.0, y2=0.0),
         "50 of 50 2D boxes of results are placeholders such as 0 0 0 0"),
    ],
)  # fmt: skip
def test_boxes_of_another_convention_are_told(tmp_path, change, expected):
    notes = notes_of(tmp_path, SPACED, [replace(change(line), score=line.x1) for line in SPACED])
    assert expected in notes
    assert notes.count("WARNING") == 1


def test_a_result_without_an_alpha_that_costs_all_orientations_is_told(tmp_path):
    found = [replace(line, score=line.x1) for line in SPACED]
    notes = notes_of(tmp_path, SPACED, [*found[:-1], replace(found[-1], alpha=-10.0)])
    assert "WARNING: alpha of 1 of 50 results is -10, KITTI's number for none: orient" in notes
    in_image = replace(found[-1], alpha=-10.0, **MISSING)  # as of joined objects without a 3D box
    notes = notes_of(tmp_path, SPACED, [*found[:-1], in_image])
    assert "WARNING" not in notes
    assert "Orientation is not scored: 1 of 50 results have no 3D part and so no alpha" in notes
    without = notes_of(tmp_path, SPACED, [replace(line, alpha=-10.0) for line in found])
    assert "WARNING" not in without


TURNED = [spaced(n, y=1.7, z=20.0, ry=0.4) for n in range(50)]


@pytest.mark.parametrize(
    ("ry", "expected"),
    [
        (-0.4, "rotation_y of results is probably negated: of 50 results at a labelled object 50"),
        (-0.4 - math.pi / 2, "rotation_y of results is probably the LiDAR frame's yaw"),
        (0.4 + math.pi / 2, "rotation_y of results is probably a quarter turn too large: of 50 re"),
        (0.4 - math.pi / 2, "rotation_y of results is probably a quarter turn too small"),
        (0.4 - math.pi, "50 of 50 results at a labelled object face the opposite way"),
    ],
)
def test_boxes_that_face_another_way_than_labels_are_told(tmp_path, ry, expected):
    found = [spaced(n, y=1.7, z=20.0, ry=ry) for n in range(50)]
    notes = notes_of(tmp_path, TURNED, [replace(line, score=line.x1) for line in found])
    assert expected in notes
    assert notes.count("WARNING") == 1
    sound = notes_of(tmp_path, TURNED, [replace(line, score=line.x1) for line in TURNED])
    assert "WARNING" not in sound


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (
            lambda line: replace(line, y=line.y - line.h / 2),
            "3D boxes of labels lie 0.50 of their height above those of results: their y is",
        ),
        (
            lambda line: replace(line, h=line.l, l=line.h),
            "sizes of Car in the labels are probably in the order length, width, height",
        ),
        (
            lambda line: replace(line, h=line.h / 2, w=line.w / 2, l=line.l / 2),
            "sizes of Car in the labels are probably halves",
        ),
        (lambda line: replace(line, alpha=0.0), "alpha of all 50 labels is 0: scores of orien"),
        (lambda line: replace(line, alpha=-1.0), "alpha of all 50 labels is -1: scores of orien"),
        (lambda line: replace(line, alpha=-10.0), "alpha of all 50 labels is -10, KITTI's number"),
        (lambda line: replace(line, alpha=-line.alpha), "50 labels is probably negated: scores"),
        (lambda line: replace(line, ry=line.ry - math.pi), "of 50 labels is probably half a turn"),
        (lambda line: replace(line, ry=-line.ry), "50 labels is probably that of a negated rot"),
    ],
)
def test_labels_of_another_convention_are_told_of_labels(tmp_path, change, expected):
    labels = [change(line) for line in TURNED]
    notes = notes_of(tmp_path, labels, [replace(line, score=line.x1) for line in TURNED])
    assert expected in notes
    assert notes.count("WARNING") == 1


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"x2": CAR.x1 - 1}, "50 have a 2D box with its maximum below its minimum"),
        ({"truncation": 2.0}, "50 have a truncation other than -1 or 0 to 1"),
        ({"occlusion": 4}, "50 have an occlusion other than -1 to 3"),
        ({}, "49 repeat an earlier one of their frame"),
    ],
)
def test_labels_that_check_finds_are_counted(tmp_path, changes, expected):
    labels = [replace(CAR, **changes)] * 50
    labels = (
        [replace(each, y=1.0 + 0.01 * n) for n, each in enumerate(labels)] if changes else labels
    )
    notes = notes_of(tmp_path, labels, [replace(CAR, score=0.5)])
    assert f"WARNING: of 50 labels {expected}: they count as missed, twice or not at all; " in notes


@pytest.mark.parametrize("fill", [0.0, -1.0])
def test_3d_parts_that_are_filled_with_one_number_are_told_once(tmp_path, fill):
    filled = dict.fromkeys(("h", "w", "l", "x", "y", "z", "ry"), fill)
    found = [replace(line, score=line.x1, **filled) for line in SPACED]
    notes = notes_of(tmp_path, SPACED, found)
    assert "50 of 50 results of scored classes have no 3D part" in notes
    assert "WARNING" not in notes


def test_alphas_of_labels_matter_only_where_orientation_is_scored(tmp_path):
    labels = [replace(line, alpha=0.0) for line in TURNED]
    found = [replace(line, alpha=-10.0, score=line.x1) for line in TURNED]
    assert "WARNING" not in notes_of(tmp_path, labels, found)


@pytest.mark.parametrize(("sign", "is_told"), [(1, False), (-1, True)])
def test_scores_that_rank_false_results_first_are_told(tmp_path, sign, is_told):
    true = [replace(line, score=sign * (1 + 1e-3 * line.x1)) for line in SPACED]
    false = [replace(line.moved(ground=2.5, image=55), score=sign * 0.5 * 1e-4 * line.x1)
             for line in SPACED]  # fmt: skip
    false = [replace(line, y1=line.y1 + 300, y2=line.y2 + 300) for line in false]
    notes = notes_of(tmp_path, SPACED, true + false)
    assert ("scores of results are probably reversed" in notes) == is_told


@pytest.mark.parametrize(("shift", "cause"), [(0, ""), (1, "the next frame"), (-1, "frame before")])
def test_results_of_the_frame_beside_are_told(tmp_path, shift, cause):
    streets = [[line.moved(image=37 * n, ground=2 * n) for line in SPACED[:3]] for n in range(12)]
    found = [[replace(line, score=line.x1) for line in street] for street in streets]
    files = [
        (text_of(street), text_of(found[(place + shift) % 12]))
        for place, street in enumerate(streets)
    ]
    notes = " ".join(evaluate_objects(*write_frames(tmp_path, files)).notes())
    assert ("results are probably those of" in notes) == bool(cause)
    assert cause in notes


def test_equal_scores_are_told(tmp_path):
    notes = notes_of(tmp_path, SPACED, [replace(line, score=0.5) for line in SPACED])
    assert "WARNING: all 50 scores of results are 0.5: nothing ranks them" in notes


def test_results_that_are_there_twice_are_counted(tmp_path):
    notes = notes_of(tmp_path, SPACED, 2 * [replace(line, score=-line.x1) for line in SPACED])
    assert "50 of 100 results of scored classes are there twice" in notes


def test_of_sound_results_nothing_is_said_but_that_objects_are_few(tmp_path):
    labels = [spaced(place) for place in range(50)]
    found = [replace(line, score=1e-4 * line.x1) for line in labels]
    assert notes_of(tmp_path, [*labels, replace(CAR, name="Van")], found) == ""


def test_files_that_no_frame_has_are_counted(tmp_path):
    results, labels = write_frames(tmp_path, [(CAR.text(), FOUND.text())])
    for name in ("000007.txt", "000009.txt", "notes.txt"):
        (results / name).write_text(FOUND.text())
    for name in ("000003.TXT", "README.TXT"):
        (labels / name).write_text(CAR.text())
    notes = " ".join(evaluate_objects(results, labels).notes())
    assert (
        "2 result files were left out: no label file has their name (the first is 000007.txt)"
        in notes
    )
    assert "1 label files were left out: they end in .TXT" in notes
    listed = " ".join(evaluate_objects(results, labels, sample_list=["000000"]).notes())
    assert "left out" not in listed


def test_names_from_files_reach_a_note_as_plain_characters(tmp_path):
    notes = notes_of(tmp_path, [CAR], [FOUND, replace(FOUND, name="\x1b[31mred")])
    assert "\\x1b[31mred 1" in notes


def test_of_angles_in_degrees_the_cause_is_told_once(tmp_path):
    turned = [replace(line, ry=math.degrees(line.ry + 0.5), score=0.5) for line in SPACED]
    notes = notes_of(tmp_path, SPACED, turned)
    assert "50 of 50 results have angles beyond two pi" in notes
    assert "contradicts rotation_y" not in notes


def streets(count):
    """Labels and results of frames with four cars each, sure in a wide range."""
    labels = [SPACED[place : place + 4] for place in range(0, 4 * count, 4)]
    found = [[replace(line, score=1e-4 * line.x1) for line in street] for street in labels]
    return [[text_of(street), text_of(lines)] for street, lines in zip(labels, found, strict=True)]


def test_empty_result_files_of_frames_with_many_objects_are_counted(tmp_path):
    frames = streets(8)
    for place in (2, 4, 6):
        frames[place][1] = ""
    folders = write_frames(tmp_path, frames)
    told = "3 of 8 result files hold no object, though the labels of their frames hold 12 of the 32"
    (note,) = [note for note in evaluate_objects(*folders).notes() if "hold" in note]
    assert note.startswith(told)
    for name in ("000002", "000004", "000006"):
        (folders[0] / f"{name}.txt").unlink()
    notes = evaluate_objects(*folders, missing_as_empty=True).notes()
    assert "3 frames had no result file and counted as empty." in notes
    assert not any("hold" in note for note in notes)


def test_empty_result_files_of_frames_with_few_or_other_objects_are_not_counted(tmp_path):
    frames = streets(8)
    other = text_of([replace(CAR, name="Van"), replace(CAR, name="Cyclist")])  # no result is one
    hidden = text_of([replace(CAR, occlusion=3)])
    frames[1], frames[2], frames[3] = (other, ""), (hidden, ""), ("", "")
    frames[4] = (CAR.text(), "")
    notes = evaluate_objects(*write_frames(tmp_path, frames)).notes()
    assert not any("hold no object" in note for note in notes)


@pytest.mark.parametrize(("factor", "is_told"), [(1.0, True), (0.1, False)])
def test_empty_label_files_are_counted_where_results_are_as_sure_as_elsewhere(
    tmp_path, factor, is_told
):
    frames = streets(8)
    for place in (3, 5):
        street = SPACED[4 * place : 4 * place + 4]
        found = [replace(line, score=factor * 1e-4 * line.x1) for line in street]
        frames[place] = ("", text_of(found))
    notes = " ".join(evaluate_objects(*write_frames(tmp_path, frames)).notes())
    told = "2 of 8 label files hold no object, though in 2 of their frames the best result is as"
    assert (told in notes) == is_told


def test_hidden_files_are_none_that_were_left_out(tmp_path):
    folders = write_frames(tmp_path, [(text_of([CAR]), text_of([FOUND]))])
    for folder in folders:
        (folder / "._000000.txt").write_bytes(b"\0")
        (folder / ".000000.TXT").write_bytes(b"\0")
    assert "left out" not in " ".join(evaluate_objects(*folders).notes())


def test_boxes_of_one_class_by_their_centres_are_told_with_the_class(tmp_path):
    walkers = [replace(line, name="Pedestrian", h=1.7, w=0.6, l=0.8) for line in SPACED[:25]]
    labels = [*walkers, *SPACED[25:]]
    found = [replace(line, score=line.x1) for line in labels]
    raised = [replace(line, y=line.y - line.h / 2) for line in found[:25]]
    notes = notes_of(tmp_path, labels, [*raised, *found[25:]])
    assert "3D boxes of Pedestrian of results lie 0.50 of their height above" in notes


def test_boxes_that_scatter_by_a_metre_are_not_taken_for_boxes_by_their_centres(tmp_path):
    """As of a camera alone: the median of five happens to be half the height."""
    labels = [replace(line, h=1.5) for line in SPACED[:5]]
    rises = (0.75, 1.9, -0.6, 1.3, -0.1)
    found = [
        replace(line, y=line.y - rise, score=line.x1)
        for line, rise in zip(labels, rises, strict=True)
    ]
    assert "of their height" not in notes_of(tmp_path, labels, found)
    raised = [replace(line, y=line.y - 0.75, score=line.x1) for line in labels]
    assert "3D boxes of results lie 0.50 of their height" in notes_of(tmp_path, labels, raised)
