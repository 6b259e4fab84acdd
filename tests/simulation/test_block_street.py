"""The embedded street scenes: geometry and labels that agree, files that repeat."""

from pathlib import Path

import numpy as np
import pytest
import torch

from sightline.data.depth_png import read_depth_png
from sightline.data.kitti_object import KittiObjectDataset
from sightline.data.rings import ring_numbers
from sightline.geometry.projection import project_points, sparse_depth_map
from sightline.simulation.block_street import (
    DEPTH_FOLDER,
    KITTI_IMAGE_SIZE,
    BlockStreetFrame,
    make_block_street_frame,
    write_block_street,
)
from sightline.structures.sample import CameraLidarSample

SMALL = (125, 414)


@pytest.fixture(scope="module")
def frames() -> list[BlockStreetFrame]:
    return [make_block_street_frame(index) for index in range(2)]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("street")
    write_block_street(out)
    return out


@pytest.fixture(scope="module")
def whole() -> CameraLidarSample:
    return make_block_street_frame(0, image_size=SMALL, full_sweep=True).sample


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_at_least_95_percent_of_the_points_in_a_3d_box_fall_in_its_2d_box(frames):
    for frame in frames:
        sample = frame.sample
        inside3d = sample.objects.boxes3d.contain(sample.points[:, :3].double())
        pixels = project_points(sample.points[:, :3], sample.calibration).pixels
        for box, members in zip(sample.objects.boxes2d.tensor, inside3d, strict=True):
            own = pixels[members]
            within = (own >= box[:2] - 0.5).all(dim=1) & (own <= box[2:] + 0.5).all(dim=1)
            assert len(own) > 0
            assert within.float().mean() >= 0.95


def test_the_2d_box_fits_the_pixels_of_an_object_that_nothing_hides(frames):
    num_checked = 0
    for frame in frames:
        for index, share in enumerate(frame.visible_shares):
            rows, columns = np.nonzero(frame.instances == index)
            pixels = np.array([columns.min(), rows.min(), columns.max(), rows.max()])
            outwards = frame.sample.objects.boxes2d.tensor[index].numpy() - pixels
            outwards[:2] *= -1
            assert outwards.min() >= -1.5  # no visible pixel lies outside
            if share == 1:
                assert outwards.max() <= 1.5
                num_checked += 1
    assert num_checked >= 6


def test_true_depth_agrees_with_the_sweep(frames):
    for frame in frames:
        sample = frame.sample
        sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
        both = (sparse > 0) & (sample.depth > 0)
        error = (sparse - sample.depth)[both].abs()
        # The sensors stand apart, so that at outlines they see different things.
        assert (error < 0.12 + 0.01 * sample.depth[both]).float().mean() > 0.9


def test_every_class_is_there_and_nothing_is_labelled_that_cannot_be_seen(frames):
    names = {name for frame in frames for name in frame.sample.objects.class_names}
    assert names == {"Car", "Pedestrian", "Cyclist"}
    for frame in frames:
        counts = np.bincount(frame.instances[frame.instances >= 0])
        assert len(counts) == len(frame.sample.objects)
        assert counts.min() >= 25


def test_labels_hold_kitti_s_values(frames):
    for frame in frames:
        objects = frame.sample.objects
        assert ((objects.truncation >= 0) & (objects.truncation <= 1)).all()
        assert set(objects.occlusion.tolist()) <= {0, 1, 2}
        assert (objects.boxes2d.sizes() > 0).all()
        assert (objects.boxes2d.clip(KITTI_IMAGE_SIZE).tensor == objects.boxes2d.tensor).all()
        assert (objects.boxes3d.yaws.abs() <= np.pi).all()
    truncation = torch.cat([frame.sample.objects.truncation for frame in frames])
    occlusion = torch.cat([frame.sample.objects.occlusion for frame in frames])
    assert (truncation > 0.1).any()
    assert set(occlusion.tolist()) == {0, 1, 2}


def test_a_car_straight_ahead_that_drives_away_has_alpha_minus_90_degrees(frames):
    for frame in frames:
        ahead = frame.sample.objects
        leader = int(
            (ahead.boxes3d.centers[:, 1].abs() + 0.01 * ahead.boxes3d.centers[:, 0]).argmin()
        )
        assert ahead.class_names[leader] == "Car"
        assert ahead.alpha[leader].item() == pytest.approx(-np.pi / 2, abs=0.1)


def test_a_whole_sweep_has_64_rings_in_kitti_s_order(whole):
    points = whole.points.numpy()
    rings = ring_numbers(points)
    assert rings.max() == 63
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360
    elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    for ring in range(64):
        assert (np.diff(azimuth[rings == ring]) > 0).all()
    middles = [np.median(elevation[rings == ring]) for ring in range(64)]
    assert (np.diff(middles) < 0).all()
    assert middles[0] == pytest.approx(2.0, abs=0.1)
    assert middles[-1] == pytest.approx(-24.8, abs=0.1)
    assert 95_000 < len(points) < 130_000


def test_a_cut_sweep_holds_just_the_points_of_the_whole_one_that_the_camera_sees(whole):
    cut = make_block_street_frame(0, image_size=SMALL).sample
    seen = project_points(whole.points[:, :3], whole.calibration).in_image(SMALL)
    assert (cut.points == whole.points[seen]).all()
    assert 40 <= ring_numbers(cut.points.numpy()).max() <= 50


def test_the_written_tree_reads_back_as_the_frames_that_were_made(written, frames):
    dataset = KittiObjectDataset(written, sample_list=written / "ImageSets" / "demo.txt")
    assert dataset.sample_ids == ("000000", "000001")
    for index, frame in enumerate(frames):
        sample, made = dataset[index], frame.sample
        assert (sample.image == made.image).all()
        assert (sample.points == made.points).all()
        assert sample.objects.class_names == made.objects.class_names
        torch.testing.assert_close(
            sample.objects.boxes3d.tensor, made.objects.boxes3d.tensor, atol=0.011, rtol=0
        )
        path = written / "training" / DEPTH_FOLDER / f"{made.sample_id}.png"
        np.testing.assert_allclose(read_depth_png(path), made.depth.numpy(), atol=1 / 512)


def test_two_frames_take_less_than_a_megabyte(written):
    assert sum(map(len, contents(written).values())) < 1_000_000


def test_the_same_seed_writes_the_same_bytes_however_many_frames_and_another_does_not(tmp_path):
    for name, seed, frames in (("one", 3, 1), ("two", 3, 2), ("other", 4, 1)):
        write_block_street(tmp_path / name, frames=frames, seed=seed, image_size=SMALL)
    one, two, other = (contents(tmp_path / name) for name in ("one", "two", "other"))
    assert len(one) == 6
    assert len(two) == 11
    one.pop("ImageSets/demo.txt")
    for path, content in one.items():
        assert two[path] == content
        assert (other[path] == content) == ("calib" in path)


@pytest.mark.parametrize("size", [(4, 4), (30, 20)])
def test_frames_of_a_few_pixels_are_made(size):
    sample = make_block_street_frame(0, image_size=size).sample
    assert sample.image.shape == (3, *size)
    assert len(sample.objects) <= 2
