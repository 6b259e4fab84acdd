import re
import warnings
from pathlib import Path

import fsspec
import pytest

from sightline.data.layouts.kitti_trees import find_velodyne
from sightline.data.open import open_dataset
from sightline.data.sharding import write_shards
from sightline.training.data import CameraLidarData
from sightline.training.sources import SourceConfig, data_tree, labelled_classes, open_source
from tests.data import recordings, trees
from tests.training import toy

PARTS = {"image", "points"}
LABEL = "{} 0 0 0 10 10 20 20 1.5 1.6 3.9 0 1.7 20 0\n"


@pytest.fixture
def tree(tmp_path):
    """Data set of twelve frames without lists."""
    return toy.write_frames(tmp_path / "tree", count=12)


def frames(root, name, *, held_out_for=("validation",), path=".", lines=None):
    source = SourceConfig(path=Path(path), sample_list=name)
    notify = [].append if lines is None else lines.append
    opened = open_source(source, root, PARTS, held_out_for=held_out_for, notify=notify)
    return [int(n) for n in opened.sample_ids]


def write_list(root, name, numbers):
    folder = root / "ImageSets"
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.txt").write_text("".join(f"{number:06}\n" for number in numbers))


@pytest.mark.parametrize("path", [".", "training"])
def test_without_lists_the_first_tenth_validates_and_the_others_train(tree, path):
    assert frames(tree, "val", path=path) == [0, 1]
    assert frames(tree, "train", path=path) == list(range(2, 12))


def test_a_list_of_training_frames_alone_is_divided_as_the_simulator_writes_it(tree):
    write_list(tree, "train", range(12))
    assert frames(tree, "val") == [0, 1]
    assert frames(tree, "train") == list(range(2, 12))


def test_files_of_the_current_folder_are_no_lists_of_the_data(tree, monkeypatch):
    monkeypatch.chdir(tree.parent)
    for name in ("train", "val"):
        (tree.parent / name).write_text("000007\n")
    assert frames(tree, "val") == [0, 1]
    assert frames(tree, "train") == list(range(2, 12))
    write_list(tree, "val", (5, 7))
    write_list(tree, "train", (3, 9))
    assert frames(tree, "val") == [5, 7]
    assert frames(tree, "train") == [3, 9]
    assert frames(tree, "./train") == [7]


def test_where_nothing_validates_on_the_folder_all_of_it_trains(tree):
    assert frames(tree, "train", held_out_for=()) == list(range(12))
    write_list(tree, "train", (3, 4))
    assert frames(tree, "train", held_out_for=()) == [3, 4]


def test_what_a_list_of_validation_frames_leaves_trains(tree):
    write_list(tree, "val", (5, 7))
    assert frames(tree, "val") == [5, 7]
    assert frames(tree, "train") == [0, 1, 2, 3, 4, 6, 8, 9, 10, 11]


def test_lists_are_found_in_shards(tree):
    write_list(tree, "val", (5, 7))
    write_list(tree, "train", (3, 5, 9))
    shards = tree.with_name("shards")
    write_shards(tree, shards, frames_per_shard=5)
    for path in (".", "training"):
        assert frames(shards, "val", path=path) == [5, 7]
        assert frames(shards, "train", path=path) == [3, 5, 9]


@pytest.mark.parametrize(
    ("listed", "held_out_for", "expected"),
    [
        ({}, ["validation", "test"], "2 of 12 .* for validation and test: it has no list val"),
        ({"train": range(12)}, ["test"], "2 of 12 .* for test: .* set --data.init_args.test '..'$"),
        ({"val": (5, 7, 99)}, ["validation"], "2 of 12 .* its list val has them"),
        ({"val": (5, 7)}, [], "2 of 12 .* for validation: its list val has them"),
    ],
)
def test_frames_that_are_held_back_are_counted(tree, listed, held_out_for, expected):
    for name, numbers in listed.items():
        write_list(tree, name, numbers)
    lines = []
    frames(tree, "train", held_out_for=held_out_for, lines=lines)
    (line,) = lines
    assert re.search(expected, line)


def test_nothing_is_said_where_every_frame_trains(tree):
    lines = []
    frames(tree, "train", held_out_for=(), lines=lines)
    write_list(tree, "train", (1, 2))
    write_list(tree, "val", (3, 4))
    frames(tree, "train", lines=lines)
    frames(tree, None, lines=lines)
    assert not lines


