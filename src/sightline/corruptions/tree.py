"""The files of a corrupted data set: one of KITTI's object trees for each case."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sightline.corruptions.corruption import Corrupted
from sightline.data.atomic import atomic_link, atomic_write_text
from sightline.data.kitti_files import write_image, write_points
from sightline.data.mask_png import write_mask_png
from sightline.data.object_tree import (
    CORRUPTED,
    ObjectFrame,
    Part,
    Velodyne,
    list_files,
    list_object_frames,
    part_folder,
)

PARTS: Final[tuple[Part, ...]] = ("image", "points", "calibration", "objects", "depth")
"""Of a frame, what a case's tree holds as well, if the input does."""

_RECORDS = CORRUPTED
_MASKS = ("camera_mask", "lidar_mask")
_LISTS = "ImageSets"


@dataclass(frozen=True, kw_only=True, slots=True)
class CaseTree:
    """KITTI's object tree of one case, with what was done to each frame beside it.

    `SPLIT/corruption/N.json` holds the record; `SPLIT/{camera_mask,lidar_mask}/N.png`, where asked
    for, the pixels that may have changed. What the case leaves as it was is a hard link to the
    input's file, or a copy where there are no such links.
    """

    root: Path
    split: str
    velodyne: Velodyne
    masks: bool

    def finished(self, originals: dict[str, ObjectFrame]) -> set[str]:
        """Names of the frames that have all their files; a file that is there is whole."""
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
        """Writes or links all parts of a frame, each aside first and then renamed."""
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
        """Takes over the lists of frames that the input has."""
        for path in list_files(data / _LISTS, (".txt",)).values():
            atomic_link(self.root / _LISTS / path.name, path)
