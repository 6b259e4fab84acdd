"""Results of another convention than KITTI's are recognised without labels."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from sightline.data.checks.result_checks import doubts_about_results
from sightline.data.formats.kitti_boxes import box_corners, project_box
from sightline.data.formats.kitti_labels import KittiObjects, read_labels, write_objects
from sightline.data.submission import write_submission
from sightline.simulation.packaged import PACKAGED_FRAMES

RNG = np.random.default_rng(7)
FOCAL_PX, ROW_PX = 707.0, 180.0  # of another drive than the one whose camera is taken


def frame(num=6):
    """Cars and pedestrians on the road, in the conventions of KITTI's files."""
    names = tuple(RNG.choice(("Car", "Pedestrian"), size=num).tolist())
    sizes = np.where(
        np.array(names)[:, None] == "Car", (1.52, 1.63, 3.88), (1.76, 0.66, 0.84)
    ) * RNG.uniform(0.9, 1.1, size=(num, 3))
    z = RNG.uniform(9, 45, size=num)
    locations = np.stack((RNG.uniform(-8, 8, num), RNG.normal(1.65, 0.1, num), z), axis=1)
    rotations_y = RNG.uniform(-1.5, 1.5, num)
    camera = np.array([[FOCAL_PX, 0, 604, 0], [0, FOCAL_PX, ROW_PX, 0], [0, 0, 1, 0]])
    boxes2d = [
        project_box(box_corners(*each), camera, (375, 1242)).box
        for each in zip(locations, sizes, rotations_y.tolist(), strict=True)
    ]
    return KittiObjects(
        class_names=names,
        truncation=np.full(num, -1.0),
        occlusion=np.full(num, -1.0),
        alpha=rotations_y - np.arctan2(locations[:, 0], z),
        boxes2d=np.array(boxes2d),
        dimensions_hwl=sizes,
        locations=locations,
        rotation_y=rotations_y,
        scores=RNG.uniform(0.01, 1, num),
    )


FRAMES = [frame() for _ in range(30)]


def exact(objects):
    """2D boxes that bound the 3D boxes."""
    camera = np.array([[721.5, 0, 609.6, 0], [0, 721.5, 172.9, 0], [0, 0, 1, 0]])
    boxes = [
        project_box(box_corners(*each), camera, (375, 1242)).box
        for each in zip(
            objects.locations, objects.dimensions_hwl, objects.rotation_y.tolist(), strict=True
        )
    ]
    seen = ~np.isnan(boxes).any(axis=1)
    assert seen.all()
    return replace(objects, boxes2d=np.array(boxes))


def bearings(objects):
    return np.arctan2(objects.locations[:, 0], objects.locations[:, 2])


def without_3d(objects):
    count = len(objects)
    return replace(
        objects,
        dimensions_hwl=np.full((count, 3), -1.0),
        locations=np.full((count, 3), -1000.0),
        rotation_y=np.full(count, -10.0),
        alpha=np.full(count, -10.0),
    )


def half(boxes):
    return boxes / 2


def centred(objects):
    up = objects.dimensions_hwl[:, 0] / 2
    return replace(objects, locations=objects.locations - np.outer(up, (0, 1, 0)))


def projected_wrongly(objects):
    """Centres for bottoms, and 2D boxes computed from them."""
    made = centred(objects)
    bottom = ROW_PX + FOCAL_PX * made.locations[:, 1] / (made.locations[:, 2] - 1)
    boxes = made.boxes2d.copy()
    boxes[:, 3], boxes[:, 1] = bottom, bottom - np.ptp(boxes[:, 1::2], axis=1)
    return replace(made, boxes2d=boxes)