def test_frames_that_are_both_trained_and_scored_on_are_counted_once(tree, capsys):
    write_list(tree, "train", range(8))
    write_list(tree, "val", (6, 7, 8))
    train, val = (SourceConfig(path=Path(), sample_list=name) for name in ("train", "val"))
    data = toy.data(tree, training=(train,), validation=(val, val))
    data.val_dataloader()
    assert capsys.readouterr().err == ""  # nothing is trained yet
    data.train_dataloader()
    data.val_dataloader()
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("2 of 3 validation frames of")
    assert "are also training frames (000006 first)" in line


def test_overlap_of_a_folder_of_shards_and_one_of_its_tars_is_told(tree, capsys):
    shards = tree.parent / "shards"
    write_shards(tree, shards, frames_per_shard=4)
    whole, alone = (SourceConfig(path=path) for path in (Path(), Path("000000.tar")))
    for training, validation, number in ((whole, alone, 4), (alone, whole, 4)):
        data = toy.data(shards, training=(training,), validation=(validation,))
        data.train_dataloader()
        data.val_dataloader()
        assert capsys.readouterr().err.startswith(f"{number} of ")


def test_lists_that_are_there_are_taken_as_they_are(tree):
    write_list(tree, "train", (1, 2))
    write_list(tree, "val", (2, 3))
    assert (frames(tree, "train"), frames(tree, "val")) == ([1, 2], [2, 3])


def test_another_list_that_is_missing_is_still_refused(tree):
    with pytest.raises(ValueError, match="there is no list 'trian'"):
        frames(tree, "trian")


def test_one_frame_cannot_be_divided(tmp_path):
    root = toy.write_frames(tmp_path, count=1)
    with pytest.raises(ValueError, match="holds 1 frames, too few for training and validation"):
        frames(root, "train")


def write_label(root, number, *class_names):
    path = root / "training" / "label_2" / f"{number:06}.txt"
    path.write_text("".join(LABEL.format(name) for name in class_names))


def open_with_classes(root, *class_names, parts=frozenset({"points", "objects"}), sample_list=None):
    source = SourceConfig(path=Path(), sample_list=sample_list, with_classes=class_names)
    return open_source(source, root, parts, held_out_for=(), notify=[].append)


@pytest.mark.filterwarnings("ignore:.*probably in the order")  # all labels have a car's size
@pytest.mark.filterwarnings("ignore:.*repeats 1 of 2 objects")
def test_frames_can_be_chosen_by_the_classes_that_they_show(tree):
    for number in range(12):
        write_label(tree, number, "Car")
    write_label(tree, 3, "Car", "Cyclist")
    write_label(tree, 5)
    write_label(tree, 7, "Pedestrian", "Pedestrian")
    chosen = open_with_classes(tree, "Cyclist", "Pedestrian")
    assert chosen.sample_ids == ("000003", "000007")
    assert chosen[0].objects.class_names == ("Car", "Cyclist")
    write_list(tree, "few", (5, 7, 11))
    assert open_with_classes(tree, "Pedestrian", sample_list="few").sample_ids == ("000007",)
    assert open_with_classes(tree, "Car", sample_list="few").sample_ids == ("000011",)


def test_classes_that_no_frame_shows_are_refused(tree):
    write_label(tree, 2, "Car", "Van")
    with pytest.raises(ValueError, match=r"tree has an object of .* Bike; its labels have Car"):
        open_with_classes(tree, "Bike")
    with pytest.raises(
        ValueError, match=r"with_classes Bike; its labels have Car.* leave this entry out"
    ):
        open_with_classes(tree, "Car", "Bike")
    for number in range(12):
        write_label(tree, number)
    with pytest.raises(ValueError, match="its labels have none"):
        open_with_classes(tree, "Car")


def test_classes_are_refused_where_the_task_reads_no_labels(tree):
    write_label(tree, 2, "Car")
    with pytest.raises(ValueError, match="Car needs labels, which this task does not read; leave"):
        open_with_classes(tree, "Car", parts=PARTS)


