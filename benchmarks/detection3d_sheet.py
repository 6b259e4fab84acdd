"""Pictures of a detector's two stages on frames: `python -m benchmarks.detection3d_sheet`.

For each frame the image with proposals, the image with detections (labels in white), and all of
them from above. The picture takes 600 KB at most.
"""

from pathlib import Path

import jsonargparse
import numpy as np

from benchmarks.sheet_file import write_sheet
from sightline.data.open import open_dataset
from sightline.detection3d.pictures import prediction_picture
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.jobs.progress import track
from sightline.simulation.packaged import PACKAGED_FRAMES

_MAX_BYTES = 600_000


def main(
    weights: str,
    out: Path = Path("docs/pictures/detection3d.jpg"),
    data: Path = PACKAGED_FRAMES,
    frames: int = 2,
    sample_list: str | None = None,
    width_px: int = 800,
) -> None:
    """Draw the frames one below the other.

    Args:
        weights: Name of weights that come with Sightline, or a file.
        out: The picture.
        data: KITTI object tree.
        frames: How many, evenly spread over the data.
        sample_list: Which frames there are: a list in ImageSets, or a text file.
        width_px: Of the image.
    """
    predictor = Detection3DPredictor.load(weights)
    dataset = open_dataset(data, sample_list=sample_list)
    indices = np.linspace(0, len(dataset) - 1, frames).round().astype(int).tolist()
    pages = []
    for sample in (dataset[index] for index in track(indices, description="detecting")):
        title = f"Frame {sample.sample_id}"
        pages.append(
            prediction_picture(title, sample, *predictor.both_stages(sample), width_px=width_px)
        )
    width = max(page.shape[1] for page in pages)  # KITTI's images differ by some columns
    filled = [np.pad(page, ((0, 0), (0, width - page.shape[1]), (0, 0))) for page in pages]
    write_sheet(out, np.concatenate(filled), _MAX_BYTES)
    print(out)


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)