CHANGES = {
    "centres": (centred, "their y is probably that of the centre"),
    "centres in both": (projected_wrongly, "their y is probably that of the centre"),
    "l w h": (
        lambda each: replace(each, dimensions_hwl=each.dimensions_hwl[:, ::-1]),
        "in the order length, width, height: KITTI's files have height, width, length",
    ),
    "w l h": (
        lambda each: replace(each, dimensions_hwl=each.dimensions_hwl[:, [1, 2, 0]]),
        "in the order width, length, height",
    ),
    "halves": (
        lambda each: replace(each, dimensions_hwl=each.dimensions_hwl / 2),
        "sizes of Car, Pedestrian in the results are probably halves: KITTI's are whole",
    ),
    "kilometres": (
        lambda each: replace(
            each, dimensions_hwl=each.dimensions_hwl / 1000, locations=each.locations / 1000
        ),
        "results of scored classes have a 3D box with no size above 0.3 m",
    ),
    "LiDAR's frame": (
        lambda each: replace(each, locations=each.locations[:, [2, 0, 1]] * (1, -1, -1)),
        "3D boxes of results lie behind the camera",
    ),
    "shares": (
        lambda each: replace(each, boxes2d=each.boxes2d / 1e4),
        "2D boxes of results lie within the first pixel",
    ),
    "no 2D boxes": (
        lambda each: replace(each, boxes2d=np.full_like(each.boxes2d, -1.0)),
        "2D boxes of results are placeholders such as 0 0 0 0",
    ),
    "degrees": (
        lambda each: replace(each, rotation_y=np.degrees(each.rotation_y)),
        "angles beyond two pi, probably degrees",
    ),
    "percent": (
        lambda each: replace(each, scores=100 * each.scores),
        "are probably percent",
    ),
    "equal scores": (
        lambda each: replace(each, scores=np.ones(len(each))),
        "all 180 scores of results are 1: nothing ranks them",
    ),
}


def test_sound_results_raise_no_doubt():
    assert list(doubts_about_results(FRAMES)) == []


@pytest.mark.parametrize("scores", [np.linspace(-4, 9, 6), np.linspace(0, 300, 6)])
def test_scores_on_other_scales_than_shares_and_percent_raise_no_doubt(scores):
    assert list(doubts_about_results([replace(each, scores=scores) for each in FRAMES])) == []


def all_around(objects):
    """The objects, and eight times as many beside and behind the camera, without 2D boxes."""
    x, y, z = objects.locations.T
    places = [(z, y, -x), (-z, y, x), (x, y, -z), (-x, y, -z)] * 2
    count = 1 + len(places)
    locations = np.concatenate([objects.locations, *(np.stack(each, 1) for each in places)])
    rotations_y = np.tile(objects.rotation_y, count)
    alphas = rotations_y - np.arctan2(locations[:, 0], locations[:, 2])
    none = np.full((len(locations) - len(objects), 4), -1.0)
    return replace(
        objects,
        class_names=objects.class_names * count,
        truncation=np.full(len(locations), -1.0),
        occlusion=np.full(len(locations), -1.0),
        alpha=(alphas + np.pi) % (2 * np.pi) - np.pi,
        boxes2d=np.concatenate((objects.boxes2d, none)),
        dimensions_hwl=np.tile(objects.dimensions_hwl, (count, 1)),
        locations=locations,
        rotation_y=rotations_y,
        scores=RNG.uniform(0.01, 1, len(locations)),
    )


def test_results_all_around_raise_no_doubt():
    found = [all_around(each) for each in FRAMES]
    assert list(doubts_about_results(found)) == []
    none = [replace(each, boxes2d=np.full_like(each.boxes2d, -1.0)) for each in found]
    doubts = list(doubts_about_results(none))
    assert "are placeholders such as 0 0 0 0" in doubts[0]