def test_a_recordings_labels_choose_as_well(tmp_path):
    root = recordings.write_recording(tmp_path / "own")
    (root / "labels").mkdir()
    (root / "labels" / "a.txt").write_text("")
    (root / "labels" / "b.txt").write_text(LABEL.format("Cyclist"))
    assert open_with_classes(root, "Cyclist").sample_ids == ("b",)


@pytest.mark.parametrize("name", ["training", "testing", "drive"])
def test_a_recordings_lists_are_found_under_any_name_of_its_folder(tmp_path, name):
    root = recordings.write_recording(tmp_path / name, ("000000", "000001", "000002"))
    write_list(root, "train", (0, 1))
    write_list(root, "val", (2,))
    lines = []
    assert frames(root, "train", lines=lines) == [0, 1]
    assert frames(root, "val", lines=lines) == [2]
    assert lines == []


def test_lists_are_found_for_the_current_folder_and_links(tree, monkeypatch):
    write_list(tree, "train", range(2, 12))
    write_list(tree, "val", (1,))
    (tree / "link").symlink_to(tree / "training")
    assert frames(tree, "val", path="link") == [1]
    monkeypatch.chdir(tree / "training")
    assert frames(Path(), "val") == [1]


@pytest.mark.parametrize("at", ["whole", "split"])
def test_one_tar_named_whole_and_by_its_split_is_one_folder(tree, at):
    write_shards(tree, tree.parent / "shards", frames_per_shard=12)
    tar = tree.parent / "shards" / "000000.tar"
    path = tar if at == "whole" else tar / "training"
    assert data_tree(SourceConfig(path=path), tree) == tar


def test_a_whole_tree_in_a_folder_named_training_has_its_own_lists(tree):
    moved = tree.parent / "x" / "training"
    moved.parent.mkdir()
    tree.rename(moved)
    write_list(moved, "val", (5,))
    assert frames(moved, "val") == [5]
    assert data_tree(SourceConfig(path=Path()), moved) == moved


def test_data_without_labels_cannot_be_chosen_by_class(tmp_path):
    drive = trees.write_drive(tmp_path / "drive")
    with pytest.raises(ValueError, match="no labels, needed for with_classes Car; leave it out"):
        open_with_classes(drive, "Car")


def test_sweeps_are_found_whole_or_cut_to_the_image(tree):
    split = tree / "training"
    assert find_velodyne(split) == "velodyne"
    (split / "velodyne").rename(split / "velodyne_reduced")
    assert find_velodyne(split) == "velodyne_reduced"
    assert len(frames(tree, None)) == 12


def test_what_is_wrong_with_the_data_names_the_flags(tree):
    data = toy.data(tree / "gone", validation=(SourceConfig(path=Path("x")),))
    with pytest.raises(
        ValueError, match=r"gone/x: does .* --data\.init_args\.root and .*validation"
    ):
        data.val_dataloader()


@pytest.mark.filterwarnings("ignore:.*(no class of KITTI|do not fit its 2D boxes)")
def test_classes_that_no_training_frame_shows_are_listed(tree):
    for number, names in enumerate((["Car"], ["car", "Van"], [], ["Cyclist"])):
        write_label(tree, number, *names)

    def absent(*numbers: int) -> tuple[str, ...]:
        write_list(tree, "some", numbers)
        dataset = open_with_classes(tree, sample_list="some")
        return labelled_classes([dataset], ("Car", "Pedestrian", "Cyclist")).absent

    assert absent(0, 1, 2, 3) == ("Pedestrian",)
    assert absent(0) == ("Pedestrian", "Cyclist")
    assert absent(1, 2) == ("Car", "Pedestrian", "Cyclist")
    assert labelled_classes([], ()).absent == ()


def test_objects_without_the_box_that_a_network_learns_do_not_count_for_their_class(tree):
    car = LABEL.format("Car").split()
    flat = f"{' '.join(car[:8])} -1 -1 -1 -1000 -1000 -1000 -10"
    unseen = f"{' '.join(car[:4])} 0 0 0 0 {' '.join(car[8:])}".replace("Car", "Cyclist")
    write_list(tree, "two", (0, 1))
    for number, line in enumerate((flat, unseen)):
        (tree / "training" / "label_2" / f"{number:06}.txt").write_text(f"{line}\n")
    with warnings.catch_warnings(action="ignore"):  # placeholders are told, too
        dataset = open_with_classes(tree, sample_list="two")
    names = ("Car", "Cyclist")
    assert labelled_classes([dataset], names).absent == ()
    assert labelled_classes([dataset], names, "2D").absent == ("Cyclist",)
    assert labelled_classes([dataset], names, "2D").without_box == {"Cyclist": 1}
    assert labelled_classes([dataset], names, "3D").absent == ("Car",)


