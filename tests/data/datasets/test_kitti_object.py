import pickle
import shutil

import cv2
import pytest
import torch
from torch.utils.data import DataLoader, Dataset

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.formats.map_png import write_depth_png
from tests.data.trees import (
    IMAGE_SIZE,
    calibration,
    depth_map,
    picture,
    points,
    write_object_frame,
    write_object_tree,
)


class ThreadsOfOpenCV(Dataset):
    """Tells how many threads OpenCV has after a sample was read."""

    def __init__(self, dataset):
        self.dataset = dataset

    def __len__(self):
        return len(self.dataset)

    def __getitem__(self, index):
        self.dataset[index]
        return cv2.getNumThreads()


def first(batch):
    return batch[0]


def test_a_sample_holds_image_sweep_calibration_and_labels(tmp_path):
    (sample,) = KittiObjectDataset(write_object_tree(tmp_path, "000007"))
    assert sample.sample_id == "000007"
    assert sample.image_size == IMAGE_SIZE
    assert torch.equal(sample.image, torch.from_numpy(picture()).permute(2, 0, 1))
    assert torch.equal(sample.points, points())
    assert torch.equal(sample.calibration.image_from_lidar, calibration().image_from_lidar)
    assert sample.objects.class_names == ("Car", "DontCare")
    assert sample.depth is None


def test_true_depth_is_read_from_trees_that_have_it(tmp_path):
    root = write_object_tree(tmp_path, "000007")
    write_depth_png(root / "training" / "depth" / "000007.png", depth_map())
    (sample,) = KittiObjectDataset(root, parts={"points", "depth"})
    assert torch.equal(sample.depth, torch.from_numpy(depth_map()))


def test_a_depth_map_of_another_size_than_the_image_is_refused_by_name(tmp_path):
    root = write_object_tree(tmp_path, "000007")
    write_depth_png(root / "training" / "depth" / "000007.png", depth_map(size=(12, 41)))
    with pytest.raises(ValueError, match=r"depth/000007.png: is 12x41 .* expected 12x40 like"):
        KittiObjectDataset(root, parts={"depth"})[0]


def test_a_tree_without_pictures_lacks_images_not_depth_by_which_their_size_could_be_known(
    tmp_path,
):
    folder = write_object_tree(tmp_path, "000007")
    shutil.rmtree(folder / "training" / "image_2")
    with pytest.raises(ValueError, match="training lacks image_2 of 1 of 1 frames"):
        KittiObjectDataset(folder, parts={"points"})
    with pytest.warns(UserWarning, match="no images: their size is guessed"):
        assert len(KittiObjectDataset(folder, parts={"points"}, needs={"points"})) == 1
    write_depth_png(folder / "training" / "depth" / "000007.png", depth_map())
    assert KittiObjectDataset(folder, parts={"points"})[0].image_size == depth_map().shape


def test_asking_for_depth_that_the_tree_lacks_names_the_folder(tmp_path):
    with pytest.raises(ValueError, match="lacks depth of 1 of 1 frames"):
        KittiObjectDataset(write_object_tree(tmp_path, "000007"), parts={"depth"})


def test_all_frames_are_read_in_order_where_no_list_is_given(tmp_path):
    dataset = KittiObjectDataset(write_object_tree(tmp_path, "000010", "000002", "000003"))
    assert dataset.sample_ids == ("000002", "000003", "000010")
    assert [sample.sample_id for sample in dataset] == list(dataset.sample_ids)


def test_a_list_chooses_the_frames_and_their_order(tmp_path):
    root = write_object_tree(tmp_path, "000001", "000002", "000003")
    dataset = KittiObjectDataset(root, sample_list=["000003", "000001"])
    assert dataset.sample_ids == ("000003", "000001")
    assert dataset[1].sample_id == "000001"


def test_hidden_files_and_other_formats_are_no_frames_and_png_comes_before_jpeg(tmp_path):
    images = write_object_tree(tmp_path, "000001") / "training" / "image_2"
    for name in (".000002.png", "._000001.png", "000003.txt", "000001.jpg"):
        (images / name).write_bytes(b"no picture")
    (sample,) = KittiObjectDataset(tmp_path)
    assert torch.equal(sample.image, torch.from_numpy(picture()).permute(2, 0, 1))


def test_testing_frames_have_no_labels(tmp_path):
    write_object_frame(tmp_path, "000001", split="testing")
    (sample,) = KittiObjectDataset(tmp_path, "testing")
    assert sample.objects is None


