"""Pictures of frames, as files."""

from pathlib import Path

from sightline.data.image_file import write_rgb
from sightline.data.object_tree import Velodyne
from sightline.data.open import open_dataset
from sightline.inference.depth import Completer
from sightline.visualization.sheet import frame_sheet


def write_frame_picture(
    data: Path, frame: str, out: Path, *, completer: Completer, velodyne: Velodyne = "velodyne"
) -> Path:
    """Draws all there is to see of one frame, its depth completed, to a PNG.

    Args:
        data: Folder of the data set; see `open_dataset`.
        frame: Name of the frame.
        out: The PNG.
        completer: Makes the dense depth.
        velodyne: The sweeps' folder in an object tree.

    Returns:
        `out`.

    Raises:
        ValueError: The data lacks the frame, a file of it is at fault, or `out` cannot be written.
    """
    sample = open_dataset(data, sample_list=(frame,), velodyne=velodyne)[0]
    dense = completer(sample) if sample.points is not None else None
    write_rgb(out, frame_sheet(sample, dense, dense_name=completer.name))
    return out
