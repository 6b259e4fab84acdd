"""Files of a corrupted data set: one of KITTI's object trees for each case."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import torch

from sightline.corruptions.corruption import Corrupted, Corruption, Record, everywhere
from sightline.data.kitti_files import write_image, write_points
from sightline.data.kitti_object import KittiObjectDataset
from sightline.data.mask_png import read_mask_png, write_mask_png
from sightline.data.object_tree import (
    CORRUPTED,
    ObjectFrame,
    Part,
    Velodyne,
    list_files,
    list_object_frames,
    part_folder,
)
from sightline.files.atomic import atomic_link, atomic_write_text

PARTS: Final[tuple[Part, ...]] = ("image", "points", "calibration", "objects", "depth")
"""Parts of a frame that a case's tree also contains, if the input does."""

_RECORDS = CORRUPTED
_MASKS = ("camera_mask", "lidar_mask")
_LISTS = "ImageSets"


@dataclass(frozen=True, kw_only=True, slots=True)
class CaseTree:
    """KITTI's object tree of one case, with a record of each frame's corruption.

    `SPLIT/corruption/N.json` holds the record; `SPLIT/{camera_mask,lidar_mask}/N.png`, if
    requested, the pixels that may have changed. Unchanged files are hard links to the input's
    files, or copies if such links are not supported.
    """

    root: Path
    split: str
    velodyne: Velodyne
    masks: bool

    def finished(self, originals: dict[str, ObjectFrame]) -> set[str]:
        """Find the names of frames with all their files; an existing file is complete."""
        folder = self.root / self.split
        there = list_object_frames(folder, PARTS, self.velodyne)
        noted = set(list_files(folder / _RECORDS, (".json",)))
        for mask_folder in _MASKS if self.masks else ():
            noted &= set(list_files(folder / mask_folder, (".png",)))
        return {
            name
            for name in noted & there.keys() & originals.keys()
            if all(
                getattr(there[name], part) is not None
                for part in PARTS
                if getattr(originals[name], part) is not None
            )
        }

    def write(self, corrupted: Corrupted, original: ObjectFrame) -> None:
        """Write or link all parts of a frame atomically."""
        folder, name = self.root / self.split, original.sample_id
        sample, changed = corrupted.sample, set[Part]()
        if "camera" in corrupted.record.sensors and sample.image is not None:
            write_image(folder / part_folder("image") / f"{name}.png", sample.image)
            changed.add("image")
        if "lidar" in corrupted.record.sensors and sample.points is not None:
            points = folder / part_folder("points", self.velodyne) / f"{name}.bin"
            write_points(points, sample.points)
            changed.add("points")
        for part in PARTS:
            path: Path | None = getattr(original, part)
            if path is not None and part not in changed:
                atomic_link(folder / part_folder(part, self.velodyne) / path.name, path)
        if self.masks:
            masks = (corrupted.camera_mask, corrupted.lidar_mask)
            for mask_folder, mask in zip(_MASKS, masks, strict=True):
                write_mask_png(folder / mask_folder / f"{name}.png", mask.numpy())
        record = json.dumps(corrupted.record.to_json(), indent=2) + "\n"
        atomic_write_text(folder / _RECORDS / f"{name}.json", record)

    def link_lists(self, data: Path) -> None:
        """Link the input's lists of frames."""
        for path in list_files(data / _LISTS, (".txt",)).values():
            atomic_link(self.root / _LISTS / path.name, path)


def read_corrupted(
    root: Path, name: str, corruption: Corruption, velodyne: Velodyne
) -> Corrupted | None:
    """Read a labelled frame of a case's tree, with its masks; None without any sensor file.

    Args:
        root: Root of the tree.
        name: Name of the frame.
        corruption: Corruption of the case. Its drawn values are not read.
        velodyne: The sweeps' folder.

    Raises:
        ValueError: A file is damaged; the message contains its name.
    """
    split: Final = "training"
    if name not in list_object_frames(root / split, ("image", "points"), velodyne):
        return None
    parts: tuple[Part, ...] = ("image", "points", "objects")
    frames = KittiObjectDataset(
        root, split, sample_list=(name,), velodyne=velodyne, parts=parts, needs=()
    )
    sample = frames[0]
    camera_mask, lidar_mask = (
        torch.from_numpy(read_mask_png(path)) if path.is_file() else everywhere(sample)
        for path in (root / split / folder / f"{name}.png" for folder in _MASKS)
    )
    record = Record(kind=corruption.kind, sensors=corruption.sensors, parameters={})
    return Corrupted(sample=sample, record=record, camera_mask=camera_mask, lidar_mask=lidar_mask)