def test_reduced_sweeps_are_read_from_their_own_folder(tmp_path):
    write_object_tree(tmp_path, "000001")
    training = tmp_path / "training"
    (training / "velodyne").rename(training / "velodyne_reduced")
    (sample,) = KittiObjectDataset(tmp_path, velodyne="velodyne_reduced")
    assert torch.equal(sample.points, points())
    with pytest.raises(ValueError, match=r"training lacks velodyne of 1 of 1 frames \(000001\)"):
        KittiObjectDataset(tmp_path)


def test_parts_not_asked_for_need_not_be_there_but_the_size_is_known(tmp_path):
    write_object_tree(tmp_path, "000001")
    shutil.rmtree(tmp_path / "training" / "velodyne")
    shutil.rmtree(tmp_path / "training" / "label_2")
    (sample,) = KittiObjectDataset(tmp_path, parts=())
    assert sample.image is sample.points is sample.objects is None
    assert sample.image_size == IMAGE_SIZE


def test_a_list_naming_absent_frames_is_answered_with_the_first_few_and_their_number(tmp_path):
    write_object_tree(tmp_path, "000001")
    wanted = [f"{number:06}" for number in range(9)]
    match = r"lacks every part of 8 of 9 frames \(000000, 000002, .*, 000005 and 3 more\)"
    with pytest.raises(ValueError, match=match):
        KittiObjectDataset(tmp_path, sample_list=wanted)


@pytest.mark.parametrize(
    ("folder", "file"),
    [
        ("image_2", "000002.png"),
        ("velodyne", "000002.bin"),
        ("calib", "000002.txt"),
        ("label_2", "000002.txt"),
    ],
)
def test_a_frame_lacking_a_part_says_which_as_soon_as_the_data_set_is_opened(
    tmp_path, folder, file
):
    write_object_tree(tmp_path, "000001", "000002")
    (tmp_path / "training" / folder / file).unlink()
    with pytest.raises(
        ValueError, match=rf"lacks {folder} of 1 of 2 frames \(000002\); extract"
    ) as caught:
        KittiObjectDataset(tmp_path)
    is_label = folder == "label_2"
    assert ("or write an empty label file for each frame" in str(caught.value)) == is_label
    assert len(KittiObjectDataset(tmp_path, sample_list=["000001"])) == 1


def test_a_folder_without_frames_is_named_with_what_was_expected(tmp_path):
    (tmp_path / "training" / "velodyne").mkdir(parents=True)
    match = r"holds no frames of KITTI's object tree, expected files in training/image_2"
    with pytest.raises(ValueError, match=match) as caught:
        KittiObjectDataset(tmp_path)
    assert str(tmp_path) in str(caught.value)


def test_a_file_that_cannot_be_understood_is_named_when_its_frame_is_read(tmp_path):
    write_object_tree(tmp_path, "000001")
    path = tmp_path / "training" / "velodyne" / "000001.bin"
    path.write_bytes(bytes(17))
    with pytest.raises(ValueError, match=f"{path}: holds 17 bytes"):
        KittiObjectDataset(tmp_path)[0]


def test_a_sweep_of_zero_points_and_labels_of_zero_objects_are_legal(tmp_path):
    write_object_tree(tmp_path, "000001")
    (tmp_path / "training" / "velodyne" / "000001.bin").write_bytes(b"")
    (tmp_path / "training" / "label_2" / "000001.txt").write_bytes(b"")
    (sample,) = KittiObjectDataset(tmp_path)
    assert sample.points.shape == (0, 4)
    assert len(sample.objects) == 0


def test_samples_and_data_sets_travel_between_processes(tmp_path):
    dataset = KittiObjectDataset(write_object_tree(tmp_path, "000001", "000002"))
    copy = pickle.loads(pickle.dumps(dataset))
    assert copy.sample_ids == dataset.sample_ids
    loader = DataLoader(copy, batch_size=1, collate_fn=first, num_workers=1)
    for sample, expected in zip(loader, dataset, strict=True):
        assert sample.sample_id == expected.sample_id
        assert torch.equal(sample.image, expected.image)
        assert torch.equal(sample.objects.boxes3d.tensor, expected.objects.boxes3d.tensor)


def test_opencv_keeps_to_one_thread_in_workers_and_only_there(tmp_path):
    dataset = ThreadsOfOpenCV(KittiObjectDataset(write_object_tree(tmp_path, "000001")))
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(2)
        assert list(DataLoader(dataset, num_workers=1, collate_fn=first)) == [1]
        assert dataset[0] == cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(before)