@pytest.mark.filterwarnings("ignore:.*far outside the image")  # the pictures are small
@pytest.mark.parametrize(
    ("listed", "absent", "training_effect", "scoring_effect"),
    [
        ((0, 1), None, None, None),
        ((0, 2), "Cyclist", "these classes are learned as background", "the scores of these cla"),
        ((2,), "Car, Cyclist", "there is nothing to learn", "the scores say nothing"),
    ],
)
def test_classes_without_a_labelled_object_are_told_in_training_and_scoring(
    tree, capsys, listed, absent, training_effect, scoring_effect
):
    class Learning(toy.ToyPreparation):
        learned_box = "2D"
        parts = frozenset({"image", "points", "objects"})

        def learned_classes(self):
            return "Car", "Cyclist"

    for number, names in enumerate((["Car"], ["Cyclist"], [])):
        write_label(tree, number, *names)
    write_list(tree, "some", listed)
    some = (SourceConfig(path=Path(), sample_list="some"),)
    sources = {"training": some, "validation": some, "test": some}
    data = CameraLidarData(Learning(), root=tree, batch_size=1, workers=0, **sources)
    for use, load, effect in (
        ("validation", data.val_dataloader, scoring_effect),
        ("test", data.test_dataloader, scoring_effect),
        ("training", data.train_dataloader, training_effect),
    ):
        load()
        told = capsys.readouterr().err
        if absent is None:
            assert not told
        else:
            start = f"warning: the labels of the {use} frames have no object of {absent} with a 2D"
            assert told.startswith(start)
            assert f" box: {effect}" in told


@pytest.mark.filterwarnings("ignore:.*far outside the image")  # the pictures are small
def test_objects_whose_names_are_no_classes_are_counted_over_all_training_frames(tree, capsys):
    class Learning(toy.ToyPreparation):
        parts = frozenset({"image", "points", "objects"})

        def learned_classes(self):
            return "Car", "scooter"

    for number in range(9):  # those of the first, the middle and the last frame are checked
        write_label(tree, number, "Car", "Tram", "DontCare", "scooter")
    write_list(tree, "some", range(9))
    some = (SourceConfig(path=Path(), sample_list="some"),)

    def told(label_names=()) -> str:
        for number, names in label_names:
            write_label(tree, number, *names)
        sources = {"training": (*some, some[0]), "validation": some, "test": some}
        data = CameraLidarData(Learning(), root=tree, batch_size=1, workers=0, **sources)
        data.val_dataloader()
        assert not capsys.readouterr().err  # scores ignore case
        data.train_dataloader()
        return capsys.readouterr().err

    with warnings.catch_warnings(action="ignore"):  # of a scooter in the checked frames
        assert not told()
        line = told([(5, ["car", "car", "DontCare"]), (6, ["Bus", "Car"])])
    assert line == (
        "warning: in the labels of the training frames 3 of the 33 objects that were read have "
        "names that are no classes of KITTI (car 2, Bus 1; capitals count): they are learned as "
        "background; correct the names (sightline check)\n"
    )


def test_other_capitals_in_validation_are_told_as_such(tree):
    for number in range(9):
        write_label(tree, number, "car", "Van")
    write_list(tree, "some", range(9))
    with warnings.catch_warnings(action="ignore"):  # of the labels themselves
        dataset = open_with_classes(tree, sample_list="some")
    classes = ("Car", "Cyclist")
    first, second = labelled_classes([dataset], classes).scoring_warnings("test", classes, None)
    assert "no object of Cyclist: the scores of these classes say nothing" in first
    assert "other capitals than the learned classes (car 9): scores count these objects" in second


