"""Videos and Rerun files from results on disk."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import UInt8

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.files.atomic import check_writable
from sightline.files.problem import refuse_without_effect
from sightline.jobs.progress import track
from sightline.perception.results import ResultFolder, open_results, read_perception
from sightline.structures.lidar_turn import LidarTurn, undo_turn
from sightline.structures.predictions import Perception
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.frame_row import RowLayout, draw_row
from sightline.visualization.rerun_file import check_rerun, write_rerun
from sightline.visualization.video import check_video, write_video

FPS: Final = 10.0
"""Default rate of a video [frames per second]."""
MIN_SCORE: Final = 0.3
"""Default score threshold of drawn detections."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PictureFiles:
    """Picture files of a data set and its results; written atomically."""

    video: Path | None
    """MP4 file: camera with boxes, depth and bird's-eye view of each frame; see `draw_row`."""
    rerun: Path | None
    """Rerun file: image, depth, points, boxes on a time line; see `write_rerun`."""
    fps: float
    min_score: float

    @classmethod
    def checked(
        cls, video: Path | str | None, rerun: Path | str | None, *, fps: float, min_score: float
    ) -> "PictureFiles | None":
        """Check the requested files; return None if nothing is requested.

        Raises:
            ValueError: A name has the wrong suffix, a file cannot be written, a library is missing,
                or the rate or the score is invalid, or given without a file that it is for.
        """
        refuse_without_effect("without --video", fps=fps != FPS and video is None)
        refuse_without_effect(
            "without --video or --rerun",
            min_score=min_score != MIN_SCORE and video is None and rerun is None,
        )
        if video is None and rerun is None:
            return None
        if video is not None:
            check_video(Path(video), fps)
            check_writable(video)
        if rerun is not None:
            check_rerun(Path(rerun))
            check_writable(rerun)
        if not 0 <= min_score <= 1:
            raise ValueError(f"min_score must be between 0 and 1, as scores are, got {min_score}")
        return cls(
            video=None if video is None else Path(video),
            rerun=None if rerun is None else Path(rerun),
            fps=fps,
            min_score=min_score,
        )

    def write(self, dataset: SampleDataset, results: Path) -> None:
        """Draw all frames in order.

        Raises:
            ValueError: A frame or a result cannot be read, or a file cannot be written.
        """
        opened = open_results([results])
        further = tuple(each.further for each in opened if each.further)
        if self.video is not None:
            frames = self._frames(dataset, opened, "video")
            write_video(self.video, _pictures(frames, further), fps=self.fps)
        if self.rerun is not None:
            write_rerun(self.rerun, self._frames(dataset, opened, "rerun"), further=further)

    def _frames(
        self, dataset: SampleDataset, results: tuple[ResultFolder, ...], description: str
    ) -> Iterator[tuple[CameraLidarSample, Perception]]:
        numbers = range(len(dataset))
        for sample in track(map(dataset.__getitem__, numbers), description=description,
                            total=len(numbers)):  # fmt: skip
            found = read_perception(results, sample).filter_by_score(self.min_score)
            yield undo_turn(sample, found.undone_turn or LidarTurn()), found


def _pictures(
    frames: Iterator[tuple[CameraLidarSample, Perception]], further: tuple[str, ...]
) -> Iterator[UInt8[np.ndarray, "_height _width 3"]]:
    layout = None
    for sample, perception in frames:
        layout = layout or RowLayout.of(sample.image_size, further)
        time_s = sample.timestamp_s
        note = "" if time_s is None else f"{time_s:.2f} s"
        yield draw_row(sample, perception, layout, note=note)