@pytest.mark.parametrize("change", CHANGES)
def test_one_doubt_names_the_other_convention(change):
    changed, expected = CHANGES[change]
    doubts = list(doubts_about_results([changed(each) for each in FRAMES]))
    assert len(doubts) == 1
    assert expected in doubts[0]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda each: replace(each, boxes2d=each.boxes2d[:, [1, 0, 3, 2]]),
         "probably y_min, x_min, y_max, x_max: read so "),
        (lambda each: replace(each, boxes2d=half(each.boxes2d)), "an image of half the size"),
        (lambda each: replace(each, boxes2d=2 * each.boxes2d), "an image of twice the size"),
        (lambda each: replace(each, boxes2d=np.concatenate(
            (half(each.boxes2d[:, :2] + each.boxes2d[:, 2:]), np.diff(
                each.boxes2d.reshape(-1, 2, 2), axis=1)[:, 0]), axis=1)),
         "probably centre x, centre y, width, height"),
        (lambda each: replace(each, rotation_y=-each.rotation_y),
         "rotation_y of results is probably negated"),
        (lambda each: replace(
            each, rotation_y=-each.rotation_y, alpha=-each.rotation_y - bearings(each)),
         "rotation_y of results is probably negated"),
        (lambda each: replace(each, rotation_y=-each.rotation_y - np.pi / 2),
         "rotation_y of results is probably the LiDAR frame's yaw"),
        (lambda each: replace(each, rotation_y=each.rotation_y + np.pi / 2),
         "rotation_y of results is probably a quarter turn off"),
        (lambda each: replace(each, boxes2d=0.515 * each.boxes2d + (0, 223, 0, 223)),
         "of another image, resized or cut (x times 0.515, y times 0.515 plus 223 px), or x, y"),
        (lambda each: replace(each, boxes2d=each.boxes2d - (0, 23, 0, 23)), "(y minus 23 px)"),
        (lambda each: replace(each, boxes2d=each.boxes2d[RNG.permutation(len(each))]),
         "2D boxes of results do not fit their projected 3D boxes: the median IoU of 180 is 0 %"),
        (lambda each: replace(each, alpha=np.zeros(len(each))), "alpha of all 180 results is 0"),
        (lambda each: replace(each, alpha=np.full(len(each), -1.0)), "of all 180 results is -1"),
        (lambda each: replace(each, alpha=each.rotation_y), "results is probably rotation_y its"),
        (lambda each: replace(each, alpha=-each.alpha), "results is probably negated"),
        (lambda each: replace(each, alpha=each.alpha + 1), "contradicts rotation_y and the loc"),
        (lambda each: replace(each, scores=-each.scores), "180 scores of results are negative"),
        (lambda each: replace(each, scores=1e-3 * (each.boxes2d[:, 1] - each.boxes2d[:, 3]) + 1),
         "fall with the height of their 2D boxes (rank correlation -1.00)"),
    ],
)  # fmt: skip
def test_boxes_angles_and_scores_that_contradict_each_other_are_told(change, expected):
    sound = [exact(each) for each in FRAMES]
    assert list(doubts_about_results(sound)) == []
    (doubt,) = doubts_about_results([change(each) for each in sound])
    assert expected in doubt


@pytest.mark.parametrize(
    ("convert", "expected"),
    [
        (lambda boxes: boxes[:, [1, 0, 3, 2]], "read as y_min, x_min, y_max, x_max all are inside"),
        (half, "lie in the upper left quarter"),
        (lambda boxes: 2 * boxes, "read as pixels of an image of twice the size all are inside"),
        (lambda boxes: 0.6 * boxes + (0, 90, 0, 90), "are probably pixels of a smaller image"),
        (lambda boxes: boxes[:, [0, 2, 1, 3]], "have 2D boxes that end before they begin"),
    ],
)
def test_2d_boxes_alone_are_judged_by_the_image(convert, expected):
    flat = [without_3d(exact(each)) for each in FRAMES] * 6
    assert list(doubts_about_results(flat)) == []
    (doubt,) = doubts_about_results([replace(e, boxes2d=convert(e.boxes2d)) for e in flat])
    assert expected in doubt


def test_one_box_inside_out_does_not_hide_the_others_in_a_smaller_image():
    first, *others = [replace(e, boxes2d=half(e.boxes2d)) for e in map(without_3d, FRAMES)]
    boxes = first.boxes2d.copy()
    boxes[0] = boxes[0, [2, 3, 0, 1]]
    told = list(doubts_about_results([replace(first, boxes2d=boxes), *others]))
    assert told[0].startswith("1 of 180 results of scored classes have 2D boxes that end before")
    assert "lie in the upper left quarter" in told[1]


