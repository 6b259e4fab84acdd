"""The embedded frames at half their height and width, where what is drawn does not matter.

Networks take a quarter of the time, and KITTI's evaluation still counts some objects.
"""

from pathlib import Path

from sightline.augmentation.scene_changes import resize
from sightline.data.formats.kitti_conversion import kitti_from_labels
from sightline.data.formats.kitti_files import write_image, write_object_calibration, write_points
from sightline.data.formats.kitti_labels import write_objects
from sightline.data.formats.map_png import write_depth_png
from sightline.data.open import open_dataset
from sightline.simulation.packaged import PACKAGED_FRAMES

IMAGE_SIZE = (188, 621)


def write_small_frames(root: Path) -> Path:
    """Write an object tree with labels and dense depth; returns its folder."""
    folder = root / "training"
    for whole in open_dataset(PACKAGED_FRAMES, parts=("image", "points", "objects", "depth")):
        sample = resize(whole, *IMAGE_SIZE)
        name = sample.sample_id
        write_image(folder / "image_2" / f"{name}.png", sample.image)
        write_points(folder / "velodyne" / f"{name}.bin", sample.points)
        write_object_calibration(folder / "calib" / f"{name}.txt", sample.calibration)
        objects = kitti_from_labels(sample.objects, sample.calibration)
        write_objects(folder / "label_2" / f"{name}.txt", objects)
        write_depth_png(folder / "depth" / f"{name}.png", sample.depth.numpy())
    return root