@pytest.mark.filterwarnings("ignore:.*(far outside|do not fit its 2D boxes)")
def test_objects_of_a_learned_class_that_lack_the_learned_box_are_told(tree, capsys):
    """Sources labelled in space and in images alone: those of the latter become background."""
    flat = f"{' '.join(LABEL.format('Car').split()[:8])} -1 -1 -1 -1000 -1000 -1000 -10"
    (tree / "training" / "label_2" / "000001.txt").write_text(f"{flat}\n")
    write_label(tree, 0, "Car", "Van")
    write_list(tree, "some", (0, 1))
    some = (SourceConfig(path=Path(), sample_list="some"),)

    class Learning(toy.ToyPreparation):
        learned_box = "3D"
        parts = frozenset({"image", "points", "objects"})

        def learned_classes(self):
            return ("Car",)

    class LearningImages(Learning):
        learned_box = "2D"

    for preparation, expected in ((Learning(), 1), (LearningImages(), 0)):
        data = CameraLidarData(preparation, root=tree, batch_size=1, workers=0, training=some)
        data.train_dataloader()
        told = capsys.readouterr().err
        assert (
            told.count("have no 3D box for 1 of the 3 objects that were read (Car 1): th")
            == expected
        )


def test_flags_in_place_of_truncations_are_told_where_such_objects_are_not_learned(tree):
    for number in range(8):
        flagged = LABEL.format("Car").replace("Car 0", "Car 1")
        far = " ".join([*LABEL.format("Van").split()[:4], "0 0 99 99", *flagged.split()[8:]])
        path = tree / "training" / "label_2" / f"{number:06}.txt"
        path.write_text(f"{flagged}\n{far}\n")
    write_list(tree, "some", range(8))
    with warnings.catch_warnings(action="ignore"):  # of the labels themselves
        dataset = open_with_classes(tree, sample_list="some")
    for box, expected in (("2D", 1), ("3D", 0), (None, 0)):
        found = labelled_classes([dataset], ("Car",), box, count_all=True)
        told = " ".join(found.training_warnings(("Car",), box))
        assert told.count("give 8 of 16 objects a truncation of 1 or more") == expected


@pytest.mark.filterwarnings(
    "ignore:.*(far outside the image|do not fit its 2D boxes)"
)  # the pictures are small
def test_labels_on_a_server_are_read_until_each_class_has_been_found(tree):
    for number in range(12):
        write_label(tree, number, "Car" if number else "Van", "Tram")
    packed = tree.with_name("shards")
    write_shards(tree, packed, frames_per_shard=5)
    memory = fsspec.filesystem("memory")
    for file in packed.iterdir():
        memory.pipe_file(f"/labels/{file.name}", file.read_bytes())
    here, there = open_dataset(packed), open_dataset("memory://labels")
    found = labelled_classes([there], ("Car",), count_all=True)
    assert (found.absent, found.num_objects) == ((), 4)
    assert labelled_classes([there], ("Cyclist",)).num_objects == 24
    assert labelled_classes([here], ("Car",), count_all=True).num_objects == 24
    memory.rm("/labels", recursive=True)


def test_a_class_without_a_visible_object_in_a_data_set_is_told_where_it_is_not_learned(tree):
    here, there = tree, toy.write_frames(tree.parent / "there", count=2)
    sound, unknown = LABEL, LABEL.replace(" 0 0 0 ", " 0 3 0 ", 1)
    for number in range(12):
        text = sound.format("Car") + unknown.format("Pedestrian") * (number == 0)
        (here / "training" / "label_2" / f"{number:06}.txt").write_text(text)
    for number in range(2):
        text = unknown.format("Car") * 2 + sound.format("Cyclist") + unknown.format("Van") * 2
        (there / "training" / "label_2" / f"{number:06}.txt").write_text(text)
    names = ("Car", "Pedestrian", "Cyclist")
    with warnings.catch_warnings(action="ignore"):  # of the labels themselves
        data_sets = [open_with_classes(each) for each in (here, there)]
    found = labelled_classes(data_sets, names, "2D", max_occlusion=2, count_all=True)
    assert found.hidden == {"Car": 4}
    (told,) = found.training_warnings(names, "2D")
    assert "have an occlusion above 2 (Car 4; 3 is unknown): they are not learned;" in told
    for limit in (3, None):  # all are learned
        found = labelled_classes(data_sets, names, "2D", max_occlusion=limit, count_all=True)
        assert not found.training_warnings(names, "2D")
    here_alone = labelled_classes(data_sets[:1], names, "2D", max_occlusion=2, count_all=True)
    assert not here_alone.hidden