@pytest.mark.parametrize(
    ("attribute", "value", "said"),
    [
        ("dimensions_hwl", 0.0, "a 3D box with a size of 0 or less: write the sizes, or -1000"),
        ("dimensions_hwl", -1.0, "a 3D box with a size of 0 or less"),
        ("dimensions_hwl", 3880.0, "a 3D box with a size above 60 m"),
        ("locations", 1e39, "a 3D box more than 600 m away"),
    ],
)
def test_a_single_impossible_value_is_told(attribute, value, said):
    first, *others = FRAMES
    values = getattr(first, attribute).copy()
    values[0, -1] = value
    (doubt,) = doubts_about_results([replace(first, **{attribute: values}), *others])
    assert doubt.startswith(f"1 of {6 * len(FRAMES)} results of scored classes has {said}")


def test_a_single_2d_box_far_beyond_the_image_is_told():
    first, *others = FRAMES
    boxes2d = first.boxes2d.copy()
    boxes2d[0, 2] = 99999
    (doubt,) = doubts_about_results([replace(first, boxes2d=boxes2d), *others])
    assert doubt.startswith("1 of 180 2D boxes of results ends far beyond KITTI's images")
    assert doubt.endswith("at up to 99999 px.")


def test_negative_scores_that_rise_with_the_height_raise_no_doubt():
    frames = [exact(each) for each in FRAMES]
    logarithms = [
        replace(each, scores=np.ptp(each.boxes2d[:, 1::2], axis=1) / 500 - 1) for each in frames
    ]
    assert list(doubts_about_results(logarithms)) == []


def test_a_few_frames_on_a_rising_road_raise_no_doubt():
    rise = np.array((0, 0.6, 0))
    rising = [replace(each, locations=each.locations - rise) for each in FRAMES]
    rising = [replace(each, boxes2d=exact(each).boxes2d) for each in rising]
    assert list(doubts_about_results(rising[:12])) == []
    (doubt,) = doubts_about_results(rising)
    assert "1.65 m below it" in doubt


def test_centres_are_found_in_few_frames_by_their_2d_boxes():
    (doubt,) = doubts_about_results([centred(each) for each in FRAMES[:2]])
    assert "end half an object above their 2D boxes" in doubt


def test_frames_of_a_percent_detector_that_are_shares_are_counted():
    frames = [replace(each, scores=100 * each.scores) for each in FRAMES[:-2]] + FRAMES[-2:]
    (doubt,) = doubts_about_results(frames)
    assert "in 2 of 30 frames none is above 1" in doubt


def test_results_that_are_twice_in_a_frame_are_counted():
    one = FRAMES[0]
    twice = {
        name: np.concatenate([getattr(one, name)] * 2)
        for name in ("truncation", "occlusion", "alpha", "boxes2d", "dimensions_hwl", "locations")
    } | {name: np.concatenate([getattr(one, name)] * 2) for name in ("rotation_y", "scores")}
    doubled = replace(one, class_names=2 * one.class_names, **twice)
    (doubt,) = doubts_about_results([*FRAMES[1:], doubled])
    assert "6 of 186 results of scored classes are there twice in their frame" in doubt


def test_packaged_labels_as_results_raise_no_doubt():
    frames = [
        read_labels(path) for path in sorted((PACKAGED_FRAMES / "training/label_2").glob("*.txt"))
    ]
    scored = [replace(each, scores=np.linspace(0.1, 0.9, len(each))) for each in frames]
    assert list(doubts_about_results(scored)) == []


def test_a_submission_is_packed_with_a_warning_for_each_doubt(tmp_path):
    results = tmp_path / "results"
    results.mkdir()
    for number, each in enumerate(FRAMES):
        write_objects(results / f"{number:06}.txt", centred(each))
    with pytest.warns(UserWarning, match="results: 3D boxes of results .* that of the centre"):
        assert write_submission(results, tmp_path / "a.zip") == len(FRAMES)
    for number, each in enumerate(FRAMES):
        write_objects(results / f"{number:06}.txt", each)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert write_submission(results, tmp_path / "a.zip") == len(FRAMES)
